#include "narrowphase.hpp"

#include <algorithm>
#include <cmath>

namespace strips {

bool Moving::at(std::size_t node, std::size_t part, Vec3& s, double& u) const {
  if (mover == nullptr || mover[part] < 0) return false;
  const std::size_t k = node * movers + static_cast<std::size_t>(mover[part]);
  s = Vec3(shift[3 * k], shift[3 * k + 1], shift[3 * k + 2]);
  u = uncertainty[k];
  return true;
}

bool Moving::between(double place, std::size_t part, Vec3& s, double& u) const {
  if (mover == nullptr || mover[part] < 0) return false;
  const std::size_t segment = std::min(static_cast<std::size_t>(place), nodes - 2);
  const double f = place - static_cast<double>(segment);
  const std::size_t k = segment * movers + static_cast<std::size_t>(mover[part]), next = k + movers;
  for (int i = 0; i < 3; ++i) s[i] = (1.0 - f) * shift[3 * k + i] + f * shift[3 * next + i];
  u = (1.0 - f) * uncertainty[k] + f * uncertainty[next];  // it is convex in time, so that this bounds it
  return true;
}

double capsule_bound(const Bodies& bodies, const Vec3& one, const Vec3& two, std::size_t body, const PartPoses& poses,
                     std::size_t part, const Vec3* shift, double uncertainty) {
  const double* R = poses.rotation + 9 * part;
  const double *t = poses.translation + 3 * part, *center = poses.box_center + 3 * part,
               *half = poses.box_half + 3 * part;
  Vec3 middle = 0.5 * (one + two);
  if (shift != nullptr) middle -= *shift;
  const double x = middle[0] - t[0], y = middle[1] - t[1], z = middle[2] - t[2];
  double sum = 0.0;
  for (int i = 0; i < 3; ++i) {
    const double gap = std::abs(x * R[i] + y * R[3 + i] + z * R[6 + i] - center[i]) - half[i];
    if (gap > 0.0) sum += gap * gap;
  }
  return std::sqrt(sum) - 0.5 * (two - one).norm() - bodies.radius[body] - uncertainty;
}

void Narrowphase::set_parts(const std::vector<std::shared_ptr<Solid>>& parts) {
  parts_ = parts;
  std::unordered_map<Key, std::unique_ptr<ShapePair>, Hash> kept;
  table_.assign(bodies->size() * parts_.size(), nullptr);
  for (std::size_t g = 0; g < bodies->size(); ++g) {
    for (std::size_t p = 0; p < parts_.size(); ++p) {
      const Key key(g, parts_[p]->key());
      auto known = kept.find(key);
      if (known == kept.end()) {
        auto former = pairs_.find(key);
        if (former == pairs_.end()) continue;
        known = kept.emplace(key, std::move(former->second)).first;
        pairs_.erase(former);
      }
      table_[g * parts_.size() + p] = known->second.get();
    }
  }
  pairs_ = std::move(kept);
  begin();
}

const ShapePair& Narrowphase::pair(std::size_t body, std::size_t part) {
  const ShapePair*& entry = table_[body * parts_.size() + part];
  if (entry == nullptr) {
    auto& made = pairs_[Key(body, parts_[part]->key())];
    if (!made) {
      made = std::make_unique<ShapePair>(bodies->solids[body].shape, parts_[part]->shape);
      ++prepared;
    }
    entry = made.get();
  }
  return *entry;
}

Found Narrowphase::query(const Frames& frames, std::size_t node, std::size_t body, std::size_t part,
                         const PartPoses& poses, const Vec3* shift) {
  ++queries;
  const bool other = node != node_ || body != body_;
  if (other || shift != nullptr) {
    bodies->placement(frames, node, body, R_, t_);
    if (shift != nullptr) t_ -= *shift;  // the obstacle moves one way, or the robot the other
    body_pose_.setTransform(R_, t_);
    node_ = shift == nullptr ? node : kNone;
    body_ = body;
  }
  Found found;
  if (parts_[part]->block) {
    found = cluster(body, part, poses);
  } else {
    if (part != part_) {
      const double *R = poses.rotation + 9 * part, *t = poses.translation + 3 * part;
      part_pose_.setTransform(Mat3(Eigen::Map<const Mat3>(R)), Vec3(t[0], t[1], t[2]));
      part_ = part;
    }
    found.distance = solver_.ask(pair(body, part), body_pose_, part_pose_);
    found.direction = -solver_.normal();
    found.witness = solver_.first();
  }
  if (shift != nullptr) found.witness += *shift;
  found.distance += bodies->skin;
  return found;
}

// Nearest box of a block, through the block's tree, in the block's own frame.
Found Narrowphase::cluster(std::size_t body, std::size_t part, const PartPoses& poses) {
  if (probes_.empty()) probes_.resize(bodies->size());
  if (!probes_[body]) {  // Coal's box–sphere special case does not keep the smallest of several distances
    probes_[body] = std::make_unique<coal::CollisionObject>(sphere_as_capsule(bodies->solids[body].shape));
  }
  coal::CollisionObject& probe = *probes_[body];
  const Mat3 R = Eigen::Map<const Mat3>(poses.rotation + 9 * part);
  const Vec3 t(poses.translation[3 * part], poses.translation[3 * part + 1], poses.translation[3 * part + 2]);
  probe.setTransform(Transform3s(R.transpose() * R_, R.transpose() * (t_ - t)));
  probe.computeAABB();
  const double d = solver_.ask(*parts_[part]->block, probe);
  // here shape 1 is the tree's box and shape 2 the robot: the normal already leads away
  return {d, R * solver_.normal(), R * solver_.second() + t};
}

}  // namespace strips
