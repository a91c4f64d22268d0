"""Record: what is written down is what is there afterwards, frozen, and rows are refused that make no sense."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from cases import each, each_robot, refused
from synthetic_run import moving_world, straight_run

from elastic_strips.control.interfaces import RunState
from elastic_strips.control.record import DRIVE_NAMES, STATES, Recorder, RecordError
from elastic_strips.errors import InputError
from elastic_strips.robot import BaseKind
from elastic_strips.scene import Scene, World


def fill(recorder, robot, count, rng):
    """Random rows; what was written, by column."""
    k = len(DRIVE_NAMES[robot.base_kind])
    sizes = {name: robot.nv for name in ("coordinates", "v", "reference", "reference_v", "estimate")}
    sizes |= {"drive": k, "joints": len(robot.joint_names)}
    written = {name: rng.normal(size=(count, size)) for name, size in sizes.items()}
    written["time"] = np.cumsum(rng.uniform(0.001, 0.02, count))
    written["state"] = rng.integers(0, len(STATES), count)
    for i in range(count):
        recorder.control(**{name: rows[i] for name, rows in written.items()})
    return written


@each("count", [1, 7, 8, 9, 300])
@each_robot
def test_rows_survive_growing(robot, rng, count):
    recorder = Recorder(robot, Scene())
    written = fill(recorder, robot, count, rng)
    control = recorder.finish().control
    assert len(recorder) == len(control) == count
    for name, rows in written.items():
        np.testing.assert_array_equal(getattr(control, name), rows)
    assert control.state.dtype == np.uint8


def test_a_record_does_not_change_when_recording_goes_on(silvermate, rng):
    recorder = Recorder(silvermate, Scene())
    fill(recorder, silvermate, 5, rng)
    record = recorder.finish()
    before = record.control.coordinates.copy()
    recorder.control(9.0, coordinates=np.ones(silvermate.nv), v=np.ones(silvermate.nv))
    recorder.planning(9.0)
    assert len(recorder.finish().control) == 6
    assert len(record.control) == 5
    assert len(record.planning) == 0
    np.testing.assert_array_equal(record.control.coordinates, before)
    rows = [getattr(part, f.name) for part in (record.control, record.planning) for f in dataclasses.fields(part)]
    arrays = [value for value in rows if isinstance(value, np.ndarray)]
    assert len(arrays) == 20
    assert all(not array.flags.writeable for array in arrays)
    with pytest.raises(dataclasses.FrozenInstanceError):
        record.robot = "other"


def test_what_is_not_known_is_nan(silvermate):
    recorder = Recorder(silvermate, Scene())
    for k in range(7):
        recorder.control(float(k), coordinates=np.zeros(10), v=np.zeros(10))
    recorder.planning(0.0)
    record = recorder.finish()
    for name in ("reference", "reference_v", "estimate", "drive", "joints"):
        assert np.isnan(getattr(record.control, name)).all()
    planning = record.planning
    assert np.isnan([planning.tick_ms[0], planning.clearance[0], planning.horizon_end[0]]).all()
    assert planning.certified.tolist() == [False]
    assert planning.reasons[planning.reason[0]] == ""
    assert record.states[record.control.state[0]] == RunState.MOVING.label == "moving"
    assert planning.strip(0).shape == (0, 10)


def test_ticks_keep_their_strips_phases_and_reasons(silvermate, rng):
    recorder = Recorder(silvermate, Scene())
    recorder.control(0.0, coordinates=np.zeros(10), v=np.zeros(10))
    strips = [rng.normal(size=(n, 10)) for n in (4, 0, 7)]
    recorder.planning(0.0, phase_ms={"a": 1.0}, status="deforming", reason="one", strip=strips[0])
    recorder.planning(0.1, phase_ms={"b": 2.0, "a": 3.0}, status="settled", reason="two", strip=strips[1])
    strips[2][0] = 5.0
    recorder.planning(0.2, phase_ms={}, status="deforming", certified=True, reason="one", strip=strips[2])
    given = strips[2].copy()
    strips[2][:] = 0.0  # the planner goes on with its buffers
    planning = recorder.finish().planning
    assert planning.phases == ("a", "b")
    np.testing.assert_array_equal(planning.phase_ms, [[1, np.nan], [3, 2], [np.nan, np.nan]])
    assert [planning.statuses[k] for k in planning.status] == ["deforming", "settled", "deforming"]
    assert [planning.reasons[k] for k in planning.reason] == ["one", "two", "one"]
    np.testing.assert_array_equal(planning.strip(0), strips[0])
    assert planning.strip(1).shape == (0, 10)
    np.testing.assert_array_equal(planning.strip(2), given)
    assert [planning.row_at(t) for t in (-0.01, 0.0, 0.15, 0.2, 9.0)] == [-1, 0, 1, 2, 2]


def test_a_run_has_what_identifies_it(silvermate):
    record = straight_run(silvermate, moving_world())
    assert record.robot == "silvermate"
    assert record.base is BaseKind.DIFF_DRIVE
    assert record.drive_names == ("left", "right")
    assert record.locked == dict(silvermate.locked)
    assert record.metadata == {"scenario": "straight on", "seed": 0}
    assert [event.kind for event in record.events] == ["start", "slow"]
    assert record.duration == record.control.time[-1]
    assert isinstance(record.world, World)
    recorder = Recorder(silvermate, Scene())
    recorder.control(0.0, coordinates=np.zeros(10), v=np.zeros(10))
    recorder.event(2.0, "late")
    recorder.event(1.0, "early", "why")
    assert [(e.time, e.kind, e.reason) for e in recorder.finish().events] == [(1, "early", "why"), (2, "late", "")]


def test_rows_that_make_no_sense_are_refused(silvermate, tiago):
    with refused(RecordError, "goal", "(3,)"):
        Recorder(silvermate, Scene(), goal=[0, 0, 0])
    recorder = Recorder(silvermate, Scene())
    with refused(RecordError, "control"):
        recorder.finish()
    row = np.zeros(10)
    recorder.control(1.0, coordinates=row, v=row)
    for time in (1.0, 0.5, np.nan):
        with refused(RecordError, "time"):
            recorder.control(time, coordinates=row, v=row)
    with refused(RecordError, "state"):
        recorder.control(2.0, coordinates=row, v=row, state=5)
    with refused(RecordError, "estimate", "(9,)", "(10,)"):
        recorder.control(2.0, coordinates=row, v=row, estimate=row[:9])
    with refused(RecordError, "drive", "(1,)"):
        recorder.control(2.0, coordinates=row, v=row, drive=np.zeros(1))
    assert len(recorder) == 1
    recorder.planning(0.0, strip=np.zeros((3, 9)))
    with refused(RecordError, "(3, 9)"):
        recorder.finish()
    with refused(RecordError, "'tiago'", "diff_drive"):
        straight_run(silvermate, Scene()).check_robot(tiago)
    assert issubclass(RecordError, InputError)
