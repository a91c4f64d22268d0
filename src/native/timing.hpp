// Timing of motions along a path: curves of travel, the base led back to its strip, and profiles of speed.
#pragma once

#include <cstddef>
#include <cstdint>

namespace strips {

constexpr std::size_t kShapes = 3;  // a step, a bump, and a bump that changes its sign

// A curve of travel: knots (K), coefficients (4, K-1, m) of its pieces; windows' ends (W+1) and weights (W, kShapes, m)
// of the shapes in them, or null.
struct Travel {
  const double *knots, *coefficients, *edges, *weights;
  std::size_t pieces, windows, size;
};

// Travel and its two derivatives (G, m) at lengths s (G), where `y` is null the derivatives alone.
void travel_at(const Travel& curve, const double* s, std::size_t count, double* y, double* y1, double* y2);

// What the windows of a curve are to do to the base: its yaw (W, Q) and twists (W, Q, 3) at points of the windows, the
// shapes (Q, kShapes) there and their rates, where it is to get (W, 2) from the start of the first.
struct Windows {
  const double *yaw, *twist, *shape, *rate, *target;
  std::size_t count, points;
  double width, lever;
  bool rolling;
};

// Weights (W, kShapes, 3) of the shapes that bring the base there, zero where none do better; `largest` of the width.
void lead_base(const Windows& windows, double largest, double near, double stalled, int iterations, double* weights);

// A path to be timed: lengths (G) with the derivatives (G, m) of travel there, and limits (m) of acceleration.
struct Grid {
  const double *s, *y1, *y2, *acceleration;
  std::size_t count, size;
};

// Squared path speeds (G) of the fastest profile from `start` to rest within `bound` (G); false where there is none.
bool fastest(const Grid& grid, const double* bound, double start, double* x);

// Squared path speeds (G) that fall from `start` with a part of the hardest braking there is; from 0 on, 0.
void braked(const Grid& grid, double start, double part, double* x);

}  // namespace strips
