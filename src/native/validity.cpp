#include "validity.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace strips {

constexpr double kMostSteps = 1e9;  // looked at along one motion

Validity::Validity(std::shared_ptr<const Bodies> bodies, const Parts& parts, std::vector<std::int64_t> self_pairs,
                   const double* radius, double margin, double self_margin)
    : bodies_(bodies),
      narrow_(bodies, true),
      self_(bodies, self_pairs, true),
      parts_(parts),
      bounds_{radius, bodies->size()},
      margin_(margin),
      self_margin_(self_margin),
      filter_(*bodies, parts, self_pairs, margin, self_margin),
      axes_(bodies->size() * parts.count()),
      self_axes_(self_.size()) {
  const std::size_t nv = static_cast<std::size_t>(bodies_->tree.nv);
  T_.assign(static_cast<std::size_t>(bodies_->tree.joints) * 12, 0.0);
  T_[0] = T_[5] = T_[10] = 1.0;
  rows_.assign(kRows * nv, 0.0);
  v_.assign(nv, 0.0);
  const Tree& tree = bodies_->tree;
  for (std::size_t g = 0; g < bodies_->size() && tree.planar; ++g) {
    bool alone = true;
    for (int m = 0; m < tree.motions(); ++m) {
      alone = alone && !(tree.coordinate[m] >= tree.base_nv() && tree.supports(bodies_->joint[g], m));
    }
    if (alone) base_.push_back(static_cast<std::uint32_t>(g));
  }
}

std::unique_ptr<Validity> Validity::another() const {
  std::vector<std::int64_t> pairs;
  for (std::size_t k = 0; k < self_.size(); ++k) {
    for (int one = 0; one < 2; ++one) pairs.push_back(static_cast<std::int64_t>(self_.body(k, one)));
  }
  return std::make_unique<Validity>(bodies_, parts_, pairs, bounds_.radius, margin_, self_margin_);
}

bool Validity::valid(const double* coordinates) {
  ++checks;
  return touching(coordinates, 1, true) == 0;
}

void Validity::each(const double* rows, std::size_t n, bool base, std::int8_t* states) {
  checks += n;
  for (std::size_t k = 0; k < n; k += kRows) {
    const std::size_t count = std::min<std::size_t>(kRows, n - k);
    const unsigned bad = touching(rows + k * static_cast<std::size_t>(bodies_->tree.nv), count, false, base);
    for (std::size_t i = 0; i < count; ++i) states[k + i] = static_cast<std::int8_t>(bad >> i & 1u);
  }
}

// Bits of those of rows (count ≤ 8, nv) that are not valid, by their spheres, and where these do not decide by the
// shapes; with `first` one is enough, with `base` only what the base alone moves counts.
unsigned Validity::touching(const double* rows, std::size_t count, bool first, bool base) {
  const std::size_t nv = static_cast<std::size_t>(bodies_->tree.nv);
  unsigned bad = filter_.look(rows, count, first, base ? &base_ : nullptr);
  if (first && bad != 0) return bad;
  const Frames frames{T_.data(), nullptr, 1};
  Queries ask(narrow_, frames, parts_);
  if (!rest_) {
    place(bodies_->tree, rows, 1, T_.data(), nullptr, 1);
    rest_ = rest_is_clear(frames);
  }
  if (!*rest_) return kEvery;
  for (std::size_t lane = 0; lane < count && !filter_.open().empty(); ++lane) {
    bool placed = false;
    for (const SphereOpen& open : filter_.open()) {
      if (open.row != lane || (bad >> lane & 1u) != 0) continue;
      if (!placed) {
        place(bodies_->tree, rows + lane * nv, 1, T_.data(), nullptr, 1);
        ask.forget();
        placed = true;
      }
      if (open.self ? clear_of_itself(frames, open.body) : apart(frames, ask, open.body, open.other)) continue;
      bad |= 1u << lane;
      if (first) return bad;
    }
  }
  return bad;
}

