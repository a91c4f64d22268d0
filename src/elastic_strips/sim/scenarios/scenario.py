"""Scenario: a scene with a start and a goal, for a robot and a preset."""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields

import numpy as np

from elastic_strips.arrays import Array
from elastic_strips.errors import ConfigurationError, RobotError, ScenarioError, SceneError
from elastic_strips.io import HandSpec, PoseSpec
from elastic_strips.io.scene_file import ScenarioSpec
from elastic_strips.io.scene_source import SceneFile
from elastic_strips.planning import BasePose, Goal, HandPose
from elastic_strips.robot import BaseKind, LoadOptions, RobotModel, load_robot
from elastic_strips.robot.loading import is_known
from elastic_strips.robot.reach import highest_reach
from elastic_strips.scene import Scene, World
from elastic_strips.strip import DeformParams
from elastic_strips.strip.paper import PaperParams
from elastic_strips.summary import Summary

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, repr=False)
class Scenario(Summary):
    """A problem to run.

    Attributes:
        name, summary: its name and description.
        scene: the obstacles that exist at its time.
        start, goal: base poses and joint values; a goal may be a hand's pose.
        robot: name or URDF path of the robot that it was made for.
        robot_options: further arguments of ``load_robot``.
        base: base kind, or None for the robot's own.
        preset: default preset.
        params: preset → parameter overrides.
        postures: robot name → joint values of both ends, for robots that the joints of ``start`` and ``goal`` do not
            fit.
        gap: names of two obstacles that define the passing side (between, around-left, around-right), or None.
        seed: seed of everything random.
        timeline: all obstacles with the times at which they appear and vanish; None where ``scene`` holds all of them;
            use :attr:`world`.
        speed_class: bound of the speeds of moving obstacles [m/s], or None where none is stated.
        source: everything in the files that the scene was read from, or None.
        via: goals of a drive on the way to ``goal``, one after the other.
    """

    name: str
    summary: str
    scene: Scene
    start: PoseSpec
    goal: PoseSpec | HandSpec
    robot: str = "silvermate"
    base: str | None = None
    preset: str = "default"
    params: Mapping[str, Mapping[str, object]] = field(default_factory=dict)
    postures: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    gap: tuple[str, str] | None = None
    seed: int = 0
    timeline: World | None = None
    speed_class: float | None = None
    robot_options: LoadOptions = field(default_factory=LoadOptions)
    source: SceneFile | None = None
    via: tuple[PoseSpec | HandSpec, ...] = ()

    @property
    def world(self) -> World:
        """The obstacles over time; keep it during a run, as each snapshot is made from the one before.

        With yielding obstacles, each access returns a new world with reset clocks.
        """
        return World(self.scene) if self.timeline is None else self.timeline.copied(history=False)

    @staticmethod
    def from_spec(spec: ScenarioSpec) -> Scenario:
        """The scenario that a file describes."""
        default, paper = ({f.name for f in fields(kind)} for kind in (DeformParams, PaperParams))
        params = {  # a parameter of one preset alone is dropped for the other
            "default": {name: value for name, value in spec.params.items() if name not in paper - default},
            "paper": {name: value for name, value in spec.params.items() if name not in default - paper},
        }
        return Scenario(
            name=spec.name,
            summary=spec.description,
            scene=spec.scene,
            start=spec.start,
            goal=spec.goal,
            robot=spec.robot,
            base=spec.base,
            preset=spec.preset or "default",
            params=params,
            seed=spec.seed,
            timeline=spec.world,
            robot_options=spec.robot_options,
            source=spec.source,
            via=spec.via,
        )

    def load_robot(
        self,
        robot: str | None = None,
        preset: str | None = None,
        base: str | None = None,
        options: LoadOptions | None = None,
    ) -> RobotModel:
        """Load the scenario's robot, or another one; with preset ``paper`` a planar base is ``omni`` (Eq. 9).

        ``options`` take precedence over the scenario's own, which are for its robot alone. What the robot holds in a
        planning scene is part of the robot.

        Raises:
            RobotError: an unknown robot, an error in its files, or an unknown link that is to hold something.
            ScenarioError: it reaches over the walls of a map whose height no file gives; or a planning
                scene is in a frame that moves with the robot, or that it does not have.
        """
        base = base or self.base
        if (preset or self.preset) == "paper" and base != BaseKind.FIXED.value:
            base = BaseKind.OMNI.value
        try:
            told = LoadOptions()
            if robot is None:
                told.update(self.robot_options)
            told.update(options or {})
            loaded = load_robot(robot or self.robot, base=base, **told)
            loaded = loaded if self.source is None else self.source.held_by(loaded)
        except RobotError as error:
            if robot is not None:
                raise
            raise RobotError(f"scenario {self.name!r}: {error}") from None
        self._check_walls(loaded)
        self._check_frames(loaded)
        return loaded

    def _check_frames(self, robot: RobotModel) -> None:
        for scene in () if self.source is None else self.source.unplaced:
            try:
                pose = scene.pose_of_frame(robot, None)
            except SceneError as error:
                raise ScenarioError(f"scenario {self.name!r}: {error}; scene: {{file: …, at: [x, y, z]}}") from None
            if pose is not None and not np.allclose(pose, np.eye(4), rtol=0.0, atol=1e-9):
                raise ScenarioError(
                    f"scenario {self.name!r}: its scene is in the frame {scene.frame!r}, which {robot.name!r} does not "
                    "have at the origin: say where it is, scene: {file: …, at: [x, y, z]}"
                )

    def _check_walls(self, robot: RobotModel) -> None:
        assumed = None if self.source is None else self.source.assumed_height
        if assumed is not None and (reach := highest_reach(robot)) > assumed:
            raise ScenarioError(
                f"scenario {self.name!r}: the walls of its map are taken to be {assumed:g} m high, and {robot.name!r} "
                f"may reach up to {reach:.2f} m: say how high they are, scene: {{file: …, high: {math.ceil(reach)}}}"
            )

    def ends(self, robot: RobotModel) -> tuple[Array, Array]:
        """Start and goal configurations (nq,) of a robot; of a hand's pose, the one next to the start.

        Raises:
            ConfigurationError: a joint that the robot does not plan (for the robot that the scenario was made for).
            GoalError: no configuration that is free has the hand at the goal.
        """
        from elastic_strips.control.itinerary import configurations  # here: who plans loads nothing that drives

        start = self.start_of(robot)
        return start, configurations(robot, self.scene, start, [self._said("goal", robot, self.goal)])[0]

    def start_of(self, robot: RobotModel) -> Array:
        """The start's configuration (nq,) of a robot.

        Raises:
            ConfigurationError: as for :meth:`ends`.
        """
        return np.asarray(self._said("start", robot, self.start), dtype=float)

    def goals(self, robot: RobotModel) -> list[Goal]:
        """The goals of a drive, one after the other.

        Raises:
            ConfigurationError: as for :meth:`ends`.
        """
        places = [(f"via[{k}]", pose) for k, pose in enumerate(self.via)]
        return [self._said(what, robot, pose) for what, pose in (*places, ("goal", self.goal))]

    def _said(self, what: str, robot: RobotModel, pose: PoseSpec | HandSpec) -> Goal:
        if isinstance(pose, HandSpec):
            return HandPose(pose.frame, pose.at, pose.turned, pose.within)
        if pose.any_yaw:
            return BasePose(pose.x, pose.y)
        try:
            return self._configuration(robot, pose)
        except ConfigurationError as error:
            raise ConfigurationError(f"scenario {self.name!r}, {what}: {error}") from None

    def _configuration(self, robot: RobotModel, pose: PoseSpec) -> Array:
        joints = dict(pose.joints)
        others = sorted(set(joints) - set(robot.joint_names) - set(robot.followers))
        if others and is_known(self.robot) and robot.name != self.robot:  # a robot that it was not made for
            joints = dict(self.postures.get(robot.name, {}))
            if self.source is not None:
                _log.warning(
                    "scenario %r is of %r: %r has no %s, and is at home there", self.name, self.robot, robot.name,
                    ", ".join(others),
                )  # fmt: skip
        if not robot.space.planar:
            if (pose.x, pose.y, pose.yaw) != (0.0, 0.0, 0.0):
                raise ScenarioError(
                    f"scenario {self.name!r} moves the base, but the base of {robot.name!r} is fixed; "
                    "use diff_drive or omni"
                )
            return robot.home(joints=joints)
        return robot.home(pose.x, pose.y, pose.yaw, joints)
