// Bodies against the parts of a scene: capsule–box bounds, and Coal's exact distances; see Narrowphase.
#pragma once

#include <unordered_map>

#include "robot.hpp"

namespace strips {

// World poses (P, 3, 3), (P, 3) of parts, and the boxes about them in their frames (P, 3); see CandidateParts.
struct PartPoses {
  const double *rotation, *translation, *box_center, *box_half;
  std::size_t count;
};

// Where the obstacles that move will be: shift (N, M, 3) and uncertainty (N, M) at nodes; mover (P), -1 for what
// stands.
struct Moving {
  const double *shift = nullptr, *uncertainty = nullptr;
  const std::int64_t* mover = nullptr;
  std::size_t movers = 0, nodes = 0;

  // Shift and uncertainty of a part at a node.
  bool at(std::size_t node, std::size_t part, Vec3& s, double& u) const;
  // The same at a place, which is a node's number with a fraction.
  bool between(double place, std::size_t part, Vec3& s, double& u) const;
};

// Lower bound of a body's distance to a part's box, the part moved by `shift`, and less what it is uncertain by.
double capsule_bound(const Bodies& bodies, const Vec3& one, const Vec3& two, std::size_t body, const PartPoses& poses,
                     std::size_t part, const Vec3* shift, double uncertainty);

// What an exact query found, in the world's frame; the direction leads away from the obstacle.
struct Found {
  double distance;
  Vec3 direction, witness;
};

class Narrowphase {
 public:
  explicit Narrowphase(std::shared_ptr<const Bodies> bodies) : bodies(std::move(bodies)) {}

  Narrowphase(const Narrowphase&) = delete;
  Narrowphase& operator=(const Narrowphase&) = delete;

  // The solids of the P parts from here on; what is known of those that stay is kept.
  void set_parts(const std::vector<std::shared_ptr<Solid>>& parts);

  // Begin queries at other frames, or after poses have changed.
  void begin() { node_ = body_ = part_ = kNone; }

  Found query(const Frames& frames, std::size_t node, std::size_t body, std::size_t part, const PartPoses& poses,
              const Vec3* shift);

  // Distances are 0 where shapes touch, from here on; the shape of a part is null where it is a block.
  void shallow() { solver_.shallow = true; }
  const coal::ShapeBase* shape(std::size_t part) const { return parts_[part]->shape.get(); }

  std::shared_ptr<const Bodies> bodies;
  std::size_t queries = 0, prepared = 0;

 private:
  static constexpr std::size_t kNone = static_cast<std::size_t>(-1);
  using Key = std::pair<std::size_t, const void*>;
  struct Hash {
    std::size_t operator()(const Key& key) const { return std::hash<const void*>()(key.second) * 31 + key.first; }
  };

  const ShapePair& pair(std::size_t body, std::size_t part);
  Found cluster(std::size_t body, std::size_t part, const PartPoses& poses);

  std::vector<std::shared_ptr<Solid>> parts_;
  std::vector<const ShapePair*> table_;  // (G, P), null until they are asked for
  std::unordered_map<Key, std::unique_ptr<ShapePair>, Hash> pairs_;
  std::vector<std::unique_ptr<coal::CollisionObject>> probes_;  // (G), for blocks
  PairSolver solver_;
  // the body's and the part's pose of the last query
  std::size_t node_ = kNone, body_ = kNone, part_ = kNone;
  Mat3 R_;
  Vec3 t_;
  Transform3s body_pose_, part_pose_;
};

}  // namespace strips
