"""What the viewer's tests share: a robot, a scene, and reports that look like those of the deformer."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from elastic_strips.robot import load_robot
from elastic_strips.scene import Box, Capsule, Cone, ConvexHull, Cylinder, Mesh, Points, Scene, Sphere, Twist, Voxels
from elastic_strips.strip import Strip
from elastic_strips.strip.report import DeformStatus
from elastic_strips.viewer.browser import Browser


@pytest.fixture(scope="session")
def robot():
    return load_robot("silvermate")


@pytest.fixture(scope="session")
def scene():
    grid = np.stack(np.meshgrid(np.arange(3), np.arange(4), np.arange(5)), axis=-1).reshape(-1, 3)
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
    return Scene(
        [
            Box((0.6, 0.6, 1.4), at=(1.5, 1.0, 0.7)),
            Sphere(0.25, at=(2.4, 0.8, 1.0)),
            Cylinder(0.2, 1.0, at=(0.0, 1.0, 0.5)),
            Cone(0.2, 0.5, at=(0.0, -1.0, 0.25)),
            Capsule(0.2, 1.0, at=(4.0, -1.0, 0.7), motion=Twist(linear=(-0.3, 0.1, 0.0))),
            ConvexHull(corners, at=(3.0, -1.5, 0.0)),
            Mesh(corners, np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]), at=(4.0, 1.5, 0.0)),
            Voxels(0.1 * grid + 0.05, 0.1, at=(5.0, 1.0, 0.0)),
            Points(0.07 * grid, 0.03, at=(5.0, -1.0, 0.2), name="</script><b>cloud</b>/1"),
        ]
    )


@pytest.fixture
def make_report(robot):
    def make(shift: float = 0.0, nodes: int = 40, **changes: object) -> SimpleNamespace:
        s = np.linspace(0.0, 1.0, nodes)
        coordinates = np.tile(robot.space.to_coordinates(robot.home()), (nodes, 1))
        coordinates[:, 0] = -1.0 + 7.0 * s
        coordinates[:, 1] = (0.5 + shift) * np.sin(np.pi * s) ** 2
        coordinates[:, 2] = np.arctan2(np.gradient(coordinates[:, 1]), np.gradient(coordinates[:, 0]))
        strip = Strip.from_coordinates(robot, coordinates)
        segments = np.arange(nodes - 1) != 5
        fields = {
            "strip": strip,
            "status": DeformStatus.DEFORMING,
            "reason": "",
            "clearance": 0.1234,
            "node_clearance": changes.get("clearance", 0.1234),
            "certificate": SimpleNamespace(certified=False, segments=segments, broken=None),
            "energies": {},
            "timings": {},
            "forces": SimpleNamespace(points=np.ones((5, 3)), vectors=np.eye(5, 3)),
            "hulls": SimpleNamespace(
                points=np.array([robot.control_points(q) for q in strip.q]),
                radius=np.full((nodes, len(robot.control_point_set.names)), 0.2),
            ),
            "connectivity_counts": False,
            "as_it_stands": (),
        }
        return SimpleNamespace(**(fields | changes))

    return make


@pytest.fixture(scope="session")
def browser(chromium: str) -> Iterator[Browser]:
    """One for all tests that look at a page."""
    with Browser(size=(640, 400)) as browser:
        yield browser


@pytest.fixture
def look(browser: Browser) -> Callable[[str | Path, str], tuple[object, np.ndarray]]:
    """Draw a page; return what it says about itself, and the picture as an array."""
    from PIL import Image

    def look(page: str | Path, script: str) -> tuple[object, np.ndarray]:
        browser.open(page)
        state = browser.evaluate(script)
        assert browser.errors == []
        picture = np.asarray(Image.open(BytesIO(browser.picture())).convert("RGB")).astype(int)
        browser.evaluate("void setTimeout(() => location.replace('about:blank'))")  # else it is drawn on, for nobody
        return state, picture

    return look
