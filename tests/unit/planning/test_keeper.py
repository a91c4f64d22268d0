"""A strip that is kept while the world changes: what carries it along does not keep it for ever."""

from __future__ import annotations

import time
from collections.abc import Iterator

import elastic_strips as es
from elastic_strips.planning.keeper import StripKeeper
from elastic_strips.robot import RobotModel

WALKER = es.Capsule(0.3, 1.2, at=(2.5, -1.0, 0.9), name="walker", motion=es.Twist(linear=(0.0, 0.5, 0.0)))
DT = 0.1


def kept(robot: RobotModel, scene_at: es.World, seconds: float) -> Iterator[tuple[StripKeeper, es.Strip]]:
    """A keeper after each tick, with its strip; a path that is planned is waited for."""
    ends = robot.home(), robot.home(x=5.0)
    strip = es.plan(robot, scene_at.at(0.0), *ends)
    keeper = StripKeeper(robot, scene_at.at(0.0), strip, params=None, period=DT)
    try:
        for k in range(round(seconds / DT)):
            scene = scene_at.at(DT * k)
            while keeper.searching:
                strip = keeper.taken(scene) or strip
                time.sleep(0.001)
            strip = keeper.tick(DT * k, strip, scene).strip
            yield keeper, strip
    finally:
        keeper.close()


def test_what_somebody_carries_along_is_planned_anew(silvermate: RobotModel):
    """Who walks across pushes it ahead, also where the robot could long have passed behind."""
    longest, carried, certified = 0.0, 0.0, False
    deformer, alone = es.Deformer(silvermate), None
    for k, (keeper, strip) in enumerate(kept(silvermate, es.World(es.Scene([WALKER])), 25.0)):
        longest, certified = max(longest, strip.length), keeper.report.certified
        scene = es.World(es.Scene([WALKER])).at(DT * k)
        alone = deformer.step(strip if alone is None else alone, scene).strip
        carried = alone.length
    assert certified
    assert keeper.replans >= 1
    assert carried > 10.0, "without it the strip goes along"
    assert strip.length < 6.0
    assert longest < 1.8 * 5.0


def test_a_strip_that_is_as_long_as_it_has_to_be_is_not_planned_anew(silvermate: RobotModel):
    wall = es.Box((0.2, 3.0, 1.4), at=(2.5, 1.0, 0.7), name="wall")
    for keeper, _ in kept(silvermate, es.World(es.Scene([wall])), 4.0):
        assert not keeper.searching
    assert keeper.replans == 0
