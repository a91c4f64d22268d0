// Rays, and where they first meet convex bodies: closed forms of primitives, planes of polyhedra, and a tree of boxes.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "geometry.hpp"

namespace strips {

// Bodies in frames of their own. `size` has half lengths of a box, of a polyhedron those of the box about its origin
// that holds it; else the radius and the half length along z.
class RayBodies {
 public:
  enum Kind : std::int64_t { BOX, SPHERE, CYLINDER, CAPSULE, CONE, POLYHEDRON, KINDS };

  // The planes (K, 4) of body p are those from start[p] on: n x <= d inside, by unit normals n.
  RayBodies(const std::int64_t* kind, const double* size, const std::int64_t* start, const double* planes,
            std::size_t count);

  std::size_t size() const { return kind_.size(); }

  // Rotations (P, 3, 3) and origins (P, 3) of the bodies' frames in that of the rays.
  void place(const double* rotation, const double* translation);

  // Rays of unit directions (R, 3), from one origin or each from its own. `distance` (R) becomes that at
  // which a body is met, where that is less and within `reach`; a ray that begins in a body meets it at `inside`. Then
  // `normal` (R, 3), where it is not null, becomes the outward normal there.
  void cast(const double* origin, bool common, const double* direction, std::size_t count, double reach, double inside,
            double* distance, double* normal) const;

 private:
  struct Node {
    float low[3], high[3];
    std::uint32_t first, count;  // of the bodies in `order_`; where there are none, `first` is the second child
  };
  struct Hit {
    double enter, leave;
  };

  void split(std::uint32_t node, std::uint32_t first, std::uint32_t last);
  Hit meet(std::size_t body, const double* o, const double* d) const;
  Vec3 normal_at(std::size_t body, const Vec3& point) const;

  std::vector<std::int64_t> kind_;
  std::vector<double> size_, planes_;
  std::vector<std::size_t> start_;
  std::vector<double> rotation_, translation_;
  std::vector<float> box_, middle_;  // (P, 6) low and high, (P, 3)
  std::vector<std::uint32_t> order_;
  std::vector<Node> nodes_;
};

}  // namespace strips
