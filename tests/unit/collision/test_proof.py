"""Proofs: what is made is taken; what is tampered with is refused; the checker stands alone and stays short."""

from __future__ import annotations

import ast
import itertools
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from cases import each, refused

from elastic_strips import proof_checker as checker
from elastic_strips.collision import certify, prove
from elastic_strips.errors import InputError
from elastic_strips.robot import RobotModel, load_robot
from elastic_strips.scene import Box, Capsule, Cone, Cylinder, Mesh, Scene, Sphere, Voxels

CHECKER = Path(checker.__file__)


def _path(robot: RobotModel, rng: np.random.Generator, count: int = 5) -> np.ndarray:
    low, high = np.maximum(robot.space.lower, -1.5), np.minimum(robot.space.upper, 1.5)
    start = rng.uniform(low, high)
    steps = np.cumsum(rng.normal(0.0, 0.12, (count, robot.nv)), axis=0)
    return np.clip(start + steps, low, high)


def _scene(rng: np.random.Generator) -> Scene:
    kinds = (
        lambda at: Box(rng.uniform(0.1, 0.5, 3), at=at),
        lambda at: Sphere(0.2, at=at),
        lambda at: Cylinder(0.1, 0.6, at=at),
        lambda at: Capsule(0.1, 0.4, at=at),
        lambda at: Cone(0.2, 0.5, at=at),
    )
    return Scene([kind(rng.uniform((-1.5, -1.5, 0.0), (1.5, 1.5, 1.2))) for kind in kinds])


@each("name, seed", list(itertools.product(["gantry", "rover", "silvermate"], range(5))))
def test_a_certified_path_has_a_proof_and_no_other_one_has(name, seed, request):
    robot, rng = request.getfixturevalue(name), np.random.default_rng(seed)
    proven = 0
    for _ in range(4):
        scene, rows = _scene(rng), _path(robot, rng)
        found = certify(robot, scene, robot.space.from_coordinates(rows), clearance=1e-3)
        proof = prove(robot, scene, rows, clearance=1e-3)
        if not found.certified:
            assert proof is None
            continue
        assert proof is not None, found
        proven += 1
        spare = checker.check(proof.header, proof.rows, proof.segment, proof.pair, proof.span, proof.normal)
        assert 0.0 < spare <= proof.spare + 1e-9
    if name == "gantry":
        assert proven


@pytest.fixture(scope="module")
def proof(tmp_path_factory: pytest.TempPathFactory) -> Path:
    robot = load_robot("silvermate", base="omni")
    scene = Scene([Box((0.3, 0.3, 1.0), at=(1.0, 0.75, 0.5), name="post"), Sphere(0.2, at=(1.0, -0.9, 0.6))])
    ends = robot.space.to_coordinates(np.array([robot.home(), robot.home(x=2.0, yaw=1.0)]))
    rows = robot.space.interpolate(ends[:1], ends[1:], np.linspace(0.0, 1.0, 6))
    made = prove(robot, scene, rows, clearance=0.005, self_clearance=1e-3)
    assert made is not None
    assert (made.span[:, 1] - made.span[:, 0] < 1.0).any()  # something was halved
    return made.save(tmp_path_factory.mktemp("proof") / "p.npz")


def _parts(file: Path) -> tuple[dict, dict]:
    with np.load(file) as arrays:
        parts = {name: arrays[name] for name in ("rows", "segment", "pair", "span", "normal")}
        return json.loads(str(arrays["header"])), parts


def _cut(span: np.ndarray) -> int:
    return int(np.argmax(span[:, 1] - span[:, 0] < 1.0))


def _moved_obstacle(header, parts):
    header["scene"][0]["translation"][1] -= 0.4


def _grown_obstacle(header, parts):
    header["scene"][1]["sizes"] = [0.6]


def _larger_clearance(header, parts):
    header["clearance"] = 0.5


def _missing_interval(header, parts):
    for name in ("segment", "pair", "span", "normal"):
        parts[name] = np.delete(parts[name], _cut(parts["span"]), axis=0)


def _longer_interval(header, parts):
    """One of two halves is said to be the whole."""
    k = _cut(parts["span"])
    parts["span"] = parts["span"].copy()
    parts["span"][k] = (0.0, 1.0)


def _missing_pair(header, parts):
    keep = parts["pair"] != 3
    for name in ("segment", "pair", "span", "normal"):
        parts[name] = parts[name][keep]


def _other_direction(header, parts):
    parts["normal"] = -parts["normal"]


def _no_direction(header, parts):
    parts["normal"] = 0.0 * parts["normal"]


def _not_a_number(header, parts):
    parts["normal"] = parts["normal"] * np.nan


def _other_path(header, parts):
    parts["rows"] = parts["rows"] + np.array([0.0, 0.4, *np.zeros(parts["rows"].shape[1] - 2)])


