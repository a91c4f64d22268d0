"""Progress: which nodes are still ahead."""

from __future__ import annotations

import numpy as np
import pytest
from cases import each

from elastic_strips.control.progress import trim_passed
from elastic_strips.planning import straight_line
from elastic_strips.strip import Deformer


@pytest.fixture(scope="module")
def weight(silvermate):
    return Deformer(silvermate).spacing_weight


def line(robot, x=2.0, **goal):
    return straight_line(robot, robot.home(), robot.home(x=x, **goal), spacing=0.1)


@each("x, first", [(0.0, 1), (0.03, 1), (0.06, 2), (0.13, 2), (0.31, 4)])
def test_nodes_that_were_passed_or_crowd_are_left_out(silvermate, weight, x, first):
    coordinates = line(silvermate)
    here = coordinates[0].copy()
    here[0] = x
    nodes, source = trim_passed(silvermate.space, coordinates, here, weight)
    np.testing.assert_array_equal(nodes[0], here)
    assert source[0] == -1
    assert source[1] == first
    np.testing.assert_array_equal(nodes[1:], coordinates[source[1:]])
    assert source[-1] == len(coordinates) - 1


def test_the_goal_is_never_left_out(silvermate, weight):
    coordinates = line(silvermate, 0.3)
    for x in (0.29, 0.3, 0.31):
        here = coordinates[-1].copy()
        here[0] = x
        nodes, source = trim_passed(silvermate.space, coordinates, here, weight)
        assert source.tolist() == [-1, len(coordinates) - 1]
        np.testing.assert_array_equal(nodes[-1], coordinates[-1])


def test_a_cusp_is_not_left_out_while_moving(silvermate, weight):
    """Forward one metre and back again: the way back passes where the robot is."""
    out = line(silvermate, 1.0)
    coordinates = np.vstack([out, out[-2::-1]])
    here = coordinates[0].copy()
    for x in np.linspace(0.0, 0.98, 50):
        here[0] = x
        _, source = trim_passed(silvermate.space, coordinates[max(0, int(x * 10) - 1) :], here, weight)
        offset = max(0, int(x * 10) - 1)
        assert source[1] + offset <= len(out) - 1
    here[0] = 0.99
    _, source = trim_passed(silvermate.space, coordinates[8:], here, weight, moving=False)
    assert source[1] + 8 > len(out) - 1  # standing beside the cusp it may be left out


def test_a_strip_that_comes_back_is_not_cut_short(silvermate, weight):
    """A loop: the end is where the start was."""
    t = np.linspace(0.0, 2.0 * np.pi, 60)
    coordinates = np.repeat(silvermate.space.to_coordinates(silvermate.home())[None], 60, axis=0)
    coordinates[:, 0], coordinates[:, 1], coordinates[:, 2] = np.sin(t), 1.0 - np.cos(t), t
    here = silvermate.space.interpolate(coordinates[:1], coordinates[1:2], 0.5)[0]
    _, source = trim_passed(silvermate.space, coordinates, here, weight)
    assert source[1] in (1, 2)


def test_a_node_that_is_unsteady_is_no_corner_once_it_is_passed(silvermate, weight):
    """Its heading is off by more than what is left of the way to it: where it has come to lie behind the robot, that
    drives on, it stays there otherwise, and the strip leads back to it, further and further."""
    off = [(-0.029, 0.0), (-0.008, 0.08), (0.172, -0.14), (0.356, 0.07), (0.537, 0.28)]
    coordinates = np.repeat(silvermate.space.to_coordinates(silvermate.home())[None], len(off), axis=0)
    coordinates[:, [0, 2]] += off
    here = coordinates[0].copy()
    here[[0, 2]] -= off[0]
    _, source = trim_passed(silvermate.space, coordinates, here, weight)
    assert source.tolist() == [-1, 2, 3, 4]


@each("step", [0.02, 0.05, 0.09, 0.13])
def test_nothing_lies_behind_a_robot_on_an_unsteady_strip(silvermate, weight, step):
    """Wheels drive such a strip without a stop."""
    rng = np.random.default_rng(3)
    for _ in range(50):
        x = np.append(0.0, np.cumsum(rng.uniform(0.01, 0.2, 40)))
        rows = np.repeat(silvermate.space.to_coordinates(silvermate.home())[None], len(x), axis=0)
        rows[:, 0], rows[:, 2] = x, rows[:, 2] + rng.uniform(-0.15, 0.15, len(x))
        at = 0.0
        while at + step < x[-1] - 0.06:
            at += step
            here = rows[0].copy()
            here[0], here[2] = at, 0.0
            rows, _ = trim_passed(silvermate.space, rows, here, weight)
            assert rows[1, 0] > at - 1e-9
