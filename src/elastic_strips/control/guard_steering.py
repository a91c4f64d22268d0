"""Steering: a differential drive that is about to run askew into something that stands is turned along it in time.

It cannot slide, and close to a wall its corners keep it from turning. Like any proposal this one proves nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.collision import BodySet, BrokenSegment, Certificate, ObstacleProximity
from elastic_strips.robot import Kinematics, RobotModel
from elastic_strips.scene import Obstacle, Scene
from elastic_strips.trajectory import MotionLimits, ReferenceState, Trajectory

from .evasion import motion_to

_PREVIEW = 0.8  # [s] for which a command is looked ahead, besides its braking
_PREVIEW_STEP = 0.05  # [s]
_LEAST_SPEED = 0.1  # [m/s] a slower command is not steered
_TURNS = ((0.2, 1.0), (0.4, 1.0), (0.7, 1.0), (1.1, 1.0), (1.6, 1.0), (1.6, 0.5), (1.6, 0.2))
"""Turns [rad/s] that are added, and the part of the speed that is left with them."""
_EVERY = 0.05  # [s] from one look ahead to the next, while the command stays
_SAME_COMMAND = 0.05  # [m/s, rad/s] by which it may change
_HEAD_ON = np.cos(np.radians(25.0))  # nearer to head-on than this, the robot is meant to get there
_FARTHEST = 2.5  # [m] within which it is known how what is in the way lies


@dataclass(frozen=True, slots=True, eq=False)
class Steered:
    """A command that was looked ahead with.

    Attributes:
        v: (nv,) velocity.
        free: whether it runs into nothing for a while; certified.
        turned: whether it is not the wanted one.
    """

    v: Array
    free: bool
    turned: bool


class Steering:
    """Workspace: the turn that keeps a command from running into something.

    Args:
        robot: the robot, with a differential drive.
        limits: limits of its motors, as fast as it may be.
        part: share of the acceleration limits with which it moves.

    Attributes:
        cause: link and obstacle that it was turned for last.
    """

    def __init__(self, robot: RobotModel, limits: MotionLimits, *, part: float) -> None:
        self.robot: RobotModel = robot
        self.limits: MotionLimits = limits
        self.cause: tuple[str, str] = ("", "")
        self._part = part
        self._kin = Kinematics(robot.tree, 1)
        self._near = ObstacleProximity(BodySet.links(robot), influence=_FARTHEST)
        self._wall: tuple[Obstacle, Scene] | None = None
        self._turn = 0  # number of the turn, from 1 on; 0: none
        self._side = 1.0
        self._free = False  # whether the command is free with it
        self._wanted: Array | None = None  # for which it was chosen
        self._until = -np.inf  # [s] when to look again

    def forget(self) -> None:
        """What was found does not hold any more: look ahead anew at the next command."""
        self._until = -np.inf

    def reset(self) -> None:
        """Forget all that is known, as is needed after an exception."""
        self._near.reset()
        self._wall, self._turn, self._until = None, 0, -np.inf

    def steer(
        self,
        wanted: Array,
        start: ReferenceState,
        scene: Scene,
        certify: Callable[[Trajectory], Certificate],
    ) -> Steered:
        """A command near the wanted one that runs into nothing for a while, where there is one.

        Args:
            wanted: (nv,) velocity.
            start: first state.
            scene: sensed.
            certify: certifies a motion.
        """
        if abs(wanted[0]) < _LEAST_SPEED:
            self._turn, self._until = 0, -np.inf
            return Steered(wanted, free=False, turned=False)
        same = self._wanted is not None and float(np.abs(wanted[:3] - self._wanted[:3]).max()) < _SAME_COMMAND
        if not (same and start.time < self._until):
            self._wanted, self._until = wanted, start.time + _EVERY
            self._free = self._look(wanted, start, scene, certify)
        return Steered(self._turned(wanted, self._turn), free=self._free, turned=self._turn > 0)

    def _look(
        self, wanted: Array, start: ReferenceState, scene: Scene, certify: Callable[[Trajectory], Certificate]
    ) -> bool:
        """Choose the turn: one less than the last where that is free, else that, else one more; whether it is free.

        What moves is braked for: turned away from that as well, the robot would go round on the spot.
        """
        less = max(self._turn - 1, 0)
        broken = certify(self._ahead(wanted, start, less)).broken
        if broken is None:
            self._turn = less
            return True
        if self._turn == 0 and not self._askew(broken, wanted, start, scene):
            return False
        number = max(self._turn, 1)
        refused = certify(self._ahead(wanted, start, number)).broken
        free = refused is None
        if self._turn and any(_moves(each, scene) for each in (broken, refused)):
            self._turn = 0
            return False
        self._turn = number if free else min(number + 1, len(_TURNS))
        if not free:
            self._until = start.time  # look again at once
        return free

    def _askew(self, broken: BrokenSegment, wanted: Array, start: ReferenceState, scene: Scene) -> bool:
        """Whether what a command runs into stands, and lies so that the robot can be turned along it; and which way."""
        if broken.kind != "obstacle" or _moves(broken, scene):
            return False
        away = self._away(start, scene.obstacle(broken.obstacle))
        way = np.sign(wanted[0]) * np.array([np.cos(start.coordinates[2]), np.sin(start.coordinates[2])])
        if away is None or -float(way @ away) > _HEAD_ON:
            return False
        self.cause = broken.labels or (broken.link, broken.obstacle)
        self._side = 1.0 if way[0] * away[1] - way[1] * away[0] >= 0.0 else -1.0
        return True

    def _turned(self, wanted: Array, number: int) -> Array:
        """The command with one of the turns, from 1 on, as fast as the wheels can; itself for 0."""
        if number == 0:
            return wanted
        turn, share = _TURNS[number - 1]
        twist = np.array([share * wanted[0], 0.0, wanted[2] + self._side * turn])
        drive = self.limits.to_drive(twist)
        v = wanted.copy()
        v[:3] = twist / max(1.0, float((np.abs(drive) / self.limits.drive_speed).max()))
        return v

    def _ahead(self, wanted: Array, start: ReferenceState, number: int) -> Trajectory:
        """The base's motion with a command and a turn; the joints stay."""
        v = start.v.copy()
        v[3:] = 0.0
        start = replace(start, v=v)
        drive = self.limits.to_drive(self._turned(wanted, number)[:3])
        motion = motion_to(self.robot, self.limits, start, drive, part=self._part, duration=_PREVIEW, dt=_PREVIEW_STEP)
        assert motion is not None
        return motion

    def _away(self, start: ReferenceState, obstacle: Obstacle) -> Array | None:
        """(2,) unit direction from an obstacle to the robot where they are nearest; None where it is far, or above."""
        if self._wall is None or self._wall[0] is not obstacle:
            self._wall = obstacle, Scene([obstacle])
        self._kin.update(start.coordinates[None])
        self._near.update(self._kin, self._wall[1])
        contacts = self._near.contacts()
        if not len(contacts):
            return None
        direction = contacts.direction[int(np.argmin(contacts.distance)), :2]
        size = float(np.hypot(*direction))
        return direction / size if size > 0.1 else None


def _moves(broken: BrokenSegment | None, scene: Scene) -> bool:
    """Whether what refutes a motion is an obstacle that moves."""
    return broken is not None and broken.kind == "obstacle" and scene.moves(broken.obstacle)
