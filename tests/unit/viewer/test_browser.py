"""Browser: a real one draws the pages without an error, and there is something to see."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from elastic_strips.robot import load_robot
from elastic_strips.viewer import Viewer

SCREENSHOT = Path(__file__).parents[3] / "scripts" / "screenshot"
STATE = """fold(false), new Promise((done) => setTimeout(() => done({
  calls: viewer.renderer.info.render.calls,
  card: document.getElementById("es-card").innerText,
  injected: document.querySelectorAll("#es-card b b, b:not(#es-card b)").length,
  hulls: viewer.scene_tree.find(["hulls"]).children["<object>"].object.visible,
  ghosts: Math.max(...Object.values(viewer.scene_tree.children.ghosts.children).map((c) => c.object.children[0].count)),
  playing: animator.playing, duration: animator.duration,
}), 1500))"""


@pytest.fixture(scope="module")
def robot():
    """One of few triangles: a browser without a graphics card draws Silvermate in seconds a picture."""
    return load_robot("bridge-arm")


def shot(page, picture):
    """Draw a page by the script; return what the page says about itself and the picture as an array."""
    from PIL import Image

    command = [sys.executable, SCREENSHOT, str(page), str(picture), "--size", "640x400", "--script", STATE]
    done = subprocess.run(command, capture_output=True, text=True, timeout=200)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout), np.asarray(Image.open(picture).convert("RGB")).astype(int)


def check(state, picture):
    assert 20 < state["calls"] < 150
    assert "0.123 m" in state["card"]
    assert state["injected"] == 0
    assert state["hulls"] is False
    assert state["ghosts"] == 7
    below = picture[200:]  # below the card
    assert np.ptp(below) > 150
    green, red = (below[..., 1] - below[..., 0]), (below[..., 0] - below[..., 1])
    assert (green > 60).sum() > 50  # the certified part of the base's path
    assert (red > 40).sum() > 200  # obstacles


@pytest.mark.usefixtures("chromium")
def test_a_live_page(robot, scene, make_report, tmp_path):
    with Viewer() as viewer:
        viewer.show(robot, scene, make_report())
        for k in range(20):
            viewer.update(make_report(shift=0.01 * k), scene.at(0.05 * k))
        state, picture = shot(viewer.url, tmp_path / "live.png")
        assert viewer.alive
    check(state, picture)
    assert "0.95 s" in state["card"]
    assert not state["playing"]


def test_a_saved_page_that_plays(robot, scene, make_report, tmp_path, look):
    with Viewer(server=False) as viewer:
        viewer.animate(robot, scene, make_report(), 5.0)
        page = viewer.save_html(tmp_path / "play.html")
    state, picture = look(page, STATE)
    check(state, picture)
    assert state["playing"]
    assert state["duration"] == pytest.approx(5.0, abs=0.1)
