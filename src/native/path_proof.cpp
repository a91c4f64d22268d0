#include "path_proof.hpp"

#include <algorithm>
#include <cmath>

namespace strips {

constexpr int kHalvings = 3;          // of a piece at once: one for each of eight rows
constexpr int kMostHalvings = 60;     // of a segment, where its least distance is looked for: numbers have no more
constexpr double kExactTravel = 0.1;  // [m] an interval in which no point moves further is measured exactly
constexpr double kFirstReach = 0.05;  // [m] within which the nearest of all is looked for first
constexpr double kUnit = 1e-6;        // by which the square of a normal may be off 1
constexpr float kRoundedUp = 1.0f + 1e-6f;

PathProof::PathProof(std::shared_ptr<const Bodies> bodies, const Parts& parts, std::vector<std::int64_t> self_pairs,
                     const double* radius, const double* self_radius)
    : bodies_(bodies),
      narrow_(bodies),
      self_(bodies, self_pairs),
      parts_(parts),
      bounds_{radius, bodies->size()},
      self_radius_(self_radius),
      filter_(*bodies, parts, self_pairs, 0.0, 0.0),
      grown_(bodies->size() * kRows),
      pair_grown_(self_.size() * kRows) {
  const Tree& tree = bodies_->tree;
  T_.assign(static_cast<std::size_t>(tree.joints) * 12, 0.0);
  T_[0] = T_[5] = T_[10] = 1.0;
  J_.assign(static_cast<std::size_t>(tree.motions()) * 6, 0.0);
  rows_.assign(kRows * static_cast<std::size_t>(tree.nv), 0.0);
  v_.assign(static_cast<std::size_t>(tree.nv), 0.0);
  speed_.assign(bodies_->size() * kRows, 0.0);
  for (std::uint32_t g = 0; g < bodies_->size(); ++g) {
    if (filter_.moves(g)) moved_.push_back(g);
  }
}

// Of a row that is looked at: place the robot there, once.
void PathProof::at(const double* row, Queries& ask) {
  place(bodies_->tree, row, 1, T_.data(), J_.data(), 1);
  ask.forget();
}

// The direction in which a pair was apart when it was last measured; no length where that is not known.
Vec3& PathProof::kept_normal(const SphereOpen& open) {
  Normal& kept = normals_[(open.other * 31 + open.body * 2 + open.self) % kKept];
  if (kept.of.self != open.self || kept.of.body != open.body || kept.of.other != open.other)
    kept = {open, Vec3::Zero()};
  return kept.normal;
}

// As much of a pair's distance as is proven; the robot is there.
Found PathProof::exact(const SphereOpen& open, Queries& ask) {
  ++queries;
  Found found{};
  const double distance = or_deep([&] {
    if (open.self) {
      const double apart = self_.query(ask.frames, 0, open.body);
      found.direction = self_.solver().normal();
      return apart;
    }
    found = ask.exact(0, open.body, open.other, nullptr);
    return found.distance;
  });
  found.distance = distance - GJK_EXCESS;
  return found;
}

// What no joint moves is measured once, exactly.
bool PathProof::rest_is_clear(Queries& ask) {
  for (std::uint32_t g = 0; g < bodies_->size(); ++g) {
    for (std::uint32_t p = 0; p < parts_.count() && !filter_.moves(g); ++p) {
      if (!(exact({0, 0, g, p}, ask).distance > ask_.clearance)) return false;
    }
  }
  for (std::uint32_t s = 0; s < self_.size(); ++s) {
    if (filter_.moves(self_.body(s, 0)) || filter_.moves(self_.body(s, 1))) continue;
    if (!(exact({0, 1, s, 0}, ask).distance > ask_.self_clearance)) return false;
  }
  return true;
}

void PathProof::prove(const double* rows, const double* v, std::size_t n, double clearance, double self_clearance,
                      int depth, bool all, std::int8_t* states) {
  const Tree& tree = bodies_->tree;
  const std::size_t nv = static_cast<std::size_t>(tree.nv), pairs = self_.size();
  Queries ask(narrow_, {T_.data(), J_.data(), 1}, parts_);
  ask_ = {rows, v, clearance, self_clearance, depth, all, std::ldexp(1.0, -(depth + 2))};
  std::fill_n(states, n - 1, std::int8_t{0});
  at(rows, ask);
  bool going = rest_is_clear(ask);
  set_travel(n);
  self_travel_.assign((n - 1) * pairs, 0.0);
  for (std::size_t s = 0; s + 1 < n && going; ++s) {
    const double* move = v + s * nv;
    for (std::size_t k = static_cast<std::size_t>(tree.base_nv()); k < nv; ++k) {
      const double speed = std::abs(move[k]);
      for (std::size_t p = 0; p < pairs; ++p) self_travel_[s * pairs + p] += speed * self_radius_[k * pairs + p];
    }
  }
  todo_.clear();
  Piece now[kRows];
  for (std::size_t s = 0; s + 1 < n && going; s += kRows) {  // whole segments first, of all that moves
    const std::size_t filled = std::min<std::size_t>(kRows, n - 1 - s);
    for (std::size_t i = 0; i < filled; ++i) now[i] = {s + i, 0.0, 1.0, 0, {}, {}, {}};
    going = look(now, filled, nullptr, ask, states);
  }
  while (going && !todo_.empty()) {
    Piece piece = std::move(todo_.back());
    todo_.pop_back();
    if (states[piece.segment] != 0) continue;
    divide(piece, now);
    going = look(now, kRows, &piece, ask, states);
  }
  if (!going) std::fill_n(states, n - 1, std::int8_t{1});
}

void PathProof::set_travel(std::size_t n) {
  const std::size_t count = bodies_->size();
  travel_.resize((n - 1) * count);
  for (std::size_t s = 0; s + 1 < n; ++s) {
    for (std::size_t g = 0; g < count; ++g) {
      travel_[s * count + g] = bounds_.travel(bodies_->tree, ask_.v + s * v_.size(), g);
    }
  }
}

void PathProof::divide(const Piece& piece, Piece* now) {
  const double part = (piece.high - piece.low) / kRows;
  for (int i = 0; i < kRows; ++i) {
    now[i] = {piece.segment, piece.low + i * part, piece.low + (i + 1) * part, piece.depth + kHalvings, {}, {}, {}};
  }
}

// What may come nearer than `room` and `own` [m] in the pieces, about their middles, of what the piece that they are of
// has left open, or of all.
void PathProof::open_in(const Piece* now, std::size_t filled, Piece* of, double room, double own) {
  const Tree& tree = bodies_->tree;
  const std::size_t nv = static_cast<std::size_t>(tree.nv), count = bodies_->size(), pairs = self_.size();
  std::vector<std::uint32_t>& bodies = of == nullptr ? moved_ : of->bodies;
  for (std::size_t i = 0; i < filled; ++i) {
    const std::size_t s = now[i].segment;
    const double half = 0.5 * (now[i].high - now[i].low);
    integrate(tree, ask_.rows + s * nv, ask_.v + s * nv, 0.5 * (now[i].low + now[i].high), &rows_[i * nv]);
    for (std::size_t k = 0; k < bodies.size(); ++k) {
      const std::size_t g = bodies[k];
      const double travel = travel_[s * count + g], speed = of == nullptr ? travel : of->speed[k];
      speed_[g * kRows + i] = speed;
      const double more = half * speed + ask_.floor * travel;
      grown_.data()[g * kRows + i] = static_cast<float>(room - bodies_->skin + more) * kRoundedUp;
    }
    for (std::size_t p = 0; p < pairs; ++p) {
      const double more = (half + ask_.floor) * self_travel_[s * pairs + p];
      pair_grown_.data()[p * kRows + i] = static_cast<float>(own + more) * kRoundedUp;
    }
  }
  checks += filled;
  filter_.look_grown(rows_.data(), filled, grown_.data(), pair_grown_.data(), of == nullptr ? nullptr : &of->bodies,
                     of == nullptr ? nullptr : &of->pairs);
}

// The bound on how fast points of a body move in a piece, by where its middle is; the robot is there.
double PathProof::speed_in(const Piece& piece, std::size_t body, const Frames& frames, double known) {
  const std::size_t nv = v_.size();
  for (std::size_t k = 0; k < nv; ++k) v_[k] = piece.half() * ask_.v[piece.segment * nv + k];
  return std::min(known, bounds_.tight(*bodies_, frames, 0, body, v_.data()) / piece.half());
}

PathProof::Motion PathProof::motion_in(const Piece& piece, std::size_t body, std::size_t other,
                                       const Frames& frames) const {
  const Tree& tree = bodies_->tree;
  const double* v = ask_.v + piece.segment * v_.size();
  Motion motion;
  for (int m = 0; m < tree.motions(); ++m) {
    if (!tree.supports(bodies_->joint[body], m)) continue;
    if (other != kNone && tree.supports(bodies_->joint[other], m)) continue;
    const double *column = frames.J + 6 * m, speed = v[tree.coordinate[m]];
    const Vec3 angular = speed * Vec3(column[3], column[4], column[5]);
    motion.linear += speed * Vec3(column[0], column[1], column[2]);
    motion.angular += angular;
    motion.turning += angular.norm();
  }
  return motion;
}

// The least n.x of a body's points x at a time t from the middle of a piece, as if their ways were straight: with a
// twist (l, w) it is n.x + t (n.l + n.(w x x)), which is that of another direction, and a support of the body.
double PathProof::lowest(const Motion& motion, double t, std::size_t body, const Vec3& normal,
                         const Frames& frames) const {
  const Vec3 direction = normal + t * normal.cross(motion.angular);
  const double length = direction.norm();
  return t * normal.dot(motion.linear) - length * bodies_->extent(frames, 0, body, -direction / length);
}

// A lower bound of a pair's distance all through a piece in which no point moves further than `move` from its middle,
// by the normal of a plane between the two. Along it their ways, if they are straight, come nearest at an end of the
// piece, for a least of linear functions is concave. They bend: a point's acceleration is at most twice the sum of all
// turning times its speed, so by half of that, times the time squared.
double PathProof::beyond_plane(const Piece& piece, const SphereOpen& open, double move, const Vec3& normal,
                               const Frames& at) const {
  if (!(std::abs(normal.squaredNorm() - 1.0) < kUnit)) return -INFINITY;
  const double half = piece.half();
  if (open.self) {
    const std::size_t one = self_.body(open.body, 0), two = self_.body(open.body, 1);
    const Motion first = motion_in(piece, one, two, at), second = motion_in(piece, two, one, at);
    double least = INFINITY;
    for (const double t : {-half, half}) {
      least = std::min(least, lowest(first, t, one, -normal, at) + lowest(second, t, two, normal, at));
    }
    return least - half * std::max(first.turning, second.turning) * move - GJK_EXCESS;
  }
  if (parts_.solids[open.other].block) return -INFINITY;
  const Motion motion = motion_in(piece, open.body, kNone, at);
  const double least =
      std::min(lowest(motion, -half, open.body, normal, at), lowest(motion, half, open.body, normal, at));
  return least - parts_.extent(open.other, normal) - half * motion.turning * move + bodies_->skin - GJK_EXCESS;
}

// Look at pieces. What they leave open is to be divided further, as long as that may help. False where nothing more is
// wanted.
bool PathProof::look(Piece* now, std::size_t filled, Piece* of, Queries& ask, std::int8_t* states) {
  const std::size_t nv = v_.size(), count = bodies_->size(), pairs = self_.size();
  open_in(now, filled, of, ask_.clearance, ask_.self_clearance);
  for (std::uint32_t row = 0; row < filled; ++row) {
    Piece& piece = now[row];
    const double half = piece.half();
    bool placed = false, hopeless = piece.depth + kHalvings > ask_.depth;
    std::size_t body = bodies_->size();
    double speed = 0.0;
    for (const SphereOpen& open : filter_.open()) {
      if (open.row != row) continue;
      if (!placed) at(&rows_[row * nv], ask);
      placed = true;
      if (!open.self && open.body != body) {
        body = open.body;
        speed = speed_in(piece, body, ask.frames, speed_[body * kRows + row]);
      }
      const std::size_t s = piece.segment;
      const double travel = open.self ? self_travel_[s * pairs + open.body] : travel_[s * count + open.body];
      const double move = half * (open.self ? travel : speed);
      if (2.0 * move <= kExactTravel) {
        const double needed = (open.self ? ask_.self_clearance : ask_.clearance) + ask_.floor * travel;
        Vec3& normal = kept_normal(open);  // that of a piece nearby: a plane is sooner asked than the distance
        if (beyond_plane(piece, open, move, normal, ask.frames) > needed) continue;
        const Found found = exact(open, ask);
        normal = found.direction;
        if (found.distance > needed + move) continue;
        if (!(found.distance > needed)) {
          hopeless = true;
        } else if (beyond_plane(piece, open, move, normal, ask.frames) > needed) {
          continue;
        }
      }
      std::vector<std::uint32_t>& left = open.self ? piece.pairs : piece.bodies;
      if (!left.empty() && left.back() == open.body) continue;
      left.push_back(open.body);
      if (!open.self) piece.speed.push_back(speed);
    }
    if (piece.bodies.empty() && piece.pairs.empty()) continue;
    if (!hopeless) {
      todo_.push_back(std::move(piece));
    } else {
      states[piece.segment] = 1;
      if (ask_.all) return false;
    }
  }
  return true;
}

double PathProof::least(const double* rows, const double* v, std::size_t n, double tolerance, double most) {
  const std::size_t nv = v_.size();
  Queries ask(narrow_, {T_.data(), J_.data(), 1}, parts_);
  ask_ = {rows, v, 0.0, 0.0, 0, false, 0.0};
  set_travel(n);
  self_travel_.assign((n - 1) * self_.size(), 0.0);
  double nearest = most;
  // A pair's distance, or a bound of it that is further than the nearest so far by more than `room`.
  const auto measure = [&](const SphereOpen& open, double room) {
    Vec3 one, two;
    bodies_->ends_at(ask.frames, 0, open.body, one, two);
    const double bound = capsule_bound(*bodies_, one, two, open.body, parts_, open.other, nullptr, 0.0);
    if (bound > std::max(nearest, 0.0) + room) return Found{bound, Vec3::Zero(), Vec3::Zero()};
    ++queries;
    Found found = ask.exact(0, open.body, open.other, nullptr);
    found.distance -= GJK_EXCESS;
    nearest = std::min(nearest, found.distance);
    return found;
  };
  at(rows, ask);
  for (std::uint32_t g = 0; g < bodies_->size(); ++g) {
    for (std::uint32_t p = 0; p < parts_.count() && !filter_.moves(g); ++p) measure({0, 0, g, p}, 0.0);
  }
  // The nearest of all at the rows: most of the rest is never looked at.
  const auto each_open = [&](std::uint32_t row, const double* q, const auto& look_at) {
    bool placed = false;
    for (const SphereOpen& open : filter_.open()) {
      if (open.row != row || open.self) continue;
      if (!placed) at(q, ask);
      placed = true;
      look_at(open);
    }
  };
  std::vector<std::uint32_t> none;
  for (double reach = kFirstReach; reach < nearest; reach *= 2.0) {
    std::fill_n(grown_.data(), bodies_->size() * kRows, static_cast<float>(reach));
    for (std::size_t k = 0; k < n; k += kRows) {
      const std::size_t filled = std::min<std::size_t>(kRows, n - k);
      checks += filled;
      filter_.look_grown(rows + k * nv, filled, grown_.data(), nullptr, &moved_, &none);
      for (std::uint32_t i = 0; i < filled; ++i) {
        each_open(i, rows + (k + i) * nv, [&](const SphereOpen& open) { measure(open, 0.0); });
      }
    }
  }
  todo_.clear();
  Piece now[kRows];
  const auto look_at = [&](std::size_t filled, Piece* of) {
    open_in(now, filled, of, std::max(nearest - tolerance, 0.0), 0.0);  // spheres do not say how deep shapes are
    for (std::uint32_t i = 0; i < filled; ++i) {
      Piece& piece = now[i];
      const double half = piece.half();
      std::size_t body = bodies_->size();
      double speed = 0.0;
      each_open(i, &rows_[i * nv], [&](const SphereOpen& open) {
        if (open.body != body) speed = speed_in(piece, body = open.body, ask.frames, speed_[open.body * kRows + i]);
        const double move = half * speed;
        Vec3& normal = kept_normal(open);
        if (beyond_plane(piece, open, move, normal, ask.frames) > nearest - tolerance) return;
        const Found found = measure(open, move);
        normal = found.direction;
        if (found.distance - move > nearest - tolerance) return;
        if (beyond_plane(piece, open, move, normal, ask.frames) > nearest - tolerance) return;
        if (!piece.bodies.empty() && piece.bodies.back() == open.body) return;
        piece.bodies.push_back(open.body);
        piece.speed.push_back(speed);
      });
      if (!piece.bodies.empty() && piece.depth + kHalvings < kMostHalvings) todo_.push_back(std::move(piece));
    }
  };
  for (std::size_t s = 0; s + 1 < n; s += kRows) {
    const std::size_t filled = std::min<std::size_t>(kRows, n - 1 - s);
    for (std::size_t i = 0; i < filled; ++i) now[i] = {s + i, 0.0, 1.0, 0, {}, {}, {}};
    look_at(filled, nullptr);
  }
  while (!todo_.empty()) {
    Piece piece = std::move(todo_.back());
    todo_.pop_back();
    divide(piece, now);
    look_at(kRows, &piece);
  }
  return nearest - tolerance;
}

}  // namespace strips
