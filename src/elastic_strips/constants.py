"""Constants that the NumPy code and the native kernel share: what a proof, and its twin, measure by.

The kernel has them under the same names, and is not used where one of them differs: see `native`.
"""

from __future__ import annotations

GJK_TOLERANCE = 1e-10
"""Of Coal's solver for distances (GJK)."""
EPA_TOLERANCE = 1e-12
"""Of its solver for depths (EPA), where it may reach it."""
COARSE_EPA_TOLERANCES = (1e-4, 1e-3, 1e-2, 0.1)
"""What it is asked for, one after the other, where it does not."""
NO_DEPTH = -1e100
"""A depth below this [m] is none: Coal says −1.8e308 where EPA does not converge."""
DEPTH_AGREEMENT = 1e-4
"""A depth counts where the one at Coal's own tolerance differs by less [m]."""
UNIT_EXCESS = 1e-9
"""The square of a unit vector is at most this much above 1."""
NORMAL_EXCESS = 5e-6
"""A distance may be this much [m] above what its normal proves."""
GJK_EXCESS = 1e-5
"""Every bound subtracts this much [m]: as much as a distance may be above its proof, and as much again for rounding."""
FAR = 1e9
"""Of what nothing is known: its bound is −FAR, and it has moved by FAR [m]."""
CAPSULE_LOOSE = 0.15
"""A lower bound may lie below the distance by the capsule's length and about this [m]; it decides what to measure."""
EXACT_WITHIN = 1e-4
"""A pair that a lower bound decides by less than this [m] is measured exactly all the same."""
MOST_OPEN_INTERVALS, OPEN_INTERVALS_A_PAIR = 1000, 16
"""A motion's search is given up, and nothing is proven, where more intervals than these are open, so many at all and so
many for each pair that was open first: what stays within microns of the clearance could be halved for a quarter of a
second."""
POINT_LENGTH2 = 1e-18
"""A line segment whose squared length [m²] is less is a point."""
SLIDING_TURN = 1e-9
"""A joint that turns by less than this for a unit of its motion slides."""
SMALL_TURN = 1e-4
"""Turns below this [rad] are expanded in series."""
ROLLING_TOLERANCE = 1e-9
"""Largest sideways travel [m] of a segment that counts as none."""
ROLLING_YAW_WEIGHT = 0.1
"""Cost of turning against moving, where poses are moved until they can be driven [m²/rad²]."""
ROLLING_LARGEST_STEP = 0.5
"""Largest change [m, rad] of a pose in one step of that."""
GRID_MOVES = ((0, 1), (1, 0), (1, 1), (1, -1), (1, 2), (2, 1), (1, -2), (2, -1))
"""Moves (rows, columns) from a cell of a grid to the next one of a path; and back."""
UPRIGHT_NORMAL = 1e-9
"""A half plane of an outline, seen from above, whose normal has a smaller part along y bounds x alone."""
