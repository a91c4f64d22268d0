"""What sensors see: in the page as points, views and pictures, sent only where it has changed."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import umsgpack
from cases import refused

import elastic_strips as es
from elastic_strips.errors import ParameterError
from elastic_strips.perception import NO_ANSWER, NOTHING, DepthImage, RangeImage
from elastic_strips.scene import Box, Scene, Voxels
from elastic_strips.viewer import Seen, Viewer
from elastic_strips.viewer.drawing import Drawing, Snapshot
from elastic_strips.viewer.sensed import SeenDrawing

FORWARD = np.eye(4)
FORWARD[:3, :3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
FORWARD[:3, 3] = (0.1, 0.0, 1.2)


def camera(time=0.0, size=(12, 16), **changes):
    depth = np.full(size, 2.0, dtype=np.float32)
    depth[0, :4], depth[1, :4] = NO_ANSWER, NOTHING
    image = DepthImage("eye", time, FORWARD, depth, (14.0, 14.0), (7.5, 5.5), 0.3, 6.0)
    return replace(image, **changes)


def told(commands):
    """The commands by their kinds and places."""
    out = {}
    for _, payload in commands:
        command = umsgpack.unpackb(payload)
        out[command["type"], command.get("path", command.get("sensor", ""))] = command
    return out


def floats(ext):
    return np.frombuffer(ext.data, dtype="<f4").reshape(-1, 3)


def test_points_are_where_the_world_was_met():
    (command,) = [
        told(SeenDrawing().draw(Seen(readings=((camera(), (3.0, 1.0, np.pi / 2)),))))["points", "/sensed/points"]
    ]
    points = floats(command["places"])
    assert len(points) == 12 * 16 - 8
    assert np.allclose(points[:, 1], 1.0 + 0.1 + 2.0, atol=1e-4)  # the base looks along y


def test_points_are_thinned():
    wide = camera(size=(240, 320), focal=(280.0, 280.0), center=(159.5, 119.5))
    other = replace(camera(), sensor="other")
    found = told(SeenDrawing().draw(Seen(readings=((wide, np.zeros(3)), (other, np.zeros(3))))))
    points = floats(found["points", "/sensed/points"]["places"])
    assert 2000 < len(points) <= 5000
    picture = found["depth", "eye"]
    assert len(picture["pixels"].data) <= 20_000


def test_a_picture_tells_nothing_from_no_answer():
    picture = told(SeenDrawing().draw(Seen(readings=((camera(), np.zeros(3)),))))["depth", "eye"]
    levels = np.frombuffer(picture["pixels"].data, dtype=np.uint8).reshape(-1, picture["columns"])
    assert levels.shape == (12, 16)
    assert (levels[0, :4] == 0).all()
    assert (levels[1, :4] == 255).all()
    assert (levels[2:] == round(1 + 253 * 1.7 / 5.7)).all()


def test_a_lidars_picture_is_as_one_looks_along_it():
    ranges = np.full((3, 8), 4.0, dtype=np.float32)
    ranges[-1, -1] = NO_ANSWER  # the highest, furthest to the left
    image = RangeImage("lidar", 0.0, np.eye(4), ranges, (-2.0, 2.0), (-0.1, 0.5), 0.1, 40.0)
    picture = told(SeenDrawing().draw(Seen(readings=((image, np.zeros(3)),))))["depth", "lidar"]
    levels = np.frombuffer(picture["pixels"].data, dtype=np.uint8).reshape(-1, picture["columns"])
    assert levels[0, 0] == 0
    assert (levels != 0).sum() == levels.size - 1


def test_only_what_changed_is_sent():
    drawing, image = SeenDrawing(), camera()
    block = Voxels.of_boxes(np.array([[20, 0, 10]]), np.array([[21, 1, 11]]), 0.05, "volume-0-0-0")
    other = Voxels.of_boxes(np.array([[40, 0, 10]]), np.array([[41, 1, 11]]), 0.05, "volume-1-0-0")
    seen = Seen(readings=((image, np.zeros(3)),), scene=Scene([block], time=0.0))
    first = told(drawing.draw(seen))
    assert ("set_object", "/map/estimated volume-0-0-0") in first
    assert drawing.draw(seen) == []
    soon = Seen(readings=((camera(0.06), np.zeros(3)),), scene=Scene([block, other], time=0.06))
    found = told(drawing.draw(soon))
    assert ("points", "/sensed/points") in found
    assert not any(kind in ("depth", "set_object") for kind, _ in found)  # a few times a second
    later = Seen(readings=((camera(0.2), np.zeros(3)),), scene=Scene([block, other], time=0.2))
    found = told(drawing.draw(later))
    assert [path for kind, path in found if kind == "set_object"] == ["/map/estimated volume-1-0-0"]
    assert ("depth", "eye") in found
    gone = told(drawing.draw(None))
    assert len(gone["points", "/sensed/points"]["places"].data) == 0
    assert gone["depth", "eye"]["columns"] == 0
    assert ("delete", "/map/estimated volume-1-0-0") in gone
    assert drawing.draw(None) == []


def test_a_view_and_what_is_looked_at():
    target = np.array([1.5, 0.5, 0.4])
    found = told(SeenDrawing().draw(Seen(readings=((camera(), np.zeros(3)),), target=target)))
    edges = floats(found["lines", "/views/edges"]["places"]).reshape(-1, 2, 3)
    assert len(edges) == 8
    assert np.allclose(edges[::2, 0], FORWARD[:3, 3], atol=1e-4)
    assert np.allclose(edges[1::2, :, 0], 0.1 + 1.5, atol=1e-4)
    gaze = floats(found["lines", "/views/gaze"]["places"])
    assert np.allclose(gaze, [FORWARD[:3, 3], target], atol=1e-4)
    without = told(SeenDrawing().draw(Seen(readings=((camera(), np.zeros(3)),))))
    assert len(without["lines", "/views/gaze"]["places"].data) == 0


def test_what_was_not_seen_can_be_looked_through(robot):
    scene = Scene([Box((0.4, 0.4, 0.4), at=(1, 0, 0.2), name="unseen-3-0-0"), Box((0.4, 0.4, 0.4), at=(2, 0, 0.2))])
    drawing = Drawing(title="", ghosts=1)
    found = told(drawing.draw(Snapshot(robot, scene, robot.home()[None])))
    look = found["set_object", "/unseen/unseen-3-0-0"]["object"]["materials"][0]
    assert look["transparent"]
    assert look["opacity"] < 0.5
    assert any("not seen" in name for name, _ in found["hud", ""]["legend"])
    shared = found["instances", "/obstacles/all box"]
    assert len(shared["matrices"].data) == 4 * 16  # of the other alone


def test_what_is_shown_of_sensors_is_checked(robot):
    with Viewer(server=False) as viewer, refused(ParameterError, "seen"):
        strip = es.Strip(robot, np.tile(robot.home(), (2, 1)))
        viewer.update(strip, seen=camera())  # pyright: ignore[reportArgumentType]


def test_a_certificate_of_another_strip_colours_none(make_report):
    """While a motion alone is planned again, a report has its certificate from the strip before."""
    report = make_report()
    shorter = replace_segments(report, report.certificate.segments[:-6])
    drawing = Drawing(title="", ghosts=1)
    found = told(drawing.draw(Snapshot(report.strip.robot, Scene([]), report.strip.q, shorter)))
    band = found["set_object", "/strip/base"]["object"]["geometries"][0]["data"]["attributes"]
    shades = np.frombuffer(band["color"]["array"].data, dtype=np.uint8).reshape(-1, 3)
    assert len(np.unique(shades, axis=0)) == 1


def replace_segments(report, segments):
    certificate = SimpleNamespace(certified=False, segments=segments, broken=None)
    return SimpleNamespace(**(vars(report) | {"certificate": certificate}))


STATE = """new Promise((done) => requestAnimationFrame(done)).then(() => {
  const points = viewer.scene_tree.find(["sensed", "points"]).children["<object>"].object;
  const canvas = document.querySelector("#es-depth canvas");
  const pixel = (x, y) => canvas ? [...canvas.getContext("2d").getImageData(x, y, 1, 1).data] : [];
  const before = [points.visible, getComputedStyle(byId("es-depth")).display];
  toggle("sensed"); toggle("depth");
  const after = [points.visible, getComputedStyle(byId("es-depth")).display];
  toggle("sensed"); toggle("depth");
  return { points: points.geometry.drawRange.count, size: [canvas.width, canvas.height], lost: pixel(0, 0),
           nothing: pixel(0, 1), wall: pixel(8, 8), before, after };
})"""


def test_the_page_draws_it_and_can_hide_it(robot, look, tmp_path):
    with Viewer(server=False) as viewer:
        strip = es.Strip(robot, np.array([robot.home(), robot.home(x=0.5)]))
        viewer.update(strip, Scene([]), seen=Seen(readings=((camera(), np.zeros(3)),)))
        viewer.update(strip, seen=Seen(readings=((camera(1.0, size=(24, 16)), np.zeros(3)),)))
        state, _ = look(viewer.save_html(tmp_path / "page.html"), STATE)
    assert state["points"] == 24 * 16 - 8
    assert state["size"] == [16, 24]
    assert state["lost"][:3] == [150, 150, 150]
    assert state["nothing"][:3] == [255, 255, 255]
    assert state["wall"][:3] not in (state["lost"][:3], state["nothing"][:3])
    assert state["before"] == [True, "block"]
    assert state["after"] == [False, "none"]


@pytest.mark.parametrize("make", [camera])
def test_images_have_their_points(make):
    image = make()
    assert np.allclose(image.points()[:, 0], 2.1, atol=1e-6)
    assert len(image.points()) == image.hits.sum()
