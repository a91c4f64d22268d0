"""The study's figures: millimetres, obstacles and safe distances where they are, the robot's outline as it stands."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon

from elastic_strips import RobotModel, Scene
from elastic_strips.io import PoseSpec
from elastic_strips.scene import Box, Capsule, Cylinder, Sphere
from elastic_strips.sim.scenarios import Scenario, get_scenario
from workshop.study import PaperRun, simulate_paper
from workshop.study.figures import Outline, draw_drive, draw_paper_run, draw_scene

Array = npt.NDArray[np.float64]
LYING = (0.0, np.sin(np.pi / 4), 0.0, np.cos(np.pi / 4))
"""Quaternion that lays what stands along x."""


def _axes() -> Axes:
    return Figure().subplots()


def _circles(axes: Axes) -> list[tuple[float, float, float, bool]]:
    """(x, y, radius, filled) of every circle."""
    return [(*np.round(p.center, 3), round(p.radius, 3), p.get_fill()) for p in axes.patches if isinstance(p, Circle)]


def _polygons(axes: Axes, *, filled: bool) -> list[Array]:
    """Corners (K, 2) of every polygon."""
    found = [p for p in axes.patches if isinstance(p, Polygon) and p.get_fill() == filled]
    return [np.asarray(p.get_xy())[:-1] for p in found]


def _line(axes: Axes, label: str) -> Array:
    """(K, 2) the points of a labelled line."""
    [line] = [found for found in axes.lines if found.get_label() == label]
    return np.asarray(line.get_xydata())


@pytest.fixture(scope="module")
def short() -> PaperRun:
    """2 m along x, a cylinder 1 m beside the way that is sensed at a safe distance of 1 m."""
    pole = Cylinder(0.3, 1.0, at=(1.2, 1.1, 0.5), name="pole")
    params = {"paper": {"mobile_only": True, "influence": 1.0}}
    return simulate_paper(
        Scenario("short", "", Scene([pole]), PoseSpec(0.0, 0.0, 0.0), PoseSpec(2.0, 0.0, 0.0), params=params)
    )


def test_round_obstacles_are_circles_in_millimetres() -> None:
    """The case's two cylinders, each with its safe distance about it."""
    scene = get_scenario("case-1").scene
    axes = _axes()
    draw_scene(axes, scene, 1.5)
    expected = []
    for obstacle in scene:
        x, y = np.round(1e3 * obstacle.pose[:2, 3], 3)
        expected += [(x, y, 300.0, True), (x, y, 1800.0, False)]
    assert _circles(axes) == expected
    assert [text.get_text() for text in axes.texts] == list(scene.names)


def test_other_shapes_are_outlines() -> None:
    """A turned box by its corners; a lying capsule by its length; a ball is round however it is turned."""
    turn = (0.0, 0.0, np.sin(np.pi / 8), np.cos(np.pi / 8))
    box = Box((2.0, 1.0, 0.5), at=(3.0, 4.0, 0.5), quat=turn, name="box")
    rod = Capsule(0.1, 1.0, at=(0.0, 0.0, 1.0), quat=LYING, name="rod")
    ball = Sphere(0.2, at=(1.0, -1.0, 1.0), name="ball")
    axes = _axes()
    draw_scene(axes, Scene([box, rod, ball]), 0.5)
    corners, outline = _polygons(axes, filled=True)
    s = np.sqrt(0.5)
    expected = np.array([[3.0, 4.0]]) + np.array([[1, 0.5], [-1, 0.5], [-1, -0.5], [1, -0.5]]) @ [[s, s], [-s, s]]
    assert len(corners) == 4
    for corner in expected:
        assert np.hypot(*(corners - 1e3 * corner).T).min() < 1e-6
    np.testing.assert_allclose(np.abs(outline).max(axis=0), [600.0, 100.0], atol=1.0)
    safe, _ = _polygons(axes, filled=False)
    away = [min(np.hypot(*(p - 1e3 * c)) for c in expected) for p in safe]
    np.testing.assert_allclose(away, 500.0, atol=1e-6)
    assert _circles(axes) == [(1000.0, -1000.0, 200.0, True), (1000.0, -1000.0, 700.0, False)]


def test_without_a_safe_distance_none_is_drawn() -> None:
    """One circle for each cylinder."""
    axes = _axes()
    draw_scene(axes, get_scenario("case-1").scene)
    assert [filled for *_, filled in _circles(axes)] == [True, True]


def test_a_reactive_run_is_drawn_in_millimetres(short: PaperRun) -> None:
    """Original line, way, where the obstacle was sensed from, and a frame of 1.2 m about it all."""
    axes = _axes()
    draw_paper_run(axes, short)
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x [mm]", "y [mm]")
    assert axes.get_aspect() == 1.0
    np.testing.assert_allclose([*axes.get_xlim(), *axes.get_ylim()], [-1200.0, 3200.0, -1200.0, 1200.0])
    np.testing.assert_allclose(_line(axes, "original line"), 1e3 * short.line)
    np.testing.assert_allclose(_line(axes, "way of the mobile"), 1e3 * short.coordinates[:, :2])
    [detection] = short.detections
    np.testing.assert_allclose(_line(axes, "sensed points"), [1e3 * np.array(detection.point[:2])])
    rays = [np.asarray(line.get_xydata()) for line in axes.lines if len(np.asarray(line.get_xydata())) == 2]
    assert any(np.allclose(ray, 1e3 * np.array([detection.robot, detection.point[:2]])) for ray in rays)
    assert _circles(axes) == [(1200.0, 1100.0, 300.0, True), (1200.0, 1100.0, 1300.0, False)]
    postures = _polygons(axes, filled=False)
    assert len(postures) == len(short.coordinates[::3]) + 1
    np.testing.assert_allclose(np.mean([postures[-1].min(axis=0), postures[-1].max(axis=0)], axis=0), [2000, 0], atol=1)


def test_a_drive_is_drawn_with_its_arm(short: PaperRun) -> None:
    """21 postures of the coordinates, each with the arm's control points where that is asked for."""
    coordinates = np.repeat(short.coordinates, 5, axis=0)
    for arm in (False, True):
        axes = _axes()
        draw_drive(axes, short.robot, short.scenario.scene, short.line, coordinates, arm=arm)
        assert len(_polygons(axes, filled=False)) == 21
        points = len(short.robot.control_point_set.names) - 1
        arms = [line for line in axes.lines if len(np.asarray(line.get_xydata())) == points]
        assert len(arms) == (21 if arm else 0)
        np.testing.assert_allclose(_line(axes, "way of the mobile"), 1e3 * coordinates[:, :2])


def test_the_outline_turns_and_moves_with_the_base(silvermate: RobotModel) -> None:
    """What is fixed to the base is 0.55 m wide; the arm does not widen it."""
    outline = Outline(silvermate)
    home = silvermate.space.to_coordinates(silvermate.home_q)
    there = home.copy()
    there[:3] = 1.0, 2.0, np.pi / 2
    a, b = outline.base(home), outline.base(there)
    assert np.ptp(a[:, 1]) == pytest.approx(0.55, abs=0.01)
    turned = a @ np.array([[0.0, 1.0], [-1.0, 0.0]]) + [1.0, 2.0]
    for low, high in ((turned.min(axis=0), b.min(axis=0)), (turned.max(axis=0), b.max(axis=0))):
        np.testing.assert_allclose(low, high, atol=0.01)
    np.testing.assert_allclose(outline.arm(home), silvermate.control_points(silvermate.home_q)[1:, :2], atol=1e-9)
