"""Counted work: equal for equal inputs, more of it for more to do, each thread's own, and a time for every quantity."""

from __future__ import annotations

from dataclasses import asdict
from threading import Thread

import numpy as np
import pytest
from cases import each

from elastic_strips.planning import straight_line
from elastic_strips.scene import Box, Cylinder, Scene, Twist, World
from elastic_strips.sim import simulation
from elastic_strips.strip import Deformer, Strip
from elastic_strips.work import SECONDS_PER, Work, count_work, counted

CRATE = Box((0.4, 0.4, 1.0), at=(1.6, 0.45, 0.5), name="crate")
PILLAR = Cylinder(0.2, 1.4, at=(2.6, -0.5, 0.7), name="pillar")
WALKER = Cylinder(0.25, 1.7, at=(2.0, -2.5, 0.85), name="walker", motion=Twist(np.array((0.0, 0.9, 0.0))))


def line(robot, spacing: float = 0.13) -> Strip:
    rows = straight_line(robot, robot.home(), robot.home(x=4.0), spacing=spacing)
    return Strip.from_coordinates(robot, rows)


def tick(robot, strip: Strip, obstacles) -> Work:
    deformer = Deformer(robot)
    before = counted()
    deformer.step(strip, Scene(obstacles), nodes=False)
    return counted() - before


def drive(robot) -> Work:
    before = counted()
    world = World(Scene([CRATE, PILLAR, WALKER]))
    simulation(robot, world, robot.home(), robot.home(x=4.0), seed=3).run(time_limit=1.0)
    return counted() - before


@each("name", asdict(Work()))
def test_every_quantity_is_counted_by_itself_and_takes_its_time(name):
    before = counted()
    count_work(**{name: 3})
    work = counted() - before
    assert work == Work(**{name: 3})
    assert work.seconds == pytest.approx(3 * SECONDS_PER[name])
    assert SECONDS_PER[name] > 0.0


def test_equal_drives_are_equal_work(silvermate):
    drive(silvermate)  # what is known of a robot once and for all is computed in its first drive
    first = drive(silvermate)
    assert first == drive(silvermate)
    assert min(first.batches, first.pairs, first.queries, first.obstacles) > 0


def test_more_obstacles_and_more_nodes_are_more_work(silvermate):
    few = tick(silvermate, line(silvermate), [CRATE])
    more = tick(silvermate, line(silvermate), [CRATE, PILLAR])
    assert more.pairs > few.pairs
    assert more.queries > few.queries
    fine = tick(silvermate, line(silvermate, spacing=0.05), [CRATE])
    assert fine.pairs > few.pairs
    assert fine.queries > few.queries


def test_a_search_over_a_grid_and_one_by_samples_are_work(silvermate):
    from elastic_strips.planning import ompl_path, plan_report

    wall = Box((0.3, 3.0, 1.5), at=(2.0, 0.0, 0.75), name="wall")
    ends = silvermate.home(), silvermate.home(x=4.0)
    before = counted()
    plan_report(silvermate, Scene([wall]), *ends, line=False)
    assert (counted() - before).cells > 0
    before = counted()
    found = ompl_path(silvermate, Scene([wall]), *ends, seed=0, margin=0.02, timeout=10.0)
    assert (counted() - before).checks == found.checks > 2


def test_threads_count_apart(silvermate):
    strip, found = line(silvermate), []
    before = counted()
    thread = Thread(target=lambda: found.append((counted(), tick(silvermate, strip, [CRATE]))))
    thread.start()
    thread.join(60.0)
    assert counted() == before
    fresh, work = found[0]
    assert fresh == Work()
    assert work == tick(silvermate, strip, [CRATE])


def test_work_is_plain_numbers(silvermate):
    """They go into JSON documents."""
    count_work(cells=int(np.int64(2)))
    tick(silvermate, line(silvermate), [CRATE])
    assert all(type(amount) is int for amount in asdict(counted()).values())
