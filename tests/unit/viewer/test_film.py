"""Film: pictures and films of what plays, and what is said where there can be none."""

from __future__ import annotations

import sys
from io import BytesIO

import numpy as np
import pytest
from cases import refused

from elastic_strips.errors import InputError, ParameterError
from elastic_strips.robot import load_robot
from elastic_strips.viewer import BrowserError, Viewer
from elastic_strips.viewer.film import film_writer

imageio = pytest.importorskip("imageio.v3")


@pytest.fixture
def viewer(scene):
    robot = load_robot("bridge-arm")
    path = np.array([robot.home(x=x) for x in np.linspace(-1.0, 4.0, 12)])
    with Viewer(server=False, ghosts=2) as viewer:
        yield viewer.animate(robot, scene, path, 1.0)


@pytest.mark.usefixtures("chromium")
def test_a_picture_of_a_moment(viewer, tmp_path):
    pictures = [imageio.imread(viewer.save_png(tmp_path / f"{t}.png", size=(240, 150), time=t)) for t in (0.0, 0.9)]
    assert pictures[0].shape[:2] == (150, 240)
    assert np.abs(pictures[0].astype(int) - pictures[1]).max() > 100  # the robot is elsewhere


@pytest.mark.usefixtures("chromium")
@pytest.mark.parametrize("ending", ["gif", "mp4"])
def test_a_film_has_its_pictures_and_its_speed(viewer, tmp_path, ending):
    if ending == "mp4":
        pytest.importorskip("imageio_ffmpeg")
    file = viewer.save_film(tmp_path / f"film.{ending}", size=(320, 200), fps=2.0)
    frames = list(imageio.imiter(BytesIO(file.read_bytes()), extension="." + ending))
    assert len(frames) == 3  # 1 s, first and last among them
    assert np.abs(frames[0].astype(int) - frames[-1]).max() > 100
    if ending == "gif":
        assert imageio.immeta(file)["duration"] == 500  # [ms]


def test_wrong_files_and_speeds_are_said_before_anything_is_drawn(viewer, tmp_path):
    with refused(InputError, "mp4"):
        viewer.save_film(tmp_path / "film.avi")
    with refused(ParameterError, "fps"):
        viewer.save_film(tmp_path / "film.gif", fps=0.0)
    with refused(InputError, ".png"):
        viewer.save_png(tmp_path / "picture.gif")
    with refused(InputError, "nowhere"):
        viewer.save_png(tmp_path / "nowhere" / "x.png")


@pytest.mark.usefixtures("chromium")
def test_nothing_plays(scene, make_report, robot, tmp_path):
    with Viewer(server=False) as viewer, refused(InputError, "plays"):
        viewer.show(robot, scene, make_report()).save_film(tmp_path / "film.gif")
    assert not (tmp_path / "film.gif").exists()


def test_without_a_chromium_the_message_says_how_to_get_one(viewer, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("CHROMIUM", "")
    with refused(BrowserError, "chromium"):
        viewer.save_png(tmp_path / "x.png")


@pytest.mark.parametrize("ending", ["gif", "mp4", "webm"])
@pytest.mark.parametrize("room", [200, 20_000])
def test_a_film_that_finds_no_room_is_an_error_and_no_film(tmp_path, monkeypatch, ending, room):
    """Where the disk is full ffmpeg ends without a word, and what it has written is the beginning of a film."""
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # half a module's would be believed later
    resource = pytest.importorskip("resource")
    if ending != "gif":
        pytest.importorskip("imageio_ffmpeg")
    noise = np.random.default_rng(0).integers(0, 255, (6, 128, 128, 3), dtype=np.uint8)
    pictures = [imageio.imwrite("<bytes>", picture, extension=".png") for picture in noise]
    target = tmp_path / f"film.{ending}"

    def write() -> None:
        with film_writer(target, fps=10.0) as film:
            for picture in pictures:
                film.add(picture)

    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, before[1]))
    try:
        with pytest.raises(InputError, match=target.name):
            write()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert list(tmp_path.iterdir()) == []
    write()
    assert len(list(imageio.imiter(BytesIO(target.read_bytes()), extension="." + ending))) >= len(pictures)
