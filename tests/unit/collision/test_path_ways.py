"""Which way a path goes between its rows: by the values, the shorter way, or not known; and what others execute."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from brute_force import link_distances
from cases import each, refused

from elastic_strips.collision import PathCertificate, Verdict, certify, prove
from elastic_strips.collision.proof import path_digest
from elastic_strips.errors import ConfigurationError, ParameterError
from elastic_strips.io import load_path, write_path
from elastic_strips.robot import RobotModel, load_robot
from elastic_strips.scene import Box, Scene, Sphere, World
from elastic_strips.strip import Strip

PI = np.pi


def _link(name: str, size: str, at: str) -> str:
    body = f'<origin xyz="{at}"/><geometry><box size="{size}"/></geometry>'
    return f'<link name="{name}"><collision>{body}</collision></link>'


@pytest.fixture(scope="module")
def urdf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A base with a boom that sticks out, and an arm that turns without end above it."""
    file = tmp_path_factory.mktemp("robots") / "boom.urdf"
    file.write_text(
        '<robot name="boom">'
        + _link("base", "0.4 0.4 0.2", "0 0 0.1")
        + _link("boom", "0.6 0.05 0.05", "0.5 0 0.1")
        + _link("arm", "0.6 0.06 0.06", "0.4 0 0")
        + '<joint name="fix" type="fixed"><parent link="base"/><child link="boom"/></joint>'
        '<joint name="pan" type="continuous"><origin xyz="0 0 0.6"/><parent link="base"/><child link="arm"/>'
        '<axis xyz="0 0 1"/></joint></robot>'
    )
    return file


@pytest.fixture(scope="module")
def mobile(urdf: Path) -> RobotModel:
    return load_robot(urdf, base="omni")


@pytest.fixture(scope="module")
def arm(urdf: Path) -> RobotModel:
    return load_robot(urdf, base="fixed")


def _right() -> Scene:
    """What the boom hits on its way over −π/2, and not on the one over π/2."""
    return Scene([Box((0.2, 0.2, 0.4), at=(0.0, -0.7, 0.2), name="post")])


def _front() -> Scene:
    """What the arm hits where it looks along x."""
    return Scene([Box((0.1, 0.1, 1.0), at=(0.55, 0.0, 0.9), name="post")])


def _least(robot: RobotModel, scene: Scene, rows: np.ndarray) -> float:
    """The smallest distance on the way that values say, by Pinocchio and Coal at many places of it."""
    return min(
        float(link_distances(robot, scene, robot.space.from_coordinates(a + t * (b - a))).min())
        for a, b in pairwise(np.asarray(rows, dtype=float))
        for t in np.linspace(0.0, 1.0, 241)
    )


def _is_not_known(found: PathCertificate) -> None:
    assert found.verdict is Verdict.UNKNOWN
    assert found.broken is not None
    assert found.broken.kind == "half turn"
    assert found.reason


@each("interpolation", ["line", "arc", "shortest"])
@each("end", [-PI, PI])
def test_half_a_turn_of_a_base_is_not_known(mobile, interpolation, end):
    rows = [[0, 0, 0, 2.5], [0, 0, end, 2.5]]
    assert _least(mobile, _right(), [[0, 0, 0, 2.5], [0, 0, -PI, 2.5]]) < -0.04
    _is_not_known(certify(mobile, _right(), rows, interpolation=interpolation))
    q = [mobile.home(pan=2.5), mobile.home(yaw=end, pan=2.5)]
    _is_not_known(certify(mobile, _right(), q, interpolation=interpolation))
    assert prove(mobile, _right(), rows, interpolation=interpolation) is None
    assert prove(mobile, _right(), q, interpolation=interpolation) is None


def test_half_a_turn_goes_by_the_values_where_there_are_some(mobile):
    over_the_right, over_the_left = ([[0, 0, 0, 2.5], [0, 0, end, 2.5]] for end in (-PI, PI))
    found = certify(mobile, _right(), over_the_right, interpolation="values")
    assert found.verdict is Verdict.REFUTED
    assert link_distances(mobile, _right(), found.q).min() == pytest.approx(found.distance, abs=1e-4)
    assert prove(mobile, _right(), over_the_right, interpolation="values") is None
    assert certify(mobile, _right(), over_the_left, interpolation="values").certified
    assert prove(mobile, _right(), over_the_left, interpolation="values") is not None
    q = [mobile.home(pan=2.5), mobile.home(yaw=PI, pan=2.5)]
    _is_not_known(certify(mobile, _right(), q, interpolation="values"))
    _is_not_known(certify(mobile, _right(), [q[0], q[0]], interpolation="values"))  # or a whole turn
    assert prove(mobile, _right(), q, interpolation="values") is None


