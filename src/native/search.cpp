#include "search.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <future>
#include <optional>
#include <thread>

namespace strips {

namespace {

constexpr double kFirstRadius = 2.0, kLeastRadius = 0.5;  // scaled, of a node from which a motion was not valid
constexpr double kRegrowth = 1e-3;                        // of such a radius each time that a place is too far for it
constexpr double kLeastGain = 0.98;                       // of a shortcut: the new length by the old one
constexpr double kMostTurn = 0.49;                        // of a circular joint's period that it goes evenly, at most
constexpr double kLeastLength = 1e-12;                    // scaled, that is divided by
constexpr std::size_t kRoot = static_cast<std::size_t>(-1), kNever = kRoot;
constexpr std::size_t kHeadStart = 2000;                      // checks that the first search makes alone
constexpr std::uint64_t kOtherSeed = std::uint64_t{1} << 32;  // from the first search's seed to the second's

double now() { return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count(); }

double length(const std::vector<double>& v) {
  double sum = 0.0;
  for (double x : v) sum += x * x;
  return std::sqrt(sum);
}

}  // namespace

// SplitMix64: a counter, its bits mixed.
double Draws::next() {
  std::uint64_t z = (state += 0x9e3779b97f4a7c15u);
  z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
  z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
  return static_cast<double>((z ^ (z >> 31)) >> 11) * 0x1.0p-53;
}

TreeSearch::TreeSearch(Validity& valid, const SearchSpace& space, const SearchLimits& limits, std::uint64_t seed,
                       const double* start, const double* goal, double end, std::size_t head_start,
                       const std::atomic<std::size_t>& most)
    : valid_(valid),
      space_(space),
      limits_(limits),
      start_(start),
      goal_(goal),
      end_(end),
      head_start_(head_start),
      most_(most),
      draws_{seed},
      one_(space.nv),
      two_(space.nv),
      drawn_(space.size()),
      next_(space.size()),
      checked_before_(valid.checks) {}

bool TreeSearch::over() const {
  return spent() >= std::min(limits_.checks, most_.load(std::memory_order_relaxed)) || now() >= end_;
}

void TreeSearch::towards(const double* from, const double* to, std::vector<double>& v) const {
  v.resize(space_.size());
  for (std::size_t k = 0; k < v.size(); ++k) {
    v[k] = to[k] - from[k];
    if (space_.period[k] > 0.0) v[k] -= space_.period[k] * std::nearbyint(v[k] / space_.period[k]);
  }
}

void TreeSearch::add(TreeOf& tree, const std::vector<double>& at, std::size_t parent) const {
  const std::size_t n = tree.size(), count = space_.size();
  if (n % kRows == 0) tree.blocks.resize(tree.blocks.size() + count * kRows, INFINITY);
  for (std::size_t k = 0; k < count; ++k) {
    tree.blocks[(n / kRows * count + k) * kRows + n % kRows] = static_cast<float>(at[k]);
  }
  tree.at.insert(tree.at.end(), at.begin(), at.end());
  tree.radius.push_back(INFINITY);
  tree.parent.push_back(parent);
}

std::size_t TreeSearch::nearest(const TreeOf& tree, const double* to, double& distance) const {
  const std::size_t count = space_.size();
  float least = INFINITY;
  std::size_t best = 0;
  for (std::size_t b = 0; b * kRows < tree.size(); ++b) {
    float sum[kRows] = {};
    for (std::size_t k = 0; k < count; ++k) {
      const float *x = &tree.blocks[(b * count + k) * kRows], at = static_cast<float>(to[k]);
      const float period = static_cast<float>(space_.period[k]);
      for (int i = 0; i < kRows; ++i) {
        float d = std::abs(x[i] - at);
        if (period > 0.0f) d = std::min(d, std::abs(period - d));  // two places of one turn
        sum[i] += d * d;
      }
    }
    for (int i = 0; i < kRows; ++i) {
      if (sum[i] < least) {
        least = sum[i];
        best = b * kRows + static_cast<std::size_t>(i);
      }
    }
  }
  distance = std::sqrt(static_cast<double>(least));
  return best;
}

const double* TreeSearch::row(const double* at, std::vector<double>& out) const {
  std::copy(start_, start_ + space_.nv, out.begin());
  for (std::size_t k = 0; k < space_.size(); ++k) out[space_.first + k] = at[k] / space_.scale[k];
  return out.data();
}

bool TreeSearch::motion(const double* a, const double* b) {
  const double* from = row(a, one_);
  return valid_.motion(from, row(b, two_), limits_.step);
}

// Grow one tree towards a place that is drawn and the other one to where that led; whether they meet, and where.
bool TreeSearch::grown(TreeOf& tree, TreeOf& other, std::size_t& reached, std::size_t& met) {
  const std::size_t count = space_.size();
  for (std::size_t k = 0; k < count; ++k) drawn_[k] = space_.low[k] + draws_.next() * (space_.high[k] - space_.low[k]);
  double distance;
  const std::size_t from = nearest(tree, drawn_.data(), distance);
  if (distance > tree.radius[from]) {
    tree.radius[from] *= 1.0 + kRegrowth;
    return false;
  }
  if (distance == 0.0) return false;
  towards(&tree.at[from * count], drawn_.data(), v_);
  const double part = std::min(1.0, limits_.range / distance);
  for (std::size_t k = 0; k < count; ++k) next_[k] = tree.at[from * count + k] + part * v_[k];
  if (!motion(&tree.at[from * count], next_.data())) {
    double& radius = tree.radius[from];
    radius = std::isinf(radius) ? kFirstRadius : std::max(kLeastRadius, radius * (1.0 - kRegrowth));
    return false;
  }
  if (!std::isinf(tree.radius[from])) tree.radius[from] *= 1.0 + kRegrowth;
  add(tree, next_, from);
  reached = tree.size() - 1;
  met = nearest(other, next_.data(), distance);
  towards(&other.at[met * count], next_.data(), v_);
  const std::size_t steps = std::max<std::size_t>(1, static_cast<std::size_t>(std::ceil(distance / limits_.range)));
  const std::vector<double> begin(&other.at[met * count], &other.at[met * count] + count);
  for (std::size_t k = 1; k <= steps && !over(); ++k) {
    const double share = static_cast<double>(k) / static_cast<double>(steps);
    for (std::size_t i = 0; i < count; ++i) next_[i] = begin[i] + v_[i] * share;
    if (!motion(&other.at[met * count], next_.data())) return false;
    if (k == steps) return true;
    add(other, next_, met);
    met = other.size() - 1;
  }
  return false;
}

std::vector<double> TreeSearch::path(const std::function<void()>& each) {
  const std::size_t count = space_.size();
  std::vector<double> ends[2] = {std::vector<double>(count), std::vector<double>(count)}, points;
  for (std::size_t k = 0; k < count; ++k) {
    ends[0][k] = start_[space_.first + k] * space_.scale[k];
    ends[1][k] = goal_[space_.first + k] * space_.scale[k];
  }
  TreeOf trees[2];
  for (int k = 0; k < 2; ++k) add(trees[k], ends[k], kRoot);
  std::size_t met[2] = {0, 0};
  bool found = motion(ends[0].data(), ends[1].data());
  for (int which = 1; !found && !over(); each()) {
    // in turns, and the smaller one again
    if (trees[1 - which].size() <= trees[which].size()) which = 1 - which;
    found = grown(trees[which], trees[1 - which], met[which], met[1 - which]);
  }
  if (!found) return points;
  std::vector<std::size_t> nodes;
  for (std::size_t k = met[0]; k != kRoot; k = trees[0].parent[k]) nodes.push_back(k);
  std::reverse(nodes.begin(), nodes.end());
  const auto take = [&](int which, std::size_t k) {
    const double* at = &trees[which].at[k * count];
    points.insert(points.end(), at, at + count);
  };
  for (std::size_t k : nodes) take(0, k);
  for (std::size_t k = met[1]; k != kRoot; k = trees[1].parent[k]) take(1, k);
  return points;
}

std::vector<double> TreeSearch::rows(const std::vector<double>& points) const {
  const std::size_t nv = space_.nv, n = points.size() / space_.size();
  std::vector<double> out, one(nv);
  for (std::size_t k = 0; k < n; ++k) {
    row(&points[k * space_.size()], one);
    out.insert(out.end(), one.begin(), one.end());
  }
  if (n > 0) {
    std::copy(start_, start_ + nv, out.begin());
    std::copy(goal_, goal_ + nv, out.end() - static_cast<std::ptrdiff_t>(nv));
  }
  return out;
}

// Leave out each corner whose neighbours are joined by a valid motion.
void TreeSearch::skip_corners(std::vector<double>& points) {
  const std::size_t count = space_.size();
  for (std::size_t k = 1; (k + 1) * count < points.size() && !over();) {
    if (motion(&points[(k - 1) * count], &points[(k + 1) * count])) {
      const auto at = points.begin() + static_cast<std::ptrdiff_t>(k * count);
      points.erase(at, at + static_cast<std::ptrdiff_t>(count));
    } else {
      ++k;
    }
  }
}

// Lengths along a path, from its start to each of its corners.
void TreeSearch::measure(const std::vector<double>& points) {
  const std::size_t count = space_.size();
  along_.assign(1, 0.0);
  for (std::size_t k = count; k < points.size(); k += count) {
    towards(&points[k - count], &points[k], v_);
    along_.push_back(along_.back() + length(v_));
  }
}

// The segment that a place is in, and the place.
std::size_t TreeSearch::place(const std::vector<double>& points, double s, std::vector<double>& into) {
  std::size_t k = static_cast<std::size_t>(std::upper_bound(along_.begin(), along_.end(), s) - along_.begin());
  k = std::min(std::max<std::size_t>(k, 1), along_.size() - 1) - 1;
  const double* at = &points[k * space_.size()];
  towards(at, at + space_.size(), v_);
  const double part = (s - along_[k]) / std::max(along_[k + 1] - along_[k], kLeastLength);
  into.assign(at, at + space_.size());
  for (std::size_t i = 0; i < into.size(); ++i) into[i] += part * v_[i];
  return k;
}

// Of corners (m, K) from `first` to `last`, the second of which is number `before` of the path, one joint goes evenly;
// it is drawn by how much of its motion that saves. Returns whether that is enough of it to try.
bool TreeSearch::evened(std::vector<double>& middle, double first, double last, std::size_t before, double drawn) {
  const std::size_t count = space_.size();
  std::vector<double> net(count, 0.0), total(count, 0.0);
  for (std::size_t k = count; k < middle.size(); k += count) {
    towards(&middle[k - count], &middle[k], v_);
    for (std::size_t i = 0; i < count; ++i) {
      net[i] += v_[i];
      total[i] += std::abs(v_[i]);
    }
  }
  double saved = 0.0;
  for (std::size_t i = 0; i < count; ++i) saved += (total[i] - std::abs(net[i])) / space_.scale[i];
  double left = drawn * saved;
  std::size_t joint = 0;
  for (; joint + 1 < count; ++joint) {  // the last one where rounding leaves a rest
    left -= (total[joint] - std::abs(net[joint])) / space_.scale[joint];
    if (left < 0.0) break;
  }
  const double one = std::abs(net[joint]);
  if (one > kLeastGain * total[joint] || (space_.period[joint] > 0.0 && one > kMostTurn * space_.period[joint])) {
    return false;
  }
  for (std::size_t k = 1; (k + 1) * count < middle.size(); ++k) {
    const double share = (along_[before + k - 1] - first) / (last - first);
    middle[k * count + joint] = middle[joint] + share * net[joint];
  }
  middle[middle.size() - count + joint] = middle[joint] + net[joint];
  return true;
}

std::vector<double> TreeSearch::shortened(std::vector<double> points, int tries) {
  const std::size_t count = space_.size();
  skip_corners(points);
  measure(points);
  std::vector<double> one, two, middle;
  for (int k = 0; k < tries && points.size() > 2 * count && !over(); ++k) {
    double s = draws_.next() * along_.back(), t = draws_.next() * along_.back();
    if (s > t) std::swap(s, t);
    const std::size_t i = place(points, s, one), j = place(points, t, two);
    const auto first = points.begin() + static_cast<std::ptrdiff_t>((i + 1) * count),
               last = points.begin() + static_cast<std::ptrdiff_t>((j + 1) * count);
    middle = one;
    if (k % 2 == 1) middle.insert(middle.end(), first, last);  // one joint goes evenly, the others as before
    middle.insert(middle.end(), two.begin(), two.end());
    const double drawn = k % 2 == 1 ? draws_.next() : 0.0;
    if (i == j) continue;
    if (k % 2 == 0) {  // straight
      towards(one.data(), two.data(), v_);
      if (length(v_) > kLeastGain * (t - s)) continue;
    } else if (!evened(middle, s, t, i + 1, drawn)) {
      continue;
    }
    bool clear = true;
    for (std::size_t m = count; clear && m < middle.size(); m += count) clear = motion(&middle[m - count], &middle[m]);
    if (!clear) continue;
    std::vector<double> shorter(points.begin(), first);
    shorter.insert(shorter.end(), middle.begin(), middle.end());
    shorter.insert(shorter.end(), last, points.end());
    points = std::move(shorter);
    measure(points);
  }
  skip_corners(points);
  return points;
}

std::vector<double> found_path(Validity& valid, const SearchSpace& space, const SearchLimits& limits,
                               std::uint64_t seed, const double* start, const double* goal, int tries) {
  const double end = now() + limits.seconds;
  const std::size_t before = valid.checks;
  std::atomic<std::size_t> most[2] = {kNever, kNever};
  std::unique_ptr<Validity> other;
  std::optional<TreeSearch> searches[2];
  std::vector<double> points[2];
  const auto search = [&](std::size_t which, const std::function<void()>& each) {
    points[which] = searches[which]->path(each);
    if (!points[which].empty()) most[1 - which] = searches[which]->spent();
  };
  const auto second = [&] {
    other = valid.another();
    searches[1].emplace(*other, space, limits, seed + kOtherSeed, start, goal, end, kHeadStart, most[1]);
    search(1, [] {});
  };
  searches[0].emplace(valid, space, limits, seed, start, goal, end, 0, most[0]);
  std::future<void> beside;
  const bool cores = std::thread::hardware_concurrency() > 1;
  search(0, [&] {
    if (cores && !beside.valid() && searches[0]->spent() >= kHeadStart) beside = std::async(std::launch::async, second);
  });
  if (beside.valid()) {
    beside.get();
  } else if (searches[0]->spent() >= kHeadStart) {
    second();
  }
  const bool later = !points[1].empty() && (points[0].empty() || searches[1]->spent() < searches[0]->spent());
  TreeSearch& best = *searches[later ? 1 : 0];
  most[later ? 1 : 0] = kNever;
  const std::vector<double> rows = best.rows(best.shortened(points[later ? 1 : 0], tries));
  // what both make at once counts once
  valid.checks = before + (rows.empty() && searches[1] ? std::max(best.spent(), searches[1]->spent()) : best.spent());
  return rows;
}

}  // namespace strips
