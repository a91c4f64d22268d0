"""Dragged goal: the goal of a running drive, held with the mouse in the page."""

from __future__ import annotations

import threading
from typing import Protocol

import numpy as np
import pinocchio as pin

from elastic_strips.arrays import Array
from elastic_strips.errors import InputError
from elastic_strips.planning import Goal, HandPose
from elastic_strips.robot import RobotModel

from .drag import Drag, base_pose
from .hand import hand_solvers
from .viewer import Viewer

_ASKED_EVERY = 0.25  # [s] while it is dragged


class Drives(Protocol):
    """A drive whose goal can be dragged, such as a :class:`~elastic_strips.control.Controller`."""

    time: float
    robot: RobotModel

    @property
    def goal(self) -> Array: ...

    def retarget(self, goal: Goal) -> None:
        """Take another goal."""
        ...


class DraggedGoal:
    """The goal of a drive follows the mouse: the ring is where the base is to be, the ball where the hand is.

    The page is heard in a thread of the viewer's own; the drive is given its goal by whoever calls :meth:`tell`.

    Args:
        viewer: in whose page it is dragged.
        drive: what is given the goal.

    Attributes:
        refused: why the drive did not take the goal that it was told last; empty where it did.
    """

    def __init__(self, viewer: Viewer, drive: Drives) -> None:
        self.refused: str = ""
        self._viewer, self._drive = viewer, drive
        self._planar = drive.robot.space.planar
        hands = hand_solvers(drive.robot)
        self._hand = None if hands is None else hands[1]  # of the thread that hears
        self._lock = threading.Lock()
        self._wanted: Array | None = None  # (nv,) where it is dragged to
        self._pose: Array | None = None  # (4, 4) of the hand there; None: the base is dragged
        self._held: tuple[bool, Array, Array] | None = None  # hand, and row (nv,) and pose (4, 4) when it was grabbed
        self._due = False  # whether the drive has not been told yet
        self._told_at, self._goal_before = -np.inf, drive.goal
        viewer.listen(self._hear, obstacles=False, goal=self._planar, hand=self._hand is not None)

    def close(self) -> None:
        """Let nobody drag any more."""
        self._viewer.listen(None)

    @property
    def shown(self) -> Array | None:
        """(nv,) where the goal is to be drawn; None: where the strip ends."""
        with self._lock:
            return self._wanted

    def tell(self) -> None:
        """Give the drive its new goal, if there is one."""
        drive = self._drive
        with self._lock:
            wanted, pose, held = self._wanted, self._pose, self._held is not None
            if wanted is None:
                return
            if not self._due:
                if not held and drive.goal is not self._goal_before:  # it is the drive's own by now
                    self._wanted = None
                return
            if held and drive.time < self._told_at + _ASKED_EVERY:
                return
            self._due = False
            self._told_at, self._goal_before = drive.time, drive.goal
        try:
            drive.retarget(self._goal(wanted, pose))
            self.refused = ""
        except InputError as error:
            self.refused = str(error)

    def _goal(self, wanted: Array, pose: Array | None) -> Goal:
        if pose is None or self._hand is None:
            return self._drive.robot.space.from_coordinates(wanted)
        x, y, z = pose[:3, 3].tolist()
        qx, qy, qz, qw = pin.Quaternion(pose[:3, :3]).coeffs().tolist()
        return HandPose(self._hand.frame, (x, y, z), (qx, qy, qz, qw))

    def _hear(self, drag: Drag) -> None:
        """A message of a page, in the thread that hears them."""
        if drag.name is not None or (self._hand is None if drag.hand else not self._planar):
            return
        if drag.kind == "grab":
            shown = self.shown
            row = self._drive.goal if shown is None else shown
            pose = self._hand.pose(row) if drag.hand and self._hand is not None else base_pose(row)
            with self._lock:
                self._held = drag.hand, row, pose
        elif drag.kind == "release":
            with self._lock:
                self._held = None
        elif self._held is not None and self._held[0] == drag.hand:
            _, row, grabbed = self._held
            pose = drag.applied(grabbed)
            if drag.hand and self._hand is not None:
                wanted = self._hand.reached(row, pose, base=self._planar)
            else:
                wanted = np.array([*pose[:2, 3], np.arctan2(pose[1, 0], pose[0, 0]), *row[3:]])
            with self._lock:
                self._wanted, self._pose, self._due = wanted, pose if drag.hand else None, True
