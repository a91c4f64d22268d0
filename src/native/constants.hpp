// Numbers that the twin has as well: the module exports them, and Python does not use it where they differ. What each
// of them is, and its unit, says constants.py.
#pragma once

namespace strips {

// clang-format off
#define STRIPS_CONSTANTS(X) \
  X(GJK_TOLERANCE, 1e-10) X(EPA_TOLERANCE, 1e-12) X(NO_DEPTH, -1e100) X(DEPTH_AGREEMENT, 1e-4) X(UNIT_EXCESS, 1e-9) \
  X(NORMAL_EXCESS, 5e-6) X(GJK_EXCESS, 1e-5) X(FAR, 1e9) X(CAPSULE_LOOSE, 0.15) X(EXACT_WITHIN, 1e-4) \
  X(MOST_OPEN_INTERVALS, 1000) X(OPEN_INTERVALS_A_PAIR, 16) X(POINT_LENGTH2, 1e-18) X(SLIDING_TURN, 1e-9) \
  X(SMALL_TURN, 1e-4) X(ROLLING_TOLERANCE, 1e-9) X(ROLLING_YAW_WEIGHT, 0.1) X(ROLLING_LARGEST_STEP, 0.5) X(UPRIGHT_NORMAL, 1e-9)
// clang-format on

#define STRIPS_CONSTANT(name, value) constexpr double name = value;
STRIPS_CONSTANTS(STRIPS_CONSTANT)
constexpr double COARSE_EPA_TOLERANCES[] = {1e-4, 1e-3, 1e-2, 0.1};
constexpr int GRID_MOVES[][2] = {{0, 1}, {1, 0}, {1, 1}, {1, -1}, {1, 2}, {2, 1}, {1, -2}, {2, -1}};

}  // namespace strips
