// What the spheres of the links leave free, eight configurations at once, in single precision: plain arrays, for this
// is compiled once for each instruction set, and what is shared with other code has to stay the same for all.
#pragma once

#include <cstddef>
#include <cstdint>

namespace strips {

constexpr int kRows = 8;                         // configurations that are looked at together
constexpr unsigned kEvery = (1u << kRows) - 1u;  // a bit for each of them

struct SphereObstacle {
  enum Kind : std::uint32_t { kBall, kRod, kUpright, kBox, kCan, kHull } kind;
  std::uint32_t part, planes;  // number of planes of a hull
  float R[9], t[3], half[3], swept, low[3], high[3];
  const float* plane;  // (planes, 4): normals and offsets
};

// Of a tree of boxes over the obstacles, in preorder; a leaf has obstacles first … first + count - 1.
struct SphereBranch {
  float low[3], high[3];
  std::uint32_t next, first, count;
};

// What is looked at, and how: bodies and self pairs that move, those first that touched last.
struct SphereScene {
  int joints;
  const std::int32_t *parents, *kind;  // (joints): 0 the planar root, 1 turns, 2 slides
  const float* offset;                 // (joints, 12)
  std::size_t bodies, pairs, obstacles, branches;
  const std::int32_t* joint;            // of a body
  const std::uint32_t *first, *next;    // of a body its first sphere; of a sphere the first not below it
  const float *center, *outer, *inner;  // of spheres, in the frames of their joints
  const std::uint32_t* pair;            // (pairs, 2)
  const SphereObstacle* obstacle;
  const SphereBranch* branch;
  float margin, self_margin, pad;  // [m] pad: by which distances are taken less, for rounding
  std::uint32_t *body_order, *pair_order;
  // (bodies in all, 8), (pairs, 8) [m] by which spheres are grown, and the two of a pair together; null where they are
  // not. What is grown touches nothing for certain.
  const float *grown, *pair_grown;
};

// Buffers; those of numbers are for the widest instructions, and begin where these ask for.
struct SphereScratch {
  float *values, *T, *at;         // (joints, 3, 8) in: what each joint does; (joints, 12, 8), (spheres, 3, 8)
  std::uint32_t *stamp, stamped;  // (spheres)
  struct Pending {
    std::uint32_t which, rows;
  }* pending;                    // (levels of spheres + 1, obstacles)
  std::uint32_t *near, *opened;  // (obstacles)
};

struct SphereOpen {
  std::uint32_t row, self, body, other;  // a body and a part; of a self pair its number
};

// Rows that touch for certain are bits of the answer; `open` gets the pairs of the others that spheres do not decide.
// With `first` the first that touches ends it. Those that are not in `rows` are not looked at.
using SphereLook = unsigned (*)(const SphereScene&, SphereScratch&, unsigned rows, bool first, SphereOpen* open,
                                std::size_t most_open, std::size_t& opened);

unsigned look_baseline(const SphereScene&, SphereScratch&, unsigned, bool, SphereOpen*, std::size_t, std::size_t&);
unsigned look_avx2(const SphereScene&, SphereScratch&, unsigned, bool, SphereOpen*, std::size_t, std::size_t&);
unsigned look_avx512(const SphereScene&, SphereScratch&, unsigned, bool, SphereOpen*, std::size_t, std::size_t&);

}  // namespace strips