def _longer_arm(header, parts):
    header["robot"]["joints"][1]["offset"][0][3] += 0.7


def _thicker_body(header, parts):
    for body in header["robot"]["bodies"]:
        body["grown"] += 0.3


def _fewer_joints(header, parts):
    header["robot"]["joints"].pop()


def _skewed_frame(header, parts):
    header["robot"]["joints"][2]["offset"][0][0] *= 1.1


def _other_version(header, parts):
    header["version"] = 1


TAMPERED = (
    _moved_obstacle, _grown_obstacle, _larger_clearance, _missing_interval, _longer_interval, _missing_pair,
    _other_direction, _no_direction, _not_a_number, _other_path, _longer_arm, _thicker_body, _fewer_joints,
    _skewed_frame, _other_version,
)  # fmt: skip


@each("tamper", TAMPERED, ids=lambda f: f.__name__[1:])
def test_what_is_tampered_with_is_refused(proof, tamper):
    header, parts = _parts(proof)
    assert checker.check(header, **parts) > 0.0
    tamper(header, parts)
    with pytest.raises((checker.Refused, ValueError, IndexError, KeyError, TypeError)):
        checker.check(header, **parts)


def test_it_runs_alone(proof, tmp_path):
    """Without this package, Pinocchio and Coal: as a file of its own, in a folder of its own."""
    alone = tmp_path / "checker.py"
    alone.write_text(CHECKER.read_text(encoding="utf-8"), encoding="utf-8")
    block = "import sys; sys.modules.update(dict.fromkeys(('elastic_strips', 'pinocchio', 'coal')));"
    run = [
        sys.executable,
        "-c",
        f"{block} import runpy; sys.argv[0] = 'c'; runpy.run_path({str(alone)!r}, run_name='__main__')",
    ]

    def checked(*arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run([*run, *arguments], capture_output=True, text=True, check=False, cwd=tmp_path)

    good = checked(str(proof))
    assert good.returncode == 0, good.stderr
    assert good.stdout.startswith("PROVEN: clear by 0.005 m of obstacles")
    other = checked(str(proof), "--robot", "0" * 32)
    assert other.returncode == 3
    assert "another robot" in other.stdout
    (tmp_path / "no.npz").write_bytes(b"nothing")
    assert checked("no.npz").returncode == checked("missing.npz").returncode == 2


def test_the_checker_is_short_and_needs_numpy_alone():
    text = CHECKER.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 300
    imported = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            imported |= {name.name.split(".")[0] for name in node.names}
        elif isinstance(node, ast.ImportFrom):
            imported.add((node.module or "").split(".")[0])
    assert imported <= {"__future__", "argparse", "hashlib", "json", "sys", "typing", "numpy"}


def test_a_touching_path_and_half_a_turn_have_no_proof(silvermate):
    scene = Scene([Box((0.3, 0.3, 1.0), at=(1.0, 0.0, 0.5))])
    through = silvermate.space.to_coordinates(np.array([silvermate.home(), silvermate.home(x=2.0)]))
    assert prove(silvermate, scene, through) is None
    turn = silvermate.space.to_coordinates(np.array([silvermate.home(), silvermate.home(x=1.0, yaw=np.pi)]))
    assert prove(silvermate, Scene([]), turn) is None


def test_hulls_and_voxels_are_pieces(gantry):
    rows = _path(gantry, np.random.default_rng(1), 3)
    away = 8.0 + np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    mesh = Mesh(away, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    voxels = Voxels([[7.0, 0.0, 0.0], [7.0, 1.0, 0.0]], 0.1)
    proof = prove(gantry, Scene([mesh, voxels]), rows)
    assert proof is not None
    kinds = [piece["kind"] for piece in proof.header["scene"]]
    assert kinds.count("convex") == 1
    assert kinds.count("box") >= 1


def test_a_file_that_cannot_be_written_is_named(gantry, tmp_path):
    proof = prove(gantry, Scene([]), _path(gantry, np.random.default_rng(0), 2))
    assert proof is not None
    with refused(InputError, "folder"):
        proof.save(tmp_path / "missing" / "p.npz")


def test_of_nothing_there_is_no_proof(tmp_path):
    """A robot of which no links are kept apart, where there are no obstacles."""
    path = tmp_path / "r.urdf"
    shape = '<collision><geometry><box size="0.2 0.2 0.2"/></geometry></collision>'
    path.write_text(
        f'<robot name="r"><link name="a">{shape}</link><link name="b">{shape}</link><joint name="j" type="revolute">'
        '<parent link="a"/><child link="b"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>'
    )
    robot = load_robot(path, base="fixed")
    with pytest.raises(InputError):
        prove(robot, Scene([]), np.array([[0.0], [0.5]]))
