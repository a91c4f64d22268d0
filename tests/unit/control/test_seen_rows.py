"""Seen rows: what sensors made of the world is there from when until when it was, where and as large as it was."""

from __future__ import annotations

import numpy as np
import pytest

from elastic_strips.control.seen_rows import SEEN_PERIOD, SEEN_SHAPES, SeenLog, SeenRows
from elastic_strips.scene import UNSEEN_LAYER, Box, Capsule, Cylinder, Obstacle, Scene, Sphere, Twist, Voxels
from elastic_strips.scene.quantities import rotation_of

TURNED = (0.0, 0.0, np.sin(0.4), np.cos(0.4))


def logged(*looks: tuple[float, list[Obstacle]], end: float) -> SeenRows:
    log = SeenLog()
    for time, obstacles in looks:
        log.look(time, Scene(obstacles, time=time))
    return log.rows(end)


def test_what_stays_is_one_row_and_what_changes_is_another():
    wall, post = Box((2.0, 0.1, 1.0), at=(1.0, 1.0, 0.5), name="wall"), Sphere(0.2, at=(0.0, 0.0, 1.0), name="post")
    longer = Box((3.0, 0.1, 1.0), at=(1.5, 1.0, 0.5), name="wall")
    rows = logged((0.0, [wall, post]), (1.0, [wall]), (2.0, [longer]), (3.0, [longer]), end=3.5)
    found = sorted(zip(rows.begin, rows.end, rows.size[:, 0], strict=True))
    assert found == [(0.0, 1.0, pytest.approx(0.4)), (0.0, 2.0, pytest.approx(2.0)), (2.0, 3.5, pytest.approx(3.0))]
    assert [int(rows.there(t).sum()) for t in (0.0, 0.5, 1.0, 1.5, 2.0, 3.4, 3.5)] == [2, 2, 1, 1, 1, 1, 0]
    assert not any(array.flags.writeable for array in (rows.begin, rows.size, rows.shape))


def test_shapes_are_where_and_as_large_as_the_obstacles(rng: np.random.Generator):
    """Corners of the boxes, turned and moved, against those of the obstacles' own pieces."""
    cells = np.array([(0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.5, 0.5, 0.2)])
    map_ = Voxels(cells, 0.1, at=(1.0, 2.0, 0.3), quat=TURNED, name="map")
    person = Cylinder(0.25, 1.7, at=(3.0, 1.0, 0.85), quat=TURNED, motion=Twist(linear=(0.0, 1.0, 0.0)), name="person")
    rows = logged((0.0, [map_, person, Sphere(0.3, at=(1.0, 1.0, 1.0)), Capsule(0.1, 0.4)]), end=1.0)
    names = [SEEN_SHAPES[code] for code in rows.shape]
    assert sorted(names) == sorted(["box"] * (len(rows) - 2) + ["cylinder", "sphere"])
    boxes = [k for k in range(len(rows)) if names[k] == "box" and rows.size[k, 2] < 0.25]
    inside = rng.uniform(-0.5, 0.5, (400, 3))
    turned = rotation_of(np.array(TURNED))
    for k in boxes:
        world = rows.position[k] + (inside * rows.size[k]) @ rotation_of(rows.quaternion[k]).T
        local = (world - (1.0, 2.0, 0.3)) @ turned
        assert (np.abs(local[:, None] - cells).max(axis=2).min(axis=1) <= 0.05 + 1e-9).all()
    assert sum(float(np.prod(rows.size[k])) for k in boxes) == pytest.approx(3e-3)
    (who,) = [k for k in range(len(rows)) if rows.moves[k]]
    assert names[who] == "cylinder"
    np.testing.assert_allclose(rows.size[who], (0.5, 0.5, 1.7))
    np.testing.assert_allclose(rows.position[who], (3.0, 1.0, 0.85))
    (capsule,) = [k for k in range(len(rows)) if names[k] == "box" and k not in boxes]
    np.testing.assert_allclose(rows.size[capsule], (0.2, 0.2, 0.6))


def test_looks_just_after_another_and_what_is_unseen_are_left_out():
    here, gone = Box((1.0, 1.0, 1.0), name="a"), Box((1.0, 1.0, 1.0), name=f"{UNSEEN_LAYER}-3")
    rows = logged((0.0, [here, gone]), (0.5 * SEEN_PERIOD, []), (SEEN_PERIOD, [here]), end=1.0)
    assert rows.begin.tolist() == [0.0]
    assert rows.end.tolist() == [1.0]
    assert len(SeenLog().rows(1.0)) == 0


def test_collecting_goes_on_after_rows_were_taken():
    log = SeenLog()
    log.look(0.0, Scene([Box((1.0, 1.0, 1.0), name="a")]))
    assert log.rows(0.2).end.tolist() == [0.2]
    log.look(1.0, Scene())
    assert log.rows(2.0).end.tolist() == [1.0]
