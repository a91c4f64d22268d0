// Trees of spheres that hold bodies: what they leave free is free, whatever the shapes are.
#pragma once

#include "geometry.hpp"

namespace strips {

// A shape is within the hull of corners grown by `swept`. The half spaces of the normals with the offsets `inner` meet
// within it, and it lies within those with the offsets `outer`, grown likewise.
struct Hull {
  std::vector<Vec3> corners, normals;
  std::vector<std::pair<std::uint32_t, std::uint32_t>> edges;  // pairs of corners; none where any may be one
  std::vector<double> inner, outer;
  double swept = 0.0;

  explicit Hull(const coal::ShapeBase& shape);
  // How deep a point lies in the shape's hull, at least, and the direction out of it.
  double depth(const Vec3& at, Vec3& out) const;

 private:
  void box(const Vec3& half, double part);
  void round(double radius, double half, bool tip);
  void facets(const coal::Convex<coal::Triangle>& shape);
};

// The spheres of one body in preorder, in the frame of its shape: the spheres of all leaves hold it together, and each
// sphere holds what those below it do.
struct SphereTree {
  struct Sphere {
    float center[3];
    float outer;             // radius [m], rounded up
    float inner;             // of a sphere about the same centre that lies in the body, rounded down; 0 where none does
    std::uint32_t next = 0;  // the first sphere that is not below this one: a leaf's is its own successor
  };
  std::vector<Sphere> spheres;
};

// At most `most` leaves; what sticks out by less than `fine` [m] is not divided further.
SphereTree sphere_tree(const coal::ShapeBase& shape, std::size_t most, double fine);

}  // namespace strips
