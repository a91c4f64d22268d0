// Bodies against the parts of a scene: capsule–box bounds, and Coal's exact distances; see Narrowphase.
#pragma once

#include <atomic>
#include <mutex>
#include <unordered_map>

#include "robot.hpp"

namespace strips {

// Parts of a scene: their solids, world poses (P, 3, 3), (P, 3), and the boxes about them in their frames (P, 3); see
// CandidateParts. What knows parts by their numbers carries the stamp of those that it means.
struct SphereWorld;

struct Parts {
  const double *rotation, *translation, *box_center, *box_half;
  mutable std::vector<Solid> solids = {};  // those of boxes are empty until they are asked for by `solid`
  std::size_t stamp = ++stamps;            // no two are the same, and none is 0
  // What spheres are held against, of parts that stay where they are; made once.
  std::shared_ptr<Once<std::shared_ptr<const SphereWorld>>> kept =
      std::make_shared<Once<std::shared_ptr<const SphereWorld>>>();

  std::size_t count() const { return solids.size(); }
  // The solid of a part: where none was given, the box about it. For whoever has the parts for himself.
  const Solid& solid(std::size_t part) const;
  // How far a part that is one convex shape, and was asked for before, reaches along a direction in the world.
  double extent(std::size_t part, const Vec3& direction) const {
    const Mat3 R = Eigen::Map<const Mat3>(rotation + 9 * part);
    return direction.dot(Vec3(Eigen::Map<const Vec3>(translation + 3 * part))) +
           reach_of(*solids[part].shape, R.transpose() * direction);
  }
  static inline std::atomic<std::size_t> stamps = 0;
};

// Where the obstacles that move will be: shift (N, M, 3) and uncertainty (N, M) at nodes; mover (P), -1 for what
// stands.
struct Moving {
  const double *shift = nullptr, *uncertainty = nullptr;
  const std::int64_t* mover = nullptr;
  std::size_t nodes = 0, movers = 0, parts = 0, stamp = 0;

  // Shift and uncertainty of a part at a place, which is a node's number with a fraction.
  bool at(double place, std::size_t part, Vec3& s, double& u) const;
};

// Lower bound of a body's distance to a part's box, the part moved by `shift`, and less what it is uncertain by.
double capsule_bound(const Bodies& bodies, const Vec3& one, const Vec3& two, std::size_t body, const Parts& parts,
                     std::size_t part, const Vec3* shift, double uncertainty);

// A body's box in the frame of its shape, and the box about it in the world's, at a node.
struct PlacedBox {
  PlacedBox(const Bodies& bodies, const Frames& frames, std::size_t node, std::size_t body);

  // Lower bound of the body's distance to a part's box, as that of capsule_bound.
  double bound(const Parts& parts, std::size_t part, const Vec3* shift, double uncertainty) const;

 private:
  Mat3 R_;
  Vec3 center_, half_, world_half_;
  double skin_;
};

// What an exact query found, in the world's frame; the direction leads away from the obstacle.
struct Found {
  double distance;
  Vec3 direction, witness;
};

class Narrowphase {
 public:
  // Distances are 0 where shapes touch, if it is shallow.
  explicit Narrowphase(std::shared_ptr<const Bodies> robot, bool shallow = false) : bodies(std::move(robot)) {
    solver_.shallow = shallow;
  }

  const std::shared_ptr<const Bodies> bodies;
  std::mutex busy;  // held by the thread that is inside

 private:
  friend class Queries;
  using PerBody = std::vector<std::unique_ptr<ShapePair>>;  // pairs of each body (G) with a solid, null until asked for

  // Pairs with these parts; of those before, what stays is kept, and the others are forgotten.
  void turn_to(const Parts& parts);
  const ShapePair& pair(const Parts& parts, std::size_t body, std::size_t part);

  std::size_t stamp_ = 0;                                       // of the parts that the table is for
  std::vector<PerBody*> table_;                                 // (P), null until they are asked for
  std::unordered_map<const void*, PerBody> pairs_;              // by the solid's key
  std::vector<std::unique_ptr<coal::CollisionObject>> probes_;  // (G), for blocks
  PairSolver solver_;
};

constexpr std::size_t kNone = static_cast<std::size_t>(-1);

struct Counts {
  std::size_t pairs = 0, queries = 0;
};

// Queries of a narrow phase at frames and poses that stay as they are as long as this is there.
class Queries {
 public:
  Queries(Narrowphase& asked, const Frames& at, const Parts& of, const Moving& forecast = {})
      : narrow(asked), frames(at), parts(of), moving(forecast) {
    narrow.turn_to(parts);
  }

  Found exact(std::size_t node, std::size_t body, std::size_t part, const Vec3* shift);
  void forget() { last_node_ = kNone; }  // the frames are others now

  Narrowphase& narrow;
  const Frames frames;
  const Parts& parts;
  const Moving moving;
  Counts counts;

 private:
  Found cluster(std::size_t body, std::size_t part);

  // the body's and the part's pose of the last query
  std::size_t last_node_ = kNone, last_body_ = kNone, last_part_ = kNone;
  Mat3 body_R_;
  Vec3 body_t_;
  Transform3s body_pose_, part_pose_;
};

}  // namespace strips
