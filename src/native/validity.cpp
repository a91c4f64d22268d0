#include "validity.hpp"

#include <coal/narrowphase/support_functions.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <stdexcept>

namespace strips {

constexpr double kMostSteps = 1e9;  // looked at along one motion

// The largest component of a shape's points along a direction in its own frame.
static double reach_of(const coal::ShapeBase& shape, const Vec3& direction) {
  int hint = 0;
  return direction.dot(
      coal::details::getSupport<coal::details::SupportOptions::WithSweptSphere>(&shape, direction, hint));
}

static void to_front(std::vector<std::size_t>& order, std::size_t at) {
  std::rotate(order.begin(), order.begin() + at, order.begin() + at + 1);
}

Validity::Validity(std::shared_ptr<const Bodies> bodies, const Parts& parts, std::vector<std::int64_t> self_pairs,
                   const double* radius, double margin)
    : bodies_(bodies),
      narrow_(bodies, true),
      self_(bodies, std::move(self_pairs), true),
      parts_(parts),
      bounds_{radius, bodies->size()},
      margin_(margin),
      order_(bodies->size()),
      self_order_(self_.size()),
      axes_(bodies->size() * parts.count()),
      self_axes_(self_.size()) {
  for (std::size_t p = 0; p < parts_.count(); ++p) {
    const double *R = parts_.rotation + 9 * p, *center = parts_.box_center + 3 * p, *half = parts_.box_half + 3 * p;
    for (int i = 0; i < 3; ++i) {
      double middle = parts_.translation[3 * p + i], reach = margin_;
      for (int k = 0; k < 3; ++k) {
        middle += R[3 * i + k] * center[k];
        reach += std::abs(R[3 * i + k]) * half[k];
      }
      low_.push_back(middle - reach);
      high_.push_back(middle + reach);
    }
  }
  T_.assign(static_cast<std::size_t>(bodies_->tree.joints) * 12, 0.0);
  T_[0] = T_[5] = T_[10] = 1.0;
  std::iota(order_.begin(), order_.end(), 0);
  std::iota(self_order_.begin(), self_order_.end(), 0);
}

bool Validity::valid(const double* coordinates) {
  ++checks;
  place(bodies_->tree, coordinates, 1, T_.data(), nullptr, 1);
  const Frames frames{T_.data(), nullptr, 1};
  if (!clear_of_parts(frames)) return false;
  for (std::size_t k = 0; k < self_order_.size(); ++k) {
    if (clear_of_itself(frames, self_order_[k])) continue;
    to_front(self_order_, k);
    return false;
  }
  return true;
}

bool Validity::motion(const double* a, const double* b, double step) {
  const Tree& tree = bodies_->tree;
  std::vector<double> v(tree.nv), row(tree.nv);
  difference(tree, a, b, v.data());
  double travel = 0.0;
  for (std::size_t g = 0; g < bodies_->size(); ++g) travel = std::max(travel, bounds_.travel(tree, v.data(), g));
  const double steps = std::ceil(travel / step);
  if (!(step > 0.0 && steps <= kMostSteps)) throw std::invalid_argument("a motion or a step of it that is no number");
  const std::size_t count = std::max<std::size_t>(1, static_cast<std::size_t>(steps));
  if (!valid(b)) return false;
  std::size_t stride = 1;
  while (stride < count) stride *= 2;
  for (; stride > 1; stride /= 2) {
    for (std::size_t k = stride / 2; k < count; k += stride) {
      integrate(tree, a, v.data(), static_cast<double>(k) / static_cast<double>(count), row.data());
      if (!valid(row.data())) return false;
    }
  }
  return true;
}

// How far a body reaches along a direction in the world.
double Validity::extent(const Frames& frames, std::size_t body, const Vec3& direction) {
  Mat3 R;
  Vec3 t;
  bodies_->placement(frames, 0, body, R, t);
  return direction.dot(t) + reach_of(*bodies_->solids[body].shape, R.transpose() * direction);
}

bool Validity::clear_of_itself(const Frames& frames, std::size_t pair) {
  const std::int64_t number = static_cast<std::int64_t>(pair);
  if (self_.lower_bound(frames, 0, number) > 0.0) return true;
  const std::size_t one = self_.body(pair, 0), two = self_.body(pair, 1);
  const double* T = frames.at(bodies_->joint[one], 0);
  Mat3 R;
  R << T[0], T[1], T[2], T[4], T[5], T[6], T[8], T[9], T[10];
  Axis& axis = self_axes_[pair];
  if (!axis.normal.isZero()) {
    const Vec3 n = R * axis.normal;
    if (extent(frames, one, n) + extent(frames, two, -n) < 0.0) return true;
  }
  if (self_.query(frames, 0, number) <= 0.0) return false;
  axis.normal = R.transpose() * self_.solver().normal();
  return true;
}

bool Validity::clear_of_parts(const Frames& frames) {
  const std::size_t count = bodies_->size();
  std::vector<Vec3> ends(2 * count);
  double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
  for (std::size_t g = 0; g < count; ++g) {
    Vec3 &one = ends[2 * g], &two = ends[2 * g + 1];
    bodies_->ends_at(frames, 0, g, one, two);
    for (int i = 0; i < 3; ++i) {
      low[i] = std::min(low[i], std::min(one[i], two[i]) - bodies_->radius[g]);
      high[i] = std::max(high[i], std::max(one[i], two[i]) + bodies_->radius[g]);
    }
  }
  near_.clear();
  for (std::size_t p = 0; p < parts_.count(); ++p) {
    const double *least = &low_[3 * p], *most = &high_[3 * p];
    if (least[0] <= high[0] && low[0] <= most[0] && least[1] <= high[1] && low[1] <= most[1] && least[2] <= high[2] &&
        low[2] <= most[2]) {
      near_.push_back(p);
    }
  }
  Queries ask(narrow_, frames, parts_);
  for (std::size_t k = 0; k < count; ++k) {
    const std::size_t g = order_[k];
    for (std::size_t p : near_) {
      if (capsule_bound(*bodies_, ends[2 * g], ends[2 * g + 1], g, parts_, p, nullptr, 0.0) > margin_) continue;
      Axis& axis = axes_[g * parts_.count() + p];
      const double room = margin_ - bodies_->skin;
      if (!axis.normal.isZero() && -axis.reach - extent(frames, g, axis.normal) > room) continue;
      const Found found = ask.exact(0, g, p, nullptr);
      if (found.distance <= margin_) {
        to_front(order_, k);
        return false;
      }
      const auto& shape = parts_.solids[p].shape;
      if (!shape) continue;  // a block has no one direction
      axis.normal = -found.direction;
      const Mat3 R = Eigen::Map<const Mat3>(parts_.rotation + 9 * p);
      axis.reach = found.direction.dot(Vec3(Eigen::Map<const Vec3>(parts_.translation + 3 * p))) +
                   reach_of(*shape, R.transpose() * found.direction);
    }
  }
  return true;
}

}  // namespace strips
