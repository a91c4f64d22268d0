"""What has a name and comes with the library, with a line about each: to be listed without making any of it."""

SCENARIOS = {
    "case-1": "two obstacles 2.1 m apart, slow turning: pass between",
    "case-2": "as case 1, fast turning",
    "case-3": "two obstacles 1.0 m apart, safe distance 1.5 m: the paper's strip is blocked",
    "case-4": "as case 3 with safe distance 0.8 m: pass between",
    "case-5": "two obstacles 0.1 m apart: go around both",
    "case-6": "obstacles scattered at will",
    "case-7": "the whole robot in 3D: a shelf that the base passes and the arm must avoid",
    "corridor": "8 m of clutter, 32 obstacles of mixed shapes and heights (seeded generator)",
    "clutter": "a room with pillars, tables, shelves and beams; the arm ends above a table (seeded generator)",
    "closing-side": "a box to pass on either side; a cabinet slides into the wider one",
    "bottleneck": "a wall with a door of 0.75 m, a little beside the line",
    "dead-end": "a dead end, 1.2 m deep and 1.8 m wide, on the line",
    "moving-corridor": "the corridor with 1 to 8 movers that appear, cross and come head-on (seeded)",
    "courteous-corridor": "the corridor with 1 to 8 movers that appear, cross and come head-on, and stop for a robot "
    "that stands (seeded)",
}

PRESETS = {
    "default": "forces at witness points, implicit update, exact rolling constraint",
    "paper": "Eqs. 2-9 of the paper at its control points; the base moves as if omnidirectional",
}
