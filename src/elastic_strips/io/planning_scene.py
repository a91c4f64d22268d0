"""IO room, planning scenes: what MoveIt knows of a scene: obstacles, what the robot holds, and how it stands."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.errors import RobotError, SceneError
from elastic_strips.robot import RobotModel
from elastic_strips.robot.kinematics import find_frame
from elastic_strips.scene import Obstacle, Scene
from elastic_strips.summary import Summary

_log = logging.getLogger(__name__)
USUAL_WORLDS = ("", "world", "map")
_ODOMETRY = ("odom", "odom_combined")
"""Frames that count as the world, as for a path's poses."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class AttachedObject(Summary):
    """An object that a link of the robot holds.

    Attributes:
        name: name of the object.
        link: the link that holds it.
        touch: names of further links that may touch it.
        shapes: its shapes, as obstacles in ``frame``.
        frame: frame of the shapes: the link's name, or that of another frame of the robot; None: the world.
        weight: its mass [kg].
    """

    name: str
    link: str
    touch: tuple[str, ...]
    shapes: tuple[Obstacle, ...]
    frame: str | None
    weight: float


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PlanningScene(Summary):
    """The content of a message.

    Attributes:
        scene: the obstacles.
        attached: what the robot holds.
        joints: the robot's joints in the scene's state, by name [rad or m].
        base: (x, y, yaw) of the robot's base in it [m, m, rad], or None.
        frame: the frame that counts as the world, "" where none is named.
    """

    scene: Scene
    attached: tuple[AttachedObject, ...] = ()
    joints: Mapping[str, float] = field(default_factory=dict)
    base: tuple[float, float, float] | None = None
    frame: str = ""

    def pose_of_frame(self, robot: RobotModel, q: Array | None) -> Array | None:
        """Pose (4, 4) of ``frame`` in the world, where it is one of the robot's own; None where it is the world.

        Args:
            robot: the robot.
            q: (nq,) configuration of the robot when the scene was seen, or None.

        Raises:
            SceneError: the frame moves, and it is not known where it was; or it is neither the robot's nor one that
                worlds are called after, so that nothing says where it is.
        """
        index = None if self.frame in USUAL_WORLDS else find_frame(robot.model, self.frame)
        if index is None:
            if self.frame.rsplit("/", 1)[-1] not in (*USUAL_WORLDS, *_ODOMETRY):
                raise SceneError(
                    f"the scene is in the frame {self.frame!r}, which {robot.name!r} does not have, and nothing says "
                    "where it is: give its pose in the world as 'at' (--at); 0,0,0 where it is the world"
                )
            return None
        if robot.model.frames[index].parentJoint != 0 and q is None:
            raise SceneError(
                f"the scene is in the frame {self.frame!r}, which moves with the robot: 'at' or where the robot stood "
                "has to be given"
            )
        return robot.frame_pose(robot.home_q if q is None else q, self.frame)

    def attached_at(self, pose: Array) -> tuple[AttachedObject, ...]:
        """The held objects, if the scene's frame has the pose (4, 4)."""
        return tuple(
            replace(thing, shapes=tuple(shape.moved(pose @ shape.pose) for shape in thing.shapes))
            if thing.frame is None
            else thing
            for thing in self.attached
        )

    def held_by(self, robot: RobotModel) -> RobotModel:
        """The robot with the objects that it holds in the scene: `RobotModel.attached` for every shape.

        Raises:
            RobotError: the robot has no such link, or the link does not move.
            ConfigurationError: an object stands in another frame than its link, and the scene's state does not fit.
        """
        held = robot
        for thing in self.attached:
            frames = {frame.name for frame in robot.model.frames}
            T = np.eye(4)
            if thing.frame != thing.link:
                q = self._q(robot)
                T = np.linalg.inv(robot.frame_pose(q, thing.link))
                T = T if thing.frame is None else T @ robot.frame_pose(q, thing.frame)
            if unknown := sorted(set(thing.touch) - frames):
                _log.warning("%s: no links of %r may touch it: %s", thing.name, robot.name, ", ".join(unknown[:12]))
            for shape in thing.shapes:
                placed = shape.moved(T @ shape.pose)
                taken = {name for piece in held.geometries for name in (piece.name, *piece.links)}
                name = shape.name or thing.name
                while name in taken:
                    name += "'"
                touch = [link for link in thing.touch if link in frames]
                held = held.attached(placed, thing.link, touch=touch, mass=thing.weight, name=name)
        return held

    def _q(self, robot: RobotModel) -> Array:
        """The robot's configuration in the scene's state."""
        joints = {name: value for name, value in self.joints.items() if name in robot.joint_names}
        if missing := [name for name in robot.joint_names if name not in joints]:
            raise RobotError(
                f"what {robot.name!r} holds is given in another frame than its link's, and the scene's robot_state "
                f"has no {', '.join(missing[:6])}"
            )
        return robot.home(*(self.base or (0.0, 0.0, 0.0)) if robot.space.planar else (), joints=joints)
