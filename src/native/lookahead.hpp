// Manoeuvres seen from above: how far poses of the base (x, y, yaw) are from discs that move and boxes that stand.
#pragma once

#include <cstddef>
#include <cstdint>

namespace strips {

// Poses (N, T, 3), the times (T) at which they are taken, and where results (N, T) go.
struct Rollout {
  const double *pose, *time;
  std::size_t count, steps;
  double* out;
};

// Manoeuvres (N) of a base at (x, y, yaw): its speeds (k) near their first targets (N, k) for `done` (N) steps, then
// the second ones (N, k); by at most `change` (k) a step, then `rate` (N, k). `twist` (k, 3): how far each leads in a
// step.
struct Manoeuvres {
  const double *start, *speed, *first, *second, *change, *rate, *twist;
  const std::int64_t* done;
  std::size_t dim;
};

// Poses (N, T, 3) after each of T steps.
void roll_out(const Manoeuvres& m, std::size_t count, std::size_t steps, double* pose);

// Discs (M, 8): x, y, their velocity, radius, low, high, mover; what their size grows by, (3, M): per second⁰, ¹ and ².
struct Discs {
  const double *disc, *error;
  std::size_t count;
};

// The robot's boxes: middle and half size (B, 2), low and high (B).
struct Footprint {
  const double *middle, *half, *low, *high;
  std::size_t count;
};

// Separations from discs that carry on for `lookahead` seconds; the robot is a disc, too: `size` (M) has both radii.
void near_discs(const Rollout& rollout, const Discs& discs, const double* size, double lookahead, double far);

// Separations of the robot's boxes from all places where discs can be then.
void possible_discs(const Rollout& rollout, const Discs& discs, const Footprint& body, double far);

// Lower bounds of the separations from boxes (K, 7): x, y, half sizes, low, high, yaw. Discs of at most the box's
// smaller half size, or `least`, cover each box of the robot.
void standing_boxes(const Rollout& rollout, const double* boxes, std::size_t count, const Footprint& body, double least,
                    double far);

}  // namespace strips