bool Validity::rest_is_clear(const Frames& frames) {
  Queries ask(narrow_, frames, parts_);
  for (std::size_t g = 0; g < bodies_->size(); ++g) {
    for (std::size_t p = 0; p < parts_.count() && !filter_.moves(g); ++p) {
      if (!apart(frames, ask, g, p)) return false;
    }
  }
  for (std::size_t s = 0; s < self_.size(); ++s) {
    if (!filter_.moves(self_.body(s, 0)) && !filter_.moves(self_.body(s, 1)) && !clear_of_itself(frames, s))
      return false;
  }
  return true;
}

bool Validity::motion(const double* a, const double* b, double step) {
  const Tree& tree = bodies_->tree;
  difference(tree, a, b, v_.data());
  double travel = 0.0;
  for (std::size_t g = 0; g < bodies_->size(); ++g) travel = std::max(travel, bounds_.travel(tree, v_.data(), g));
  const double steps = std::ceil(travel / step);
  if (!(step > 0.0 && steps <= kMostSteps)) throw std::invalid_argument("a motion or a step of it that is no number");
  const std::size_t count = std::max<std::size_t>(1, static_cast<std::size_t>(steps));
  const std::size_t nv = static_cast<std::size_t>(tree.nv);
  std::copy(b, b + nv, rows_.begin());
  std::size_t filled = 1, stride = 1;
  const auto looked_at = [&] {
    checks += filled;
    const bool clear = touching(rows_.data(), filled, true) == 0;
    filled = 0;
    return clear;
  };
  while (stride < count) stride *= 2;
  for (; stride > 1; stride /= 2) {
    for (std::size_t k = stride / 2; k < count; k += stride) {
      if (filled == kRows && !looked_at()) return false;
      integrate(tree, a, v_.data(), static_cast<double>(k) / static_cast<double>(count), &rows_[filled++ * nv]);
    }
  }
  return filled == 0 || looked_at();
}

bool Validity::clear_of_itself(const Frames& frames, std::size_t pair) {
  const std::int64_t number = static_cast<std::int64_t>(pair);
  if (self_.lower_bound(frames, 0, number) > self_margin_) return true;
  const std::size_t one = self_.body(pair, 0), two = self_.body(pair, 1);
  const double* T = frames.at(bodies_->joint[one], 0);
  Mat3 R;
  R << T[0], T[1], T[2], T[4], T[5], T[6], T[8], T[9], T[10];
  Axis& axis = self_axes_[pair];
  if (!axis.normal.isZero()) {
    const Vec3 n = R * axis.normal;
    if (bodies_->extent(frames, 0, one, n) + bodies_->extent(frames, 0, two, -n) < -self_margin_) return true;
  }
  if (!(or_deep([&] { return self_.query(frames, 0, number); }) > self_margin_)) return false;
  axis.normal = R.transpose() * self_.solver().normal();
  return true;
}

bool Validity::apart(const Frames& frames, Queries& ask, std::size_t body, std::size_t part) {
  Vec3 one, two;
  bodies_->ends_at(frames, 0, body, one, two);
  if (capsule_bound(*bodies_, one, two, body, parts_, part, nullptr, 0.0) > margin_) return true;
  Axis& axis = axes_[body * parts_.count() + part];
  const double room = margin_ - bodies_->skin;
  if (!axis.normal.isZero() && -axis.reach - bodies_->extent(frames, 0, body, axis.normal) > room) return true;
  Found found{};
  found.direction.setZero();
  const double distance = or_deep([&] {
    found = ask.exact(0, body, part, nullptr);
    return found.distance;
  });
  if (!(distance > margin_)) return false;
  const auto& shape = parts_.solids[part].shape;
  if (!shape) return true;  // a block has no one direction
  axis.normal = -found.direction;
  axis.reach = parts_.extent(part, found.direction);
  return true;
}

}  // namespace strips
