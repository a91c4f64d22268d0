"""Page benchmark: how many pictures a second the live page shows in a browser on this machine."""

from __future__ import annotations

import time

import numpy as np

from elastic_strips.planning import plan
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Box, Cylinder, Obstacle, Scene, Sphere, Twist

from .measure import Figures, Note, head, percentiles, silent

_PAGE_SETTLING_TIME = 10.0  # [s] until the page has found how plain it has to draw
_MEASURE = """new Promise((resolve) => {
  const at = [], render = viewer.render;
  viewer.render = () => { render(); at.push(performance.now()); };
  setTimeout(() => { viewer.render = render; resolve(at); }, %d);
})"""
_RENDERER = """(() => {
  const gl = viewer.renderer.getContext(), info = gl.getExtension("WEBGL_debug_renderer_info");
  return gl.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : gl.RENDERER);
})()"""


def bench_page(
    robot: RobotModel,
    seconds: float = 10.0,
    step: Note = silent,
    *,
    obstacles: int = 60,
    movers: int = 5,
    size: tuple[int, int] = (1280, 720),
) -> Figures:
    """Pictures a second of a live strip among obstacles, some of which move, in Chromium without a window.

    Args:
        robot: the robot of the strip.
        seconds: duration of measuring, after 10 s in which the page finds how plain it has to draw.
        step: called with a note.
        obstacles: number of obstacles that stand.
        movers: number of spheres that move.
        size: width and height of the page [pixels].

    Raises:
        BrowserError: there is no Chromium, or it does not start.
    """
    from elastic_strips.viewer import LiveStrip, Viewer
    from elastic_strips.viewer.browser import Browser

    scene = _crowd(obstacles, movers)
    strip = plan(robot, scene, robot.home(x=-2.0), robot.home(x=8.0))
    with (
        Viewer(title="bench page") as viewer,
        LiveStrip(robot, scene, strip, viewer=viewer) as live,
        Browser(size=size) as browser,
    ):
        browser.open(str(viewer.url), fine=False)
        time.sleep(_PAGE_SETTLING_TIME)
        step("settled")
        ticks, began = live.ticks, time.monotonic()
        at = np.array(browser.evaluate(_MEASURE % round(1e3 * seconds)), dtype=float)
        rate = (live.ticks - ticks) / (time.monotonic() - began)
        step("measured")
        plain = browser.evaluate("+(document.body.dataset.plain || 0)")
        renderer = browser.evaluate(_RENDERER)
    return {
        **head("page", robot=robot.name),
        "obstacles": obstacles,
        "movers": movers,
        "size": list(size),
        "pictures_per_s": len(at) / seconds,
        "between_pictures_ms": percentiles(np.diff(at)),
        "ticks_per_s": rate,
        "plainness": plain,
        "renderer": renderer,
    }


def _crowd(obstacles: int, movers: int) -> Scene:
    """Boxes, balls and posts on both sides of the way, and balls that come near it."""
    rng = np.random.default_rng(3)
    scene: list[Obstacle] = []
    for k in range(obstacles):
        x, y = rng.uniform(-3.0, 9.0), rng.uniform(1.4, 6.0) * rng.choice([-1.0, 1.0])
        if k % 3 == 0:
            scene.append(Box(rng.uniform(0.2, 0.7, 3), at=(x, y, 0.4)))
        elif k % 3 == 1:
            scene.append(Sphere(0.25, at=(x, y, 0.6)))
        else:
            scene.append(Cylinder(0.2, 0.9, at=(x, y, 0.5)))
    for k in range(movers):
        scene.append(Sphere(0.2, at=(6.0 * k / max(movers, 1), 3.0, 0.5), motion=Twist(np.array((0.0, -0.1, 0.0)))))
    return Scene(scene)
