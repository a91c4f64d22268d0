"""A run that nobody planned: the robot drives straight on while obstacles move, appear and vanish beside it."""

from __future__ import annotations

import numpy as np

from elastic_strips.control.interfaces import RunState
from elastic_strips.control.record import DRIVE_NAMES, Record, Recorder
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Box, Capsule, Cylinder, Keyframes, Obstacle, Scene, Sphere, Twist, World

DT = 0.01


def moving_world(extra: list[Obstacle] | None = None) -> World:
    """A person who crosses, a cart to and fro, a ball and a bin that come late, a box that goes; shelves."""
    obstacles = [
        *(
            Box((0.8, 0.4, 0.5), at=(x, side * 1.9, 0.25), name=f"shelf {x:g} {side:+d}")
            for x in range(5)
            for side in (-1, 1)
        ),
        Capsule(0.22, 1.2, at=(2.6, -2.4, 0.82), motion=Twist(linear=(0.0, 0.55, 0.0)), name="person"),
        Box(
            (0.6, 0.5, 0.9),
            motion=Keyframes([0.0, 3.0, 6.0], [[0.2, 1.15, 0.45], [1.6, 1.15, 0.45], [0.2, 1.15, 0.45]], loop=True),
            name="cart",
        ),
        Sphere(0.2, at=(4.2, 0.95, 0.9), motion=Twist(angular=(0.0, 0.0, 1.0)), name="ball"),
        Cylinder(0.25, 1.0, at=(3.4, 0.9, 0.5), name="bin"),
        Box((0.3, 0.3, 0.3), at=(1.2, -0.95, 0.15), name="box"),
    ]
    return World(Scene([*obstacles, *(extra or [])]), appears={"ball": 3.0, "bin": 4.0}, vanishes={"box": 2.0})


def straight_run(
    robot: RobotModel, world: World | Scene, *, length: float = 4.0, speed: float = 0.6, wave: float = 0.0
) -> Record:
    """Drive ``length`` [m] along x, slow down half way, go on, and stand at the end for half a second.

    The true motion is off the reference by a millimetre or so; the arm waves by ``wave`` [rad].
    """
    space, home = robot.space, robot.space.to_coordinates(robot.home_q)
    base = space.base_nv
    total = length / speed * 1.5 + 1.0
    time = np.arange(0.0, total, DT)
    rate = speed * np.clip(np.minimum(time / 0.5, (total - 0.5 - time) / 0.5), 0.0, 1.0)
    rate *= 1.0 - 0.85 * np.exp(-(((time - 0.5 * total) / (0.12 * total)) ** 2))
    way = np.concatenate(([0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * DT)))
    rate, way = rate * length / way[-1], way * length / way[-1]
    reference = np.tile(home, (len(time), 1))
    v = np.zeros_like(reference)
    if base:
        reference[:, 0], v[:, 0] = way, rate
    phase = 2.0 * np.pi * time / total
    span = wave * np.array([1.0, 0.6, -0.8, 0.7])[: robot.nv - base]
    reference[:, base : base + len(span)] += np.sin(phase)[:, None] ** 2 * span
    v[:, base : base + len(span)] = (np.sin(2.0 * phase) * 2.0 * np.pi / total)[:, None] * span
    coordinates = reference.copy()
    if base:
        coordinates[:, 1] += 1e-3 * np.sin(7.0 * phase)
    goal = reference[-1]
    recorder = Recorder(robot, world, goal=goal, metadata={"scenario": "straight on", "seed": 0})
    for k, t in enumerate(time):
        slow = rate[k] < 0.5 * speed
        state = RunState.REACHED if k > 0 and way[k] >= length - 1e-6 else RunState.BRAKING if slow else RunState.MOVING
        drive = {2: [v[k, 0]] * 2, 3: v[k, :3]}.get(len(DRIVE_NAMES[robot.base_kind]), [])
        recorder.control(
            t,
            coordinates=coordinates[k],
            v=v[k],
            reference=reference[k],
            reference_v=v[k],
            estimate=coordinates[k],
            drive=np.asarray(drive),
            joints=v[k, base:],
            state=state,
        )
        if k % 5 == 0:
            strip = space.interpolate(
                coordinates[k], goal, np.linspace(0.0, 1.0, max(int(25 * (1 - way[k] / length)), 2))
            )
            if base:
                strip[1:-1, 1] += 0.25 * np.sin(np.pi * np.linspace(0, 1, len(strip))[1:-1]) * np.sin(phase[k])
            recorder.planning(
                t,
                tick_ms=7.0 + np.sin(k),
                phase_ms={"distances": 4.0, "solve": 3.0},
                status="deforming",
                certified=not slow,
                clearance=0.3 + 0.1 * np.sin(phase[k]),
                horizon_end=t + 1.5,
                strip=strip,
                reason="waits for the person" if slow else "",
            )
    recorder.event(0.0, "start", "the goal is ahead")
    recorder.event(0.4 * total, "slow", "the person crosses")
    return recorder.finish()
