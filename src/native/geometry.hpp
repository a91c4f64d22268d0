// Shapes of Coal, pairs of them and blocks of boxes, and their signed distances to the last digits.
#pragma once

#include <coal/broadphase/broadphase_dynamic_AABB_tree.h>
#include <coal/collision_object.h>
#include <coal/distance.h>
#include <coal/shape/convex.h>
#include <coal/shape/geometric_shapes.h>

#include <cstdint>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "constants.hpp"

namespace strips {

using Vec3 = Eigen::Vector3d;
using Mat3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
using coal::Transform3s;

// What Python gets as an error of this name of errors.py, the one that the twin raises.
struct Failure : std::runtime_error {
  Failure(const char* error, const char* what) : std::runtime_error(what), name(error) {}
  const char* name;
};

// A distance that is asked for, or one that is far below any where two are so deep in each other that Coal finds none:
// whoever only wants to know whether they are far enough apart is answered by that.
template <typename Ask>
double or_deep(const Ask& ask) {
  try {
    return ask();
  } catch (const Failure&) {
    return -FAR;
  }
}

// The largest component of a shape's points along a direction in its own frame.
double reach_of(const coal::ShapeBase& shape, const Vec3& direction);

// Many boxes in one of Coal's trees, in the frame of the part that they make up.
struct Block {
  std::vector<std::unique_ptr<coal::CollisionObject>> members;
  coal::DynamicAABBTreeCollisionManager tree;

  Block() = default;
  Block(const Block&) = delete;
  Block& operator=(const Block&) = delete;
};

// A convex shape, or a block of boxes: exactly one of the two is there.
struct Solid {
  std::shared_ptr<coal::ShapeBase> shape;
  std::shared_ptr<Block> block;

  const void* key() const { return shape ? static_cast<const void*>(shape.get()) : block.get(); }
};

// `size` has what Coal's constructor of this kind takes: sides of a box, radius (and length), radii.
Solid primitive(const std::string& kind, const std::vector<double>& size, double swept);
Solid convex(const double* points, std::size_t count, const std::uint32_t* triangles, std::size_t faces, double swept);
Solid block(const double* sides, const double* at, std::size_t count);

// Coal's functors for two shapes: `apart` to begin with, `deep` and `fine` once they penetrate. They are three because
// one that failed at a fine tolerance may go on failing at any.
struct ShapePair {
  std::shared_ptr<coal::ShapeBase> one, two;            // a functor does not keep what it was made of
  std::shared_ptr<coal::ShapeBase> deep_one, deep_two;  // as Coal finds their depth
  coal::ComputeDistance apart, deep, fine;

  ShapePair(std::shared_ptr<coal::ShapeBase> a, std::shared_ptr<coal::ShapeBase> b);
};

// Requests and one result, of one thread.
class PairSolver {
 public:
  PairSolver();

  bool shallow = false;  // where shapes touch, the distance is 0, no depth, and nothing is proven

  // Signed distance [m]; `normal`, `first` and `second` then hold what Coal found.
  double ask(const ShapePair& pair, const Transform3s& one, const Transform3s& two);

  // Distance of a probe, a shape at a pose in the block's frame, to the nearest box of a block, or the deepest: then
  // `normal` points from the box to the probe, and `second` lies on the probe.
  double ask(const Block& block, coal::CollisionObject& probe);

  const Vec3& normal() const { return result_.normal; }
  const Vec3& first() const { return result_.nearest_points[0]; }
  const Vec3& second() const { return result_.nearest_points[1]; }

 private:
  double penetration(const ShapePair& pair, const Transform3s& one, const Transform3s& two);
  // A distance that is positive, or what a normal proves where it is more.
  double proven(const ShapePair& pair, const Transform3s& one, const Transform3s& two, double d);

  coal::DistanceResult result_;
  coal::DistanceRequest apart_, touch_, deep_, fine_;
  std::vector<coal::DistanceRequest> coarse_;
};

// A sphere as a capsule of no length, which keeps out of Coal's closed forms for spheres; others as they are.
std::shared_ptr<coal::ShapeBase> sphere_as_capsule(const std::shared_ptr<coal::ShapeBase>& shape);

}  // namespace strips
