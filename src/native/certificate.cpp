#include "certificate.hpp"

#include <algorithm>
#include <array>
#include <cmath>

namespace strips {

// Distance of two line segments.
static double segment_distance(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d) {
  const Vec3 u = b - a, v = d - c, w = a - c;
  const double uu = u.dot(u), uv = u.dot(v), vv = v.dot(v), uw = u.dot(w), vw = v.dot(w);
  const double det = uu * vv - uv * uv;
  double s = det > POINT_LENGTH2 ? (uv * vw - vv * uw) / det : 0.0;
  s = std::clamp(s, 0.0, 1.0);
  double t = std::clamp((uv * s + vw) / std::max(vv, POINT_LENGTH2), 0.0, 1.0);
  s = std::clamp((uv * t - uw) / std::max(uu, POINT_LENGTH2), 0.0, 1.0);
  t = std::clamp((uv * s + vw) / std::max(vv, POINT_LENGTH2), 0.0, 1.0);
  return (w + s * u - t * v).norm();
}

double ObstaclePairs::measure(const Frames& frames, std::size_t node, double place, std::int64_t pair, bool exact) {
  ++(exact ? counts.queries : counts.pairs);
  const std::size_t body = static_cast<std::size_t>(pair) / parts_.count(), part = pair - body * parts_.count();
  Vec3 one, two, shift;
  double uncertainty = 0.0;
  const Vec3* moves = moving_.at(place, part, shift, uncertainty) ? &shift : nullptr;
  if (exact) {
    return Queries{narrow_, frames, parts_, moving_}.exact(node, body, part, moves).distance - GJK_EXCESS - uncertainty;
  }
  narrow_.bodies->ends_at(frames, node, body, one, two);
  const double cheap = capsule_bound(*narrow_.bodies, one, two, body, parts_, part, moves, uncertainty);
  return std::max(cheap, PlacedBox(*narrow_.bodies, frames, node, body).bound(parts_, part, moves, uncertainty));
}

double ObstaclePairs::loose(std::int64_t pair) const {
  const double* e = &narrow_.bodies->ends[(static_cast<std::size_t>(pair) / parts_.count()) * 6];
  return (Vec3(e[3], e[4], e[5]) - Vec3(e[0], e[1], e[2])).norm() + CAPSULE_LOOSE;
}

SelfPairs::SelfPairs(std::shared_ptr<const Bodies> bodies, std::vector<std::int64_t> pairs, bool shallow)
    : bodies_(std::move(bodies)), pairs_(std::move(pairs)) {
  solver_.shallow = shallow;
  for (std::size_t s = 0; s < pairs_.size() / 2; ++s) {
    functors_.push_back(
        std::make_unique<ShapePair>(bodies_->solids[pairs_[2 * s]].shape, bodies_->solids[pairs_[2 * s + 1]].shape));
  }
}

double SelfPairs::lower_bound(const Frames& frames, std::size_t node, std::int64_t pair) {
  ++counts.pairs;
  const std::size_t one = pairs_[2 * pair], two = pairs_[2 * pair + 1];
  Vec3 a, b, c, d;
  bodies_->ends_at(frames, node, one, a, b);
  bodies_->ends_at(frames, node, two, c, d);
  return segment_distance(a, b, c, d) - bodies_->radius[one] - bodies_->radius[two];
}

double SelfPairs::lower_bound(const std::vector<Vec3>& ends, std::int64_t pair) {
  ++counts.pairs;
  const std::size_t one = pairs_[2 * pair], two = pairs_[2 * pair + 1];
  return segment_distance(ends[2 * one], ends[2 * one + 1], ends[2 * two], ends[2 * two + 1]) - bodies_->radius[one] -
         bodies_->radius[two];
}

double SelfPairs::query(const Frames& frames, std::size_t node, std::int64_t pair) {
  ++counts.queries;
  Mat3 R;
  Vec3 t;
  bodies_->placement(frames, node, pairs_[2 * pair], R, t);
  const Transform3s one(R, t);
  bodies_->placement(frames, node, pairs_[2 * pair + 1], R, t);
  return solver_.ask(*functors_[pair], one, Transform3s(R, t));
}

double SelfPairs::measure(const Frames& frames, std::size_t node, double, std::int64_t pair, bool exact) {
  return exact ? query(frames, node, pair) - GJK_EXCESS : lower_bound(frames, node, pair);
}

double SelfPairs::loose(std::int64_t) const { return CAPSULE_LOOSE; }

void Worst::note(double at, std::int64_t which, double d, bool sure) {
  if (there && (certain != sure ? certain : distance <= d)) return;
  there = true;
  certain = sure;
  pair = which;
  place = at;
  distance = d;
}

void Search::found(double place, std::int64_t pair, double d) {
  if (d > clearance) return;
  if (states != nullptr) states[static_cast<std::size_t>(place)] = 2;
  worst.note(place, pair, d, true);
}

void Search::unknown(const std::vector<Interval>& left) {
  for (const Interval& x : left) {
    const std::size_t segment = static_cast<std::size_t>(x.low);
    if (states != nullptr) states[segment] = std::max<std::int8_t>(states[segment], 1);
    worst.note(x.low, x.pair, std::min(x.d_low, x.d_high), false);
  }
}

void Bisection::locate(const std::vector<double>& places) {
  places_.clear();
  for (double place : places) {
    if (place != std::floor(place)) places_.push_back(place);
  }
  std::sort(places_.begin(), places_.end());
  places_.erase(std::unique(places_.begin(), places_.end()), places_.end());
  const std::size_t nv = static_cast<std::size_t>(tree_.nv), n = places_.size();
  if (n == 0) return;
  if (n > between_.capacity) {
    const std::size_t capacity = std::max<std::size_t>(2 * n, 64);
    T_.assign(tree_.joints * capacity * 12, 0.0);
    for (std::size_t k = 0; k < capacity; ++k) T_[12 * k] = T_[12 * k + 5] = T_[12 * k + 10] = 1.0;  // the universe
    between_ = {T_.data(), nullptr, capacity};
  }
  std::vector<double> q(n * nv);
  for (std::size_t k = 0; k < n; ++k) {
    const std::size_t s = static_cast<std::size_t>(places_[k]);
    integrate(tree_, coordinates_ + s * nv, v_ + s * nv, places_[k] - static_cast<double>(s), &q[k * nv]);
  }
  place(tree_, q.data(), n, T_.data(), nullptr, between_.capacity);
  checks += n;
}

double Bisection::measure(Pairs& pairs, double place, std::int64_t pair, bool exact) const {
  const bool between = place != std::floor(place);
  const std::size_t node = between ? std::lower_bound(places_.begin(), places_.end(), place) - places_.begin()
                                   : static_cast<std::size_t>(place);
  const Frames& at = between ? between_ : frames;
  return pairs.measure(at, node, place, pair, exact);
}

// Make distances at one end exact where that can close the interval, or where it is the last chance.
bool Bisection::settle(Pairs& pairs, std::vector<Interval>& todo, Search& search, bool low) {
  std::vector<std::size_t> ask;
  std::vector<double> places;
  for (std::size_t k = 0; k < todo.size(); ++k) {
    const Interval& x = todo[k];
    if (low ? x.exact_low : x.exact_high) continue;
    const double gap = x.travel + 2.0 * search.clearance - x.d_low - x.d_high, d = low ? x.d_low : x.d_high;
    const bool single = x.high - x.low <= 1.0;
    if (gap >= 0.0 && (single || gap <= pairs.loose(x.pair) || d <= search.clearance)) {
      ask.push_back(k);
      places.push_back(low ? x.low : x.high);
    }
  }
  if (ask.empty()) return false;
  locate(places);
  for (std::size_t k = 0; k < ask.size(); ++k) {
    Interval& x = todo[ask[k]];
    const double d = measure(pairs, places[k], x.pair, true);
    (low ? x.d_low : x.d_high) = d;
    (low ? x.exact_low : x.exact_high) = true;
    search.found(places[k], x.pair, d);
  }
  return search.over();
}

std::vector<Interval> Bisection::run(Pairs& pairs, std::vector<Interval> todo, Search& search,
                                     const Approach* approach) {
  const double c = search.clearance,
               most = OPEN_INTERVALS_A_PAIR * static_cast<double>(todo.size()) + MOST_OPEN_INTERVALS;
  for (int level = 0; level < depth_; ++level) {
    const bool settled =
        std::all_of(todo.begin(), todo.end(), [](const Interval& x) { return x.exact_low && x.exact_high; });
    if (!settled) {
      if (settle(pairs, todo, search, true) || settle(pairs, todo, search, false)) break;
      todo.erase(std::remove_if(todo.begin(), todo.end(), [c](const Interval& x) { return !x.open(c); }), todo.end());
    }
    const std::size_t count = todo.size();
    if (count == 0) break;
    std::vector<double> places(count), d(count), first(count), second(count);
    std::vector<bool> exact(count);
    for (std::size_t k = 0; k < count; ++k) {
      const Interval& x = todo[k];
      const bool single = x.high - x.low <= 1.0;
      const double middle = 0.5 * (x.low + x.high);
      places[k] = single ? middle : std::floor(middle);
      first[k] = second[k] = 0.5 * x.travel;
      if (approach != nullptr && !single) {
        const std::size_t low = static_cast<std::size_t>(x.low), at = static_cast<std::size_t>(places[k]);
        first[k] = (*approach)(x.pair, low, at);
        second[k] = (*approach)(x.pair, at, static_cast<std::size_t>(x.high));
      }
    }
    locate(places);
    for (std::size_t k = 0; k < count; ++k) {
      const Interval& x = todo[k];
      d[k] = measure(pairs, places[k], x.pair, false);
      // from here on, a half is proven
      const double one = first[k] - x.d_low + 2.0 * c, two = second[k] - x.d_high + 2.0 * c;
      bool need = d[k] < std::max(std::max(one, two), c) + EXACT_WITHIN;
      if (need && approach != nullptr && x.high - x.low > 1.0) {  // only what can close a half; it is halved anyway
        need = d[k] + pairs.loose(x.pair) >= std::min(one, two) || d[k] <= c;
      }
      exact[k] = need;
    }
    for (std::size_t k = 0; k < count; ++k) {
      if (exact[k]) d[k] = measure(pairs, places[k], todo[k].pair, true);
    }
    for (std::size_t k = 0; k < count; ++k) {
      if (exact[k]) search.found(places[k], todo[k].pair, d[k]);
    }
    if (search.over()) return {};
    std::vector<Interval> next;
    for (int half = 0; half < 2; ++half) {
      for (std::size_t k = 0; k < count; ++k) {
        const Interval& x = todo[k];
        const bool done = exact[k];
        const Interval part = half == 0
                                  ? Interval{x.pair, x.low, places[k], x.d_low, d[k], first[k], x.exact_low, done}
                                  : Interval{x.pair, places[k], x.high, d[k], x.d_high, second[k], done, x.exact_high};
        if (part.open(c) && !search.decided(x.low)) next.push_back(part);
      }
    }
    std::swap(todo, next);
    if (approach != nullptr && static_cast<double>(todo.size()) > most) break;
  }
  return todo;
}

PairRadii::PairRadii(const Tree& tree, const double* radius, std::size_t pairs)
    : first_(static_cast<std::size_t>(tree.base_nv())), moved_(tree.nv - first_), travel_(pairs) {
  start_.push_back(0);
  for (std::size_t s = 0; s < pairs; ++s) {
    for (std::size_t k = 0; k < moved_.size(); ++k) {
      const double r = radius[(first_ + k) * pairs + s];
      if (r != 0.0) entries_.push_back({k, r});
    }
    start_.push_back(entries_.size());
  }
}

const std::vector<double>& PairRadii::travel(const double* from, const double* to) {
  for (std::size_t k = 0; k < moved_.size(); ++k) {
    moved_[k] = std::abs(to[first_ + k] - (from == nullptr ? 0.0 : from[first_ + k]));
  }
  for (std::size_t s = 0; s < travel_.size(); ++s) {
    double sum = 0.0;
    for (std::size_t e = start_[s]; e < start_[s + 1]; ++e) sum += moved_[entries_[e].joint] * entries_[e].radius;
    travel_[s] = sum;
  }
  return travel_;
}

void self_drift(const double* coordinates, const double* before, std::size_t nv, PairRadii& radii, SelfDistances& d) {
  for (std::size_t n = 0; n < d.nodes; ++n) {
    if (std::equal(coordinates + n * nv, coordinates + (n + 1) * nv, before + n * nv)) continue;
    const std::vector<double>& travel = radii.travel(before + n * nv, coordinates + n * nv);
    double *bound = d.bound + n * d.pairs, *since = d.since + n * d.pairs;
    for (std::size_t s = 0; s < d.pairs; ++s) {
      const double shift = std::isnan(travel[s]) ? FAR : travel[s];  // of a new node nothing is known
      bound[s] -= shift;
      since[s] += shift;
    }
  }
}

// How far two bodies are apart along the direction in which they were when they were last measured.
static double apart_along(const SelfPairs& pairs, const Frames& frames, std::size_t node, std::size_t pair,
                          const double* direction) {
  const double* T = frames.at(pairs.planar() ? 1 : 0, node);
  const Eigen::Map<const Vec3> kept(direction);
  if (!(kept.squaredNorm() > 0.5)) return -INFINITY;
  const Vec3 n = Eigen::Map<const Mat3, 0, Eigen::OuterStride<4>>(T) * kept;
  const Bodies& bodies = pairs.bodies();
  return -bodies.extent(frames, node, pairs.body(pair, 0), -n) - bodies.extent(frames, node, pairs.body(pair, 1), n) -
         GJK_EXCESS;
}

// `cheap` is the lower bound that the capsules give.
static void self_measure(SelfPairs& pairs, const Frames& frames, std::size_t node, std::size_t pair, double cheap,
                         double reach, SelfDistances& d) {
  const std::size_t k = node * d.pairs + pair;
  if (cheap < reach) cheap = apart_along(pairs, frames, node, pair, d.direction + 3 * k);
  if (cheap >= reach) {
    d.bound[k] = cheap;
    d.since[k] = FAR;
    d.exact[k] = INFINITY;
    return;
  }
  d.exact[k] = pairs.query(frames, node, static_cast<std::int64_t>(pair));
  d.bound[k] = d.exact[k] - GJK_EXCESS;
  d.since[k] = 0.0;
  // kept in the base's frame: the base carries all links alike, and needs no new measurement
  const double* T = frames.at(pairs.planar() ? 1 : 0, node);
  const Vec3 n = -pairs.solver().normal(), t(T[3], T[7], T[11]);
  const Vec3 a = pairs.solver().first() - t, b = pairs.solver().second() - t;
  const Mat3 R = Eigen::Map<const Mat3, 0, Eigen::OuterStride<4>>(T).transpose();
  Eigen::Map<Vec3>(d.direction + 3 * k) = R * n;
  Eigen::Map<Vec3>(d.first + 3 * k) = R * a;
  Eigen::Map<Vec3>(d.second + 3 * k) = R * b;
}

void self_refine(SelfPairs& pairs, const Frames& frames, const double* coordinates, PairRadii& radii,
                 const double* reach, SelfDistances& d) {
  const Bodies& bodies = pairs.bodies();
  const std::size_t nv = static_cast<std::size_t>(bodies.tree.nv);
  std::vector<Vec3> ends(2 * bodies.size());
  for (std::size_t n = 0; n < d.nodes; ++n) {
    bool placed = false;
    const double* travel = nullptr;
    for (std::size_t s = 0; s < d.pairs; ++s) {
      const std::size_t k = n * d.pairs + s;
      if (!(d.bound[k] < reach[s] && d.since[k] > d.tolerance)) continue;
      if (n > 0 && d.bound[k] <= -0.5 * FAR) {
        if (travel == nullptr) travel = radii.travel(coordinates + (n - 1) * nv, coordinates + n * nv).data();
        const double known = d.bound[k - d.pairs] - travel[s];
        if (known >= reach[s]) {
          d.bound[k] = known;
          d.since[k] = FAR;
          d.exact[k] = INFINITY;
          continue;
        }
      }
      if (!placed) {
        for (std::size_t g = 0; g < bodies.size(); ++g) bodies.ends_at(frames, n, g, ends[2 * g], ends[2 * g + 1]);
        placed = true;
      }
      self_measure(pairs, frames, n, s, pairs.lower_bound(ends, static_cast<std::int64_t>(s)), reach[s], d);
    }
  }
}

void self_refine_at(SelfPairs& pairs, const Frames& frames, std::size_t node, std::size_t pair, double reach,
                    SelfDistances& d) {
  const std::size_t k = node * d.pairs + pair;
  if (!(d.bound[k] < reach && d.since[k] > d.tolerance)) return;
  self_measure(pairs, frames, node, pair, pairs.lower_bound(frames, node, static_cast<std::int64_t>(pair)), reach, d);
}

std::vector<Interval> open_self(SelfPairs& pairs, const Frames& frames, std::size_t nv, PairRadii& radii,
                                const double* v, const Search& search, SelfDistances& d) {
  const double clearance = search.clearance;
  std::vector<Interval> todo;
  for (std::size_t s = 0; s + 1 < d.nodes; ++s) {
    if (search.states[s] < 0) continue;  // it is known to be certified
    const std::vector<double>& travel = radii.travel(nullptr, v + s * nv);
    for (std::size_t p = 0; p < d.pairs; ++p) {
      if (d.bound[s * d.pairs + p] + d.bound[(s + 1) * d.pairs + p] > travel[p] + 2.0 * clearance) continue;
      const double low = static_cast<double>(s);
      todo.push_back({static_cast<std::int64_t>(p), low, low + 1.0, 0.0, 0.0, travel[p], true, true});
    }
  }
  for (std::size_t end = 0; end < 2; ++end) {
    for (const Interval& x : todo) {
      const std::size_t s = static_cast<std::size_t>(x.low), p = static_cast<std::size_t>(x.pair);
      const double other = d.bound[(s + 1 - end) * d.pairs + p];
      self_refine_at(pairs, frames, s + end, p, x.travel + 2.0 * clearance - other + EXACT_WITHIN, d);
    }
  }
  std::vector<Interval> open;
  for (Interval& x : todo) {
    const double* at = d.bound + static_cast<std::size_t>(x.low) * d.pairs + static_cast<std::size_t>(x.pair);
    x.d_low = at[0];
    x.d_high = at[d.pairs];
    if (x.open(clearance)) open.push_back(x);
  }
  return open;
}

void colliding_nodes(Queries& ask, Distances& d, Search& search) {
  const double clearance = search.clearance, *bound = d.bound;
  const std::size_t last = d.nodes - 2;
  for (std::size_t n = 0; n < d.nodes; ++n) {
    for (std::size_t g = 0; g < d.bodies; ++g) {
      for (std::size_t k = d.begin(n, g), end = d.end(n, g); k < end; ++k) {
        if (bound[k] > clearance) continue;
        refine_at(ask, n, g, k, clearance + EXACT_WITHIN, d);
        if (bound[k] > clearance) continue;
        search.states[std::min(n, last)] = search.states[n == 0 ? 0 : n - 1] = 2;
        search.worst.note(static_cast<double>(std::min(n, last)), static_cast<std::int64_t>(g * d.parts) + d.part[k],
                          d.bound[k], true);
      }
    }
  }
}

std::vector<Interval> open_obstacles(Queries& ask, const double* radius, const double* v, const double* approach,
                                     const Search& search, Distances& d) {
  const double clearance = search.clearance;
  const Bodies& robot = *ask.narrow.bodies;
  const Tree& tree = robot.tree;
  const Bounds bounds{radius, d.bodies};
  std::vector<Interval> todo;
  std::vector<std::array<std::size_t, 2>> places;  // of their pairs at either end
  const double* bound = d.bound;
  for (std::size_t s = 0; s + 1 < d.nodes; ++s) {
    if (search.states[s] != 0) continue;
    for (std::size_t g = 0; g < d.bodies; ++g) {
      const double need = bounds.travel(tree, v + s * tree.nv, g) + 2.0 * clearance;
      double tight = -1.0;  // a second chance: the travel of this very posture
      const std::size_t begin = d.begin(s, g), end = d.end(s, g), last = d.end(s + 1, g);
      const bool same = end - begin == d.parts && last - d.begin(s + 1, g) == d.parts;  // all parts are in both rows
      std::size_t j = d.begin(s + 1, g);
      for (std::size_t k = begin; k < end; ++k, j += same) {
        if (!same) {
          while (j < last && d.part[j] < d.part[k]) ++j;
          if (j == last) break;
          if (d.part[j] != d.part[k]) continue;  // far from one end: the caller saw to it that this is enough
        }
        const std::size_t p = same ? k - begin : static_cast<std::size_t>(d.part[k]);
        const double nearer = approach == nullptr ? 0.0 : approach[s * d.parts + p];
        if (bound[k] + bound[j] - need - nearer > 0.0) continue;
        if (tight < 0.0) tight = bounds.tight(robot, ask.frames, s, g, v + s * tree.nv);
        const double travel = tight + nearer;
        if (bound[k] + bound[j] > travel + 2.0 * clearance) continue;
        const double low = static_cast<double>(s);
        todo.push_back({static_cast<std::int64_t>(g * d.parts + p), low, low + 1.0, 0.0, 0.0, travel, true, true});
        places.push_back({k, j});
      }
    }
  }
  // what is far at one end is decided by the other: a bound up to the whole sum is good enough at each
  std::vector<double> reach;
  for (std::size_t end = 0; end < 2; ++end) {
    reach.clear();
    for (std::size_t k = 0; k < todo.size(); ++k) {
      reach.push_back(todo[k].travel + 2.0 * clearance - d.bound[places[k][1 - end]] + EXACT_WITHIN);
    }
    for (std::size_t k = 0; k < todo.size(); ++k) {
      const std::size_t node = static_cast<std::size_t>(todo[k].low) + end;
      refine_at(ask, node, static_cast<std::size_t>(todo[k].pair) / d.parts, places[k][end], reach[k], d);
    }
  }
  std::vector<Interval> open;
  for (std::size_t k = 0; k < todo.size(); ++k) {
    todo[k].d_low = d.bound[places[k][0]];
    todo[k].d_high = d.bound[places[k][1]];
    if (todo[k].open(clearance)) open.push_back(todo[k]);
  }
  return open;
}

Worst prove_motion(Pairs& pairs, std::size_t count, Bisection& bisection, std::size_t nodes, double clearance,
                   const Approach& approach) {
  const std::size_t last = nodes - 1;
  const Frames& frames = bisection.frames;
  std::vector<Interval> todo;
  for (std::size_t p = 0; p < count; ++p) {
    const std::int64_t pair = static_cast<std::int64_t>(p);
    const double end = static_cast<double>(last);
    const double d_low = pairs.measure(frames, 0, 0.0, pair, false),
                 d_high = pairs.measure(frames, last, end, pair, false);
    const Interval x{pair, 0.0, end, d_low, d_high, approach(pair, 0, last), false, false};
    if (x.open(clearance)) todo.push_back(x);
  }
  Search search{clearance};
  search.unknown(bisection.run(pairs, std::move(todo), search, &approach));
  return search.worst;
}

}  // namespace strips
