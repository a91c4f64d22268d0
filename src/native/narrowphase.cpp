#include "narrowphase.hpp"

#include <algorithm>
#include <cmath>

namespace strips {

bool Moving::at(double place, std::size_t part, Vec3& s, double& u) const {
  if (mover == nullptr || mover[part] < 0) return false;
  const std::size_t node = std::min(static_cast<std::size_t>(place), nodes - 1);
  const double f = place - static_cast<double>(node);
  const std::size_t k = node * movers + static_cast<std::size_t>(mover[part]), next = node + 1 < nodes ? k + movers : k;
  for (int i = 0; i < 3; ++i) s[i] = (1.0 - f) * shift[3 * k + i] + f * shift[3 * next + i];
  u = (1.0 - f) * uncertainty[k] + f * uncertainty[next];  // it is convex in time, so that this bounds it
  return true;
}

const Solid& Parts::solid(std::size_t part) const {
  Solid& solid = solids[part];
  if (!solid.key()) {
    const double* half = box_half + 3 * part;
    solid = primitive("box", {2.0 * half[0], 2.0 * half[1], 2.0 * half[2]}, 0.0);
  }
  return solid;
}

double capsule_bound(const Bodies& bodies, const Vec3& one, const Vec3& two, std::size_t body, const Parts& parts,
                     std::size_t part, const Vec3* shift, double uncertainty) {
  const double* R = parts.rotation + 9 * part;
  const double *t = parts.translation + 3 * part, *center = parts.box_center + 3 * part,
               *half = parts.box_half + 3 * part;
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

PlacedBox::PlacedBox(const Bodies& bodies, const Frames& frames, std::size_t node, std::size_t body)
    : skin_(bodies.skin) {
  const coal::AABB& box = bodies.solids[body].shape->aabb_local;
  Vec3 t;
  bodies.placement(frames, node, body, R_, t);
  center_ = R_ * (0.5 * (box.min_ + box.max_)) + t;
  half_ = 0.5 * (box.max_ - box.min_);
  world_half_ = R_.cwiseAbs() * half_;
}

double PlacedBox::bound(const Parts& parts, std::size_t part, const Vec3* shift, double uncertainty) const {
  const Mat3 R = Eigen::Map<const Mat3>(parts.rotation + 9 * part);
  const Vec3 half = Eigen::Map<const Vec3>(parts.box_half + 3 * part);
  Vec3 between = R * Eigen::Map<const Vec3>(parts.box_center + 3 * part) +
                 Eigen::Map<const Vec3>(parts.translation + 3 * part) - center_;
  if (shift != nullptr) between += *shift;
  // two boxes are at least as far apart as the boxes about them in any frame: in the world's and in the body's
  const Vec3 gaps = (between.cwiseAbs() - world_half_ - R.cwiseAbs() * half).cwiseMax(0.0);
  const Mat3 own = R_.transpose() * R;
  const Vec3 own_gaps = ((R_.transpose() * between).cwiseAbs() - half_ - own.cwiseAbs() * half).cwiseMax(0.0);
  const double apart = std::max(gaps.squaredNorm(), own_gaps.squaredNorm());
  return apart > 0.0 ? std::sqrt(apart) + skin_ - uncertainty : -FAR;  // of how deep they are it says nothing
}

void Narrowphase::turn_to(const Parts& parts) {
  if (parts.stamp == stamp_) return;
  stamp_ = 0;
  std::unordered_map<const void*, PerBody> kept;
  table_.assign(parts.count(), nullptr);
  for (std::size_t p = 0; p < parts.count() && !(pairs_.empty() && kept.empty()); ++p) {
    const void* key = parts.solids[p].key();
    if (key == nullptr) continue;  // it was never asked for
    auto known = kept.find(key);
    if (known == kept.end()) {
      auto former = pairs_.extract(key);
      if (former.empty()) continue;
      known = kept.insert(std::move(former)).position;
    }
    table_[p] = &known->second;
  }
  pairs_ = std::move(kept);
  stamp_ = parts.stamp;
}

const ShapePair& Narrowphase::pair(const Parts& parts, std::size_t body, std::size_t part) {
  const Solid& solid = parts.solid(part);
  PerBody*& entry = table_[part];
  if (entry == nullptr) {
    entry = &pairs_[solid.key()];
    entry->resize(bodies->size());
  }
  auto& made = (*entry)[body];
  if (!made) made = std::make_unique<ShapePair>(bodies->solids[body].shape, solid.shape);
  return *made;
}

Found Queries::exact(std::size_t node, std::size_t body, std::size_t part, const Vec3* shift) {
  const bool other = node != last_node_ || body != last_body_;
  if (other || shift != nullptr) {
    narrow.bodies->placement(frames, node, body, body_R_, body_t_);
    if (shift != nullptr) body_t_ -= *shift;  // the obstacle moves one way, or the robot the other
    body_pose_.setTransform(body_R_, body_t_);
    last_node_ = shift == nullptr ? node : kNone;
    last_body_ = body;
  }
  Found found;
  PairSolver& solver = narrow.solver_;
  if (parts.solids[part].block) {
    found = cluster(body, part);
  } else {
    if (part != last_part_) {
      const double *R = parts.rotation + 9 * part, *t = parts.translation + 3 * part;
      part_pose_.setTransform(Mat3(Eigen::Map<const Mat3>(R)), Vec3(t[0], t[1], t[2]));
      last_part_ = part;
    }
    found.distance = solver.ask(narrow.pair(parts, body, part), body_pose_, part_pose_);
    found.direction = -solver.normal();
    found.witness = solver.first();
  }
  if (shift != nullptr) found.witness += *shift;
  found.distance += narrow.bodies->skin;
  return found;
}

// Nearest box of a block, through the block's tree, in the block's own frame.
Found Queries::cluster(std::size_t body, std::size_t part) {
  auto& probes = narrow.probes_;
  if (probes.empty()) probes.resize(narrow.bodies->size());
  if (!probes[body]) {  // Coal's box–sphere special case does not keep the smallest of several distances
    probes[body] = std::make_unique<coal::CollisionObject>(sphere_as_capsule(narrow.bodies->solids[body].shape));
  }
  coal::CollisionObject& probe = *probes[body];
  const Mat3 R = Eigen::Map<const Mat3>(parts.rotation + 9 * part);
  const Vec3 t(parts.translation[3 * part], parts.translation[3 * part + 1], parts.translation[3 * part + 2]);
  probe.setTransform(Transform3s(R.transpose() * body_R_, R.transpose() * (body_t_ - t)));
  probe.computeAABB();
  PairSolver& solver = narrow.solver_;
  const double d = solver.ask(*parts.solids[part].block, probe);
  // here shape 1 is the tree's box and shape 2 the robot: the normal already leads away
  return {d, R * solver.normal(), R * solver.second() + t};
}

}  // namespace strips
