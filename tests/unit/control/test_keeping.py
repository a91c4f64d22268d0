"""Joints that keep looking at something where the base drives beside the strip."""

from __future__ import annotations

import numpy as np
import pytest

from elastic_strips.control.evasion import motion_to
from elastic_strips.control.keeping import ConstraintKeeper
from elastic_strips.planning import BasePose, find_goals
from elastic_strips.scene import Scene
from elastic_strips.strip import LookAt
from elastic_strips.strip.constraint import ConstraintForce
from elastic_strips.trajectory import MotionLimits, ReferenceState

LOOK = LookAt(frame="hand_frame", axis=(1.0, 0.0, 0.0), at=(2.0, -2.5, 1.0), tolerance=0.1)


@pytest.fixture(scope="module")
def limits(silvermate):
    return MotionLimits.for_robot(silvermate)


@pytest.fixture
def force(silvermate):
    found = ConstraintForce(silvermate, LOOK)
    found.find(Scene([]))
    return found


@pytest.fixture
def keeper(silvermate, limits, force):
    return ConstraintKeeper(silvermate, limits, force, self_clearance=0.005, dt=0.01)


@pytest.fixture(scope="module")
def row(silvermate):
    found = find_goals(silvermate, Scene([]), silvermate.home(), BasePose(0.0, 0.0, 0.0), constraint=LOOK)
    return silvermate.space.to_coordinates(found.configurations[0])


def test_the_joints_follow_what_a_manoeuvre_of_the_base_asks_for(silvermate, limits, force, keeper, row):
    still = np.zeros(silvermate.nv)
    start = ReferenceState(0.0, row, still, still)
    target = limits.to_drive(np.array([0.3, 0.0, 0.6]))
    motion = motion_to(silvermate, limits, start, target, part=0.9, duration=1.0, dt=0.01)
    way = np.stack([row, row + np.r_[3.0, np.zeros(silvermate.nv - 1)]])
    kept, *_, last = keeper.motions(motion, Scene([]), 0.3, way)
    assert last is motion
    missed, before = force.errors_at(kept.coordinates).max(), force.errors_at(motion.coordinates).max()
    assert before > 0.3  # with its joints as they were
    assert missed < 0.5 * before
    np.testing.assert_allclose(kept.coordinates[len(motion) - 1, :3], motion.coordinates[-1, :3], atol=2e-3)
    assert (np.abs(limits.to_coordinates(kept.v)) <= limits.speed + 1e-6).all()
    assert np.abs(kept.v[-1]).max() < 1e-6  # it ends at rest


def test_a_path_has_its_joints_where_they_look_and_keeps_its_base(force, keeper, row):
    rows = np.tile(row, (12, 1))
    rows[:, 0] += np.linspace(0.0, 1.5, 12)
    out = keeper.path(rows)
    np.testing.assert_array_equal(out[:, :3], rows[:, :3])
    np.testing.assert_array_equal(out[[0, -1]], rows[[0, -1]])
    before, after = force.errors_at(rows)[1:-1], force.errors_at(out)[1:-1]
    assert before.max() > 0.2
    assert after.max() < max(0.5 * before.max(), LOOK.tolerance)
