// Whether configurations and motions keep a margin to all obstacles and do not touch themselves: what a planner asks.
#pragma once

#include "certificate.hpp"

namespace strips {

class Validity {
 public:
  // `radius` (M, G) are the static radii of MotionBounds, of motions. It keeps no parts and no radii.
  Validity(std::shared_ptr<const Bodies> bodies, const Parts& parts, std::vector<std::int64_t> self_pairs,
           const double* radius, double margin);
  Validity(const Validity&) = delete;
  Validity& operator=(const Validity&) = delete;

  bool valid(const double* coordinates);

  // The straight motion but for its start, looked at wherever some point may have moved by `step`, its middle first.
  bool motion(const double* a, const double* b, double step);

  const Tree& tree() const { return bodies_->tree; }
  std::size_t checks = 0;

 private:
  // A direction in which two shapes were apart when they were last measured; no length where they never were.
  struct Axis {
    Vec3 normal = Vec3::Zero();
    double reach = 0.0;
  };

  bool clear_of_parts(const Frames& frames);
  bool clear_of_itself(const Frames& frames, std::size_t pair);
  double extent(const Frames& frames, std::size_t body, const Vec3& direction);

  std::shared_ptr<const Bodies> bodies_;
  Narrowphase narrow_;
  SelfPairs self_;
  const Parts& parts_;
  Bounds bounds_;
  double margin_;
  std::vector<double> low_, high_;  // (P, 3) boxes about the parts in the world, grown by the margin
  std::vector<double> T_;           // placements of one node
  std::vector<std::size_t> near_, order_, self_order_;  // what hit last comes first
  std::vector<Axis> axes_, self_axes_;                  // (G, P) in the world, (S) in the frame of the first body
};

}  // namespace strips
