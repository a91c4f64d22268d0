#include "validity.hpp"

#include <algorithm>
#include <cmath>

namespace strips {

Validity::Validity(std::shared_ptr<const Bodies> bodies, const std::vector<std::shared_ptr<Solid>>& parts,
                   std::vector<std::int64_t> self_pairs, const PartPoses& poses, double margin)
    : bodies_(bodies), narrow_(bodies), self_(bodies, std::move(self_pairs)), poses_(poses), margin_(margin) {
  narrow_.set_parts(parts);
  for (std::size_t p = 0; p < poses_.count; ++p) {
    const double *R = poses_.rotation + 9 * p, *center = poses_.box_center + 3 * p, *half = poses_.box_half + 3 * p;
    for (int i = 0; i < 3; ++i) {
      double middle = poses_.translation[3 * p + i], reach = margin_;
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
}

bool Validity::valid(const double* coordinates) {
  place(bodies_->tree, coordinates, 1, T_.data(), nullptr, 1);
  const Frames frames{T_.data(), nullptr, 1};
  if (!clear_of_parts(frames)) return false;
  for (std::size_t s = 0; s < self_.size(); ++s) {
    const std::int64_t pair = static_cast<std::int64_t>(s);
    if (self_.lower_bound(frames, 0, 0.0, pair) <= 0.0 && self_.distance(frames, 0, 0.0, pair) <= 0.0) return false;
  }
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
  for (std::size_t p = 0; p < poses_.count; ++p) {
    const double *least = &low_[3 * p], *most = &high_[3 * p];
    if (least[0] <= high[0] && low[0] <= most[0] && least[1] <= high[1] && low[1] <= most[1] && least[2] <= high[2] &&
        low[2] <= most[2]) {
      near_.push_back(p);
    }
  }
  narrow_.begin();
  for (std::size_t g = 0; g < count; ++g) {
    for (std::size_t p : near_) {
      if (capsule_bound(*bodies_, ends[2 * g], ends[2 * g + 1], g, poses_, p, nullptr, 0.0) > margin_) continue;
      if (narrow_.query(frames, 0, g, p, poses_, nullptr).distance <= margin_) return false;
    }
  }
  return true;
}

}  // namespace strips
