// Whether configurations and motions keep a margin to all obstacles and do not touch themselves: what a planner asks.
#pragma once

#include <optional>

#include "certificate.hpp"
#include "filter.hpp"

namespace strips {

class Validity {
 public:
  // `radius` (M, G) are the static radii of MotionBounds, of motions. It keeps no parts and no radii.
  Validity(std::shared_ptr<const Bodies> bodies, const Parts& parts, std::vector<std::int64_t> self_pairs,
           const double* radius, double margin, double self_margin);
  Validity(const Validity&) = delete;
  Validity& operator=(const Validity&) = delete;

  // One of the same, for another thread.
  std::unique_ptr<Validity> another() const;

  bool valid(const double* coordinates);

  // States (n) of rows (n, nv): 0 where one is valid, else 1; with `base` where what no joint moves is.
  void each(const double* rows, std::size_t n, bool base, std::int8_t* states);

  // The straight motion but for its start, looked at wherever some point may have moved by `step`, its middle first.
  bool motion(const double* a, const double* b, double step);

  const Tree& tree() const { return bodies_->tree; }
  std::size_t checks = 0;  // configurations looked at, of a motion by eights

 private:
  // A direction in which two shapes were apart when they were last measured; no length where they never were.
  struct Axis {
    Vec3 normal = Vec3::Zero();
    double reach = 0.0;
  };

  unsigned touching(const double* rows, std::size_t count, bool first, bool base = false);
  bool rest_is_clear(const Frames& frames);
  bool apart(const Frames& frames, Queries& ask, std::size_t body, std::size_t part);
  bool clear_of_itself(const Frames& frames, std::size_t pair);

  std::shared_ptr<const Bodies> bodies_;
  Narrowphase narrow_;
  SelfPairs self_;
  const Parts& parts_;
  Bounds bounds_;
  const double margin_, self_margin_;
  SphereFilter filter_;
  std::vector<std::uint32_t> base_;     // bodies that the base alone moves
  std::optional<bool> rest_;            // whether what no joint moves is clear: it is, or never is
  std::vector<double> T_, rows_, v_;    // placements of one node; rows (8, nv); a tangent
  std::vector<Axis> axes_, self_axes_;  // (G, P) in the world, (S) in the frame of the first body
};

}  // namespace strips
