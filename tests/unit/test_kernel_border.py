"""What does not fit is refused at the kernel's border, before anything is read or written."""

from __future__ import annotations

import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path

import coal
import numpy as np
import pytest

from elastic_strips.collision import BodySet
from elastic_strips.collision.candidates import CandidateParts
from elastic_strips.collision.narrowphase import Narrowphase
from elastic_strips.errors import NumericalError
from elastic_strips.native import kernel, twin
from elastic_strips.planning.validity import ValidityChecker
from elastic_strips.robot import Kinematics, RobotModel
from elastic_strips.scene import Box, Scene, Sphere

_PROGRAM = Path(__file__).parents[1] / "oracle" / "kernel_border.py"


@pytest.mark.skipif(kernel() is None, reason="there is no kernel")
def test_arrays_that_do_not_fit_are_refused_and_the_process_lives() -> None:
    ended = subprocess.run([sys.executable, _PROGRAM, "--fuzz", "5000"], capture_output=True, text=True, timeout=600)
    assert ended.returncode == 0, ended.stderr[-2000:]
    *accepted, made = ended.stdout.splitlines()
    assert not accepted
    assert int(made) > 7000


def test_shapes_are_always_those_of_the_candidates(silvermate: RobotModel) -> None:
    """What the native half keeps of shapes is of the candidates that it is asked about, whatever it was asked first."""
    one = Scene([Box((0.2, 0.2, 0.2), at=(1.5, 0.0, 0.5)), Sphere(0.1, at=(0.0, 2.0, 0.5))])
    two = Scene([Sphere(0.1, at=(1.5, 0.0, 0.5)), Box((0.2, 0.2, 0.2), at=(0.0, 2.0, 0.5))])
    everywhere = np.full((1, 3), -np.inf), np.full((1, 3), np.inf)
    bodies, kin = BodySet.links(silvermate), Kinematics(silvermate.tree, 1)
    kin.update(silvermate.space.to_coordinates(silvermate.home_q)[None])
    node, body, part = (a.ravel() for a in np.meshgrid([0], np.arange(len(bodies)), [0, 1]))
    candidates = [CandidateParts.build(scene, *everywhere, 0.0) for scene in (one, two)]
    narrow = Narrowphase(bodies)
    asked = [candidates[k] for k in (0, 1, 1, 0)]
    found = [narrow.query(kin, node, body, part, c, np.inf)[0] for c in asked]
    with twin():
        plain = Narrowphase(bodies)
        wanted = [plain.query(kin, node, body, part, c, np.inf)[0] for c in asked]
    np.testing.assert_allclose(found, wanted, atol=1e-6)
    assert np.abs(wanted[0] - wanted[1]).max() > 0.01


@pytest.mark.parametrize("native", [True, False])
def test_both_kernels_check_no_motion_that_is_no_number(silvermate: RobotModel, native: bool) -> None:
    if native:
        if kernel() is None:
            pytest.skip("there is no kernel")
        checker = ValidityChecker(silvermate, Scene(), margin=0.05)
    else:
        with twin():
            checker = ValidityChecker(silvermate, Scene(), margin=0.05)
    here = silvermate.space.to_coordinates(silvermate.home_q)
    nowhere = np.full_like(here, np.nan)
    for a, b, step in ((here, nowhere, 0.05), (nowhere, here, 0.05), (here, here + 0.1, np.nan)):
        with pytest.raises(ValueError):  # noqa: PT011 # whatever it says
            checker.motion(a, b, step)


@pytest.mark.parametrize("native", [True, False])
def test_both_kernels_raise_the_same_where_no_depth_is_found(gantry: RobotModel, native: bool) -> None:
    everywhere = np.full((1, 3), -np.inf), np.full((1, 3), np.inf)
    candidates = CandidateParts.build(Scene([Sphere(0.1, at=(1.5, 0.0, 0.5))]), *everywhere, 0.0)
    most = 1.7e308
    with nullcontext() if native else twin():
        if native and kernel() is None:
            pytest.skip("there is no kernel")
        bodies, kin = BodySet.links(gantry), Kinematics(gantry.tree, 1)
        narrow = Narrowphase(bodies)
        kin.update(gantry.space.to_coordinates(gantry.home_q)[None])
        kin.T[1:] = most, -most, most, 0.0  # a pose that overflows: Coal can say nothing about a box and a sphere
        kin.T[1:, :, :2, 3] = most, -most
        box = np.array([k for k, shape in enumerate(bodies.geometries) if isinstance(shape, coal.Box)])
        zero = np.zeros(len(box), dtype=np.intp)
        with pytest.raises(NumericalError), np.errstate(all="ignore"):
            narrow.query(kin, zero, box, zero, candidates, np.inf)