@each(("begin", "end"), [(-0.9, 5.3), (3.0, -3.0), (0.5, 6.7), (2.0, 2.0 + 4.0 * PI)])
def test_the_long_way_of_a_joint_is_not_the_shorter_one(arm, begin, end):
    rows = [[begin], [end]]
    for interpolation in ("line", "arc"):
        _is_not_known(certify(arm, _front(), rows, interpolation=interpolation))
        assert prove(arm, _front(), rows, interpolation=interpolation) is None
    truth = _least(arm, _front(), rows)
    by_values = certify(arm, _front(), rows, interpolation="values")
    assert by_values.certified == (truth > 0.0)
    assert by_values.verdict is not Verdict.UNKNOWN
    shorter = (end - begin + PI) % (2.0 * PI) - PI
    short = _least(arm, _front(), [[begin], [begin + shorter]])
    assert certify(arm, _front(), rows, interpolation="shortest").certified == (short > 0.0)
    for interpolation, free in (("values", truth > 0.0), ("shortest", short > 0.0)):
        assert (prove(arm, _front(), rows, interpolation=interpolation) is not None) == free


def test_a_whole_turn_is_looked_at(arm, mobile):
    """From 1 to 1 + 2π: the configurations are the same, and all of the circle lies between."""
    rows = [[1.0], [1.0 + 2.0 * PI]]
    assert certify(arm, _front(), rows, interpolation="values").verdict is Verdict.REFUTED
    assert certify(arm, _front(), rows, interpolation="shortest").certified
    _is_not_known(certify(arm, _front(), rows, interpolation="line"))
    turned = [[0.0, 0.0, 0.3, 2.5], [0.0, 0.0, 0.3 - 2.0 * PI, 2.5]]
    assert certify(mobile, _right(), turned, interpolation="values").verdict is Verdict.REFUTED
    away = [[0.0, 2.0, 0.3, 2.5], [0.0, 2.0, 0.3 - 6.0 * PI, 2.5]]
    found = certify(mobile, _right(), away, interpolation="values")
    assert found.certified
    assert found.least == pytest.approx(_least(mobile, _right(), away), abs=5e-3)


@each("seed", range(6))
def test_values_are_those_of_dense_sampling(mobile, seed):
    rng = np.random.default_rng(seed)
    rows = np.column_stack((rng.uniform(-1.0, 1.0, (3, 2)), rng.uniform(-9.0, 9.0, (3, 2))))
    scene = Scene([Sphere(0.15, at=(*rng.uniform(-1.8, 1.8, 2), z), name=f"s{z}") for z in (0.1, 0.6)])
    found = certify(mobile, scene, rows, interpolation="values")
    truth = _least(mobile, scene, rows)
    assert found.certified == (truth > 0.0) or abs(truth) < 2e-3
    proof = prove(mobile, scene, rows, interpolation="values")
    assert (proof is not None) <= (truth > 0.0)
    assert proof is not None or truth < 2e-3


def test_another_broken_place_refutes_all_the_same(mobile):
    """Which way the first segment goes is not known; the second one hits something whichever way that was."""
    rows = [[0, 0, 0, 2.5], [0, 0, PI, 2.5], [0, -0.7, PI, 2.5]]
    found = certify(mobile, _right(), rows, interpolation="line")
    assert found.verdict is Verdict.REFUTED
    assert found.segments == (0, 1)
    _is_not_known(certify(mobile, Scene([]), rows, interpolation="line"))
    into = [[0, 0, PI, 2.5], [0, 0, 0, 2.5], [0, 0, -0.5 * PI, 2.5]]  # an end of it is in the post
    assert certify(mobile, _right(), into[:1] + into[2:] + into[:1], interpolation="line").verdict is Verdict.REFUTED


def test_which_way_was_looked_at_is_said(arm, mobile):
    rows = np.array([[3.0], [-3.0]])
    q = arm.space.from_coordinates(rows)
    found = [certify(arm, Scene([]), q), certify(arm, Scene([]), rows, interpolation="values")]
    assert found[0].notes != found[1].notes
    for one in found:
        assert one.certified
        assert len(one.notes) == 1
        assert "pan" in one.notes[0]
        assert one.notes[0] in one.reason
    assert certify(mobile, Scene([]), Strip(mobile, [mobile.home(), mobile.home(x=1.0, yaw=1.0)])).notes == ()


