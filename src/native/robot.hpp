// A robot as plain numbers: its joints' tree, its bodies as capsules, and where they are for many configurations.
#pragma once

#include <cstdint>
#include <vector>

#include <mutex>

#include "geometry.hpp"
#include "spheres.hpp"

namespace strips {

// SE(2) × Rⁿ on coordinate rows; see ConfigurationSpace.
struct Space {
  int nv = 0;
  bool planar = false;
  std::vector<std::uint8_t> circular;  // (nv - base_nv)

  int base_nv() const { return planar ? 3 : 0; }
};

// Joints whose frames are turned so that each moves about or along its z, and their M motions; see KinematicTree. Joint
// i does motion[i], -1 for the universe and a planar root; motion m is rate[m] * q[coordinate[m]] + shift[m].
struct Tree : Space {
  int joints = 0;
  std::vector<std::int64_t> parents, motion, coordinate;  // (joints), (joints), (M)
  std::vector<std::uint8_t> prismatic, support;           // (joints), (joints, M)
  std::vector<double> offset, rate, shift;                // (joints, 4, 4), (M), (M)

  int motions() const { return static_cast<int>(coordinate.size()); }
  bool supports(std::int64_t joint, int m) const { return support[joint * motions() + m] != 0; }
};

// Placements (joints, capacity, 3, 4) and Jacobian columns (capacity, M, 6) of nodes; see Kinematics.
struct Frames {
  const double* T;
  const double* J;  // may be null
  std::size_t capacity;

  const double* at(std::int64_t joint, std::size_t node) const { return T + (joint * capacity + node) * 12; }
};

// Placements of configurations (n, nv), and their Jacobian columns where J is not null.
void place(const Tree& tree, const double* coordinates, std::size_t n, double* T, double* J, std::size_t capacity);

// The tangent from `a` to `b`, and where `scale` times a tangent leads from `a`.
void difference(const Space& space, const double* a, const double* b, double* v);
void integrate(const Space& space, const double* a, const double* v, double scale, double* out);

// R p + t of a 3 × 4 placement, row by row.
inline Vec3 moved(const double* T, const double* p) {
  return {T[0] * p[0] + T[1] * p[1] + T[2] * p[2] + T[3], T[4] * p[0] + T[5] * p[1] + T[6] * p[2] + T[7],
          T[8] * p[0] + T[9] * p[1] + T[10] * p[2] + T[11]};
}

// What is made when it is asked for first.
template <typename T>
struct Once {
  std::once_flag flag;
  T value;
};

// Convex bodies fixed to joints, and capsules that hold them; see BodySet.
struct Bodies {
  Tree tree;
  std::vector<Solid> solids;
  std::vector<std::int64_t> joint;
  std::vector<double> rotation, translation;  // (G, 3, 3), (G, 3) of the shape in its joint's frame
  std::vector<double> ends, radius;           // (G, 2, 3), (G,)
  double skin = 0.0;
  std::shared_ptr<Once<std::vector<SphereTree>>> kept = std::make_shared<Once<std::vector<SphereTree>>>();

  std::size_t size() const { return joint.size(); }

  // Spheres that hold each body; made once.
  const std::vector<SphereTree>& spheres() const;

  // Ends of a body's capsule at a node.
  void ends_at(const Frames& frames, std::size_t node, std::size_t body, Vec3& one, Vec3& two) const {
    const double* T = frames.at(joint[body], node);
    one = moved(T, &ends[body * 6]);
    two = moved(T, &ends[body * 6 + 3]);
  }

  // Pose of a body's shape at a node.
  void placement(const Frames& frames, std::size_t node, std::size_t body, Mat3& R, Vec3& t) const {
    const double* T = frames.at(joint[body], node);
    const double* r = &rotation[body * 9];
    for (int i = 0; i < 3; ++i) {
      for (int k = 0; k < 3; ++k) {
        R(i, k) = T[4 * i] * r[k] + T[4 * i + 1] * r[3 + k] + T[4 * i + 2] * r[6 + k];
      }
    }
    t = moved(T, &translation[body * 3]);
  }

  // How far a body reaches along a direction in the world.
  double extent(const Frames& frames, std::size_t node, std::size_t body, const Vec3& direction) const {
    Mat3 R;
    Vec3 t;
    placement(frames, node, body, R, t);
    return direction.dot(t) + reach_of(*solids[body].shape, R.transpose() * direction);
  }
};

// How far bodies move between configurations; see MotionBounds.
struct Bounds {
  const double* radius;  // (M, G)
  std::size_t bodies;

  double travel(const Tree& tree, const double* v, std::size_t body) const;
  double tight(const Bodies& robot, const Frames& frames, std::size_t node, std::size_t body, const double* v) const;
};

}  // namespace strips
