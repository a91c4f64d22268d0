// Numbers that the twin has as well, under these names in capitals: the module exports them, and Python does not use it
// where they differ. See constants.py, which says what each is.
#pragma once

namespace strips {

constexpr double kGjkTolerance = 1e-10, kEpaTolerance = 1e-12;
constexpr double kCoarseEpaTolerances[] = {1e-4, 1e-3, 1e-2, 0.1};
constexpr double kNoDepth = -1e100;
constexpr double kDepthAgreement = 1e-4;  // [m]
constexpr double kUnitExcess = 1e-9;
constexpr double kNormalExcess = 5e-6;   // [m]
constexpr double kGjkExcess = 1e-5;      // [m]
constexpr double kFar = 1e9;             // [m]
constexpr double kCapsuleLoose = 0.15;   // [m]
constexpr double kExactWithin = 1e-4;    // [m]
constexpr double kPointLength2 = 1e-18;  // [m²]
constexpr double kSlidingTurn = 1e-9;
constexpr double kSmallTurn = 1e-4;          // [rad]
constexpr double kRollingTolerance = 1e-9;   // [m]
constexpr double kRollingYawWeight = 0.1;    // [m²/rad²]
constexpr double kRollingLargestStep = 0.5;  // [m, rad]

struct Constant {
  const char* name;
  double value;
};

constexpr Constant kConstants[] = {
    {"GJK_TOLERANCE", kGjkTolerance},
    {"EPA_TOLERANCE", kEpaTolerance},
    {"NO_DEPTH", kNoDepth},
    {"DEPTH_AGREEMENT", kDepthAgreement},
    {"UNIT_EXCESS", kUnitExcess},
    {"NORMAL_EXCESS", kNormalExcess},
    {"GJK_EXCESS", kGjkExcess},
    {"FAR", kFar},
    {"CAPSULE_LOOSE", kCapsuleLoose},
    {"EXACT_WITHIN", kExactWithin},
    {"POINT_LENGTH2", kPointLength2},
    {"SLIDING_TURN", kSlidingTurn},
    {"SMALL_TURN", kSmallTurn},
    {"ROLLING_TOLERANCE", kRollingTolerance},
    {"ROLLING_YAW_WEIGHT", kRollingYawWeight},
    {"ROLLING_LARGEST_STEP", kRollingLargestStep},
};

}  // namespace strips