def test_files_keep_their_values(arm, mobile, tmp_path):
    file = tmp_path / "long.csv"
    file.write_text("pan\n3.0\n-3.0\n")
    path = load_path(file, arm)
    assert path.rows.tolist() == [[3.0], [-3.0]]
    _is_not_known(certify(arm, _front(), path, interpolation="line"))
    assert certify(arm, _front(), path, interpolation="values").verdict is Verdict.REFUTED
    assert certify(arm, _front(), path, interpolation="shortest").certified
    # what is written goes the way that the path goes, for whoever interpolates its values
    strip = Strip(mobile, [mobile.home(yaw=yaw) for yaw in (2.9, 3.3, 3.7, 9.0 - 2.0 * PI)])
    written = load_path(write_path(tmp_path / "strip.csv", mobile, strip), mobile)
    assert np.abs(np.diff(written.rows[:, 2])).max() < PI / 2
    assert certify(mobile, Scene([]), written, interpolation="line").certified
    assert np.allclose(written.q, strip.q, atol=1e-12)
    turned = load_path(write_path(tmp_path / "turned.csv", arm, [[0.0], [2.0 * PI]]), arm)
    assert turned.rows.tolist() == [[0.0], [2.0 * PI]]


def test_an_owner_computes_the_digest_from_the_file_alone(arm, tmp_path):
    from elastic_strips import proof_checker

    file = tmp_path / "p.csv"
    file.write_text("pan\n1.0\n2.25\n-0.0\n0.7\n")
    values = np.loadtxt(file, skiprows=1, ndmin=2)
    proof = prove(arm, Scene([Sphere(0.2, at=(3.0, 0.0, 0.0))]), load_path(file, arm), interpolation="line")
    assert proof is not None
    assert proof.digests["path"] == proof_checker.path_digest(values, "values")
    assert proof.digests["path"] == path_digest(arm, load_path(file, arm))
    assert proof.digests["path"] != proof_checker.path_digest(values, "shortest")
    assert proof.digests["path"] != proof_checker.path_digest(values + 1e-9, "values")
    with refused(ParameterError, "values"):
        path_digest(arm, arm.space.from_coordinates(values), "values")


@each(
    "rows",
    [
        [[1e7, 0, 0, 0], [0, 0, 0, 0]],
        [[0, 0, 1e35, 0], [0, 0, 0, 0]],
        [[0, 0, 0, np.nan], [0, 0, 0, 0]],
        [[0, 0, 0, 0]],
        [[0, 0, 0], [0, 0, 0]],
        [["a", 0, 0, 0], [0, 0, 0, 0]],
    ],
)
def test_rows_are_bounded(mobile, rows):
    for interpolation in ("line", "values"):
        with pytest.raises(ConfigurationError):
            certify(mobile, Scene([]), rows, interpolation=interpolation)


@each(
    ("rows", "said"),
    [
        ([[0, 0, 0], [0, 2, 0]], True),
        ([[0, 0.001 * k, 0] for k in range(200)], True),  # in small steps, too
        ([[0, 0, 0], [2, 2, 0]], True),
        ([[0, 0, 0], [2, 0, 0], [2, 0, 1.5], [2, 1, 1.5]], False),
        ([[np.sin(a), 1.0 - np.cos(a), a] for a in (0.0, 0.6, 1.2)], False),  # arcs, however far apart
        ([[0.1 * k, 0.0005 * (k % 2), 0] for k in range(20)], False),  # roundings
    ],
)
def test_a_path_that_wheels_cannot_follow_is_said_to_be_one(mobile, rows, said):
    rows = np.column_stack((np.array(rows, dtype=float), np.zeros(len(rows))))
    wheeled = load_robot(mobile.urdf_path, base="diff_drive")
    for way in ("arc", "line"):
        sideways, free = (certify(robot, Scene([]), rows, interpolation=way) for robot in (wheeled, mobile))
        assert sideways.certified
        assert len(sideways.notes) == len(free.notes) + said
        assert all(note in sideways.reason for note in sideways.notes)


def test_an_answer_says_of_which_times_it_is_and_that_nothing_is_there(arm):
    rows = np.array([[0.0], [0.1]])
    far = Box((0.1, 0.1, 0.1), at=(9.0, 0.0, 0.0), name="far")
    empty, standing = (certify(arm, Scene(of), rows).reason for of in ([], [far]))
    assert "no obstacles" in empty
    assert "no obstacles" not in standing
    later = World(Scene([far]), appears={"far": 20.0})  # not looked at, for the path is over by then
    found = certify(arm, later, rows, times=[3.0, 7.0])
    assert found.certified
    assert "7 s" in found.reason
