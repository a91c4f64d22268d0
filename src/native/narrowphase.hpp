// Bodies against the parts of a scene: capsule–box bounds, and Coal's exact distances; see Narrowphase.
#pragma once

#include <map>
#include <mutex>

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
  std::size_t nodes = 0, movers = 0, parts = 0;

  // Shift and uncertainty of a part at a place, which is a node's number with a fraction.
  bool at(double place, std::size_t part, Vec3& s, double& u) const;
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

  // The solids of the P parts from here on; what is known of those that stay is kept.
  void set_parts(const std::vector<Solid>& parts);
  std::size_t parts() const { return parts_.size(); }

  // Distances are 0 where shapes touch, from here on; the shape of a part is null where it is a block.
  void shallow() { solver_.shallow = true; }
  const coal::ShapeBase* shape(std::size_t part) const { return parts_[part].shape.get(); }

  std::shared_ptr<const Bodies> bodies;
  std::mutex busy;  // held by the thread that is inside

 private:
  friend struct Queries;
  using Key = std::pair<std::size_t, const void*>;

  const ShapePair& pair(std::size_t body, std::size_t part);

  std::vector<Solid> parts_;
  std::vector<const ShapePair*> table_;  // (G, P), null until they are asked for
  std::map<Key, std::unique_ptr<ShapePair>> pairs_;
  std::vector<std::unique_ptr<coal::CollisionObject>> probes_;  // (G), for blocks
  PairSolver solver_;
};

constexpr std::size_t kNone = static_cast<std::size_t>(-1);

struct Counts {
  std::size_t pairs = 0, queries = 0;
};

// Queries of a narrow phase at frames and poses that stay as they are as long as this is there.
struct Queries {
  Narrowphase& narrow;
  const Frames frames;
  const PartPoses poses;
  const Moving moving;
  Counts counts = {};
  // the body's and the part's pose of the last query
  std::size_t last_node = kNone, last_body = kNone, last_part = kNone;
  Mat3 body_R = {};
  Vec3 body_t = {};
  Transform3s body_pose = {}, part_pose = {};

  Found exact(std::size_t node, std::size_t body, std::size_t part, const Vec3* shift);
  Found cluster(std::size_t body, std::size_t part);
};

}  // namespace strips
