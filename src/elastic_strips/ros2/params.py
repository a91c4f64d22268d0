"""Parameters of the node: each is a ROS parameter of the same name; and what odometry's rate makes of a drive's."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Annotated

from elastic_strips.arrays import Array
from elastic_strips.control import DriveParams, MonitorParams
from elastic_strips.control.params import LASER_ASSUMPTIONS, LASER_EASE, seen_turn_speed
from elastic_strips.errors import ParameterError
from elastic_strips.robot import RobotModel
from elastic_strips.trajectory import MotionLimits
from elastic_strips.validation import Bound, Checked, Count, Finite, NonNegative, Positive, check_choice

ARMS = ("none", "trajectory", "velocity")
"""How the arm is commanded: not at all, by trajectories that end at rest, or by velocities."""
ACTIONS = ("navigate_to_pose", "follow_path")
"""The actions that the node may serve, of the types of nav2_msgs."""
TF = "/tf"
"""Topic of transforms, in every namespace."""
MODES = ("drive", "guard")
"""What is driven: to goals, or what somebody else commands, as far as the guard passes it on."""
_LOST_MESSAGES = 4.0  # so many periods of odometry may pass without one before that counts as silence
_LONGEST_GAP = 2.0  # [s] of odometry that the robot goes on after: it sums it up itself. Later it may have begun anew,
_SAME_PLACE = 0.15  # [m, rad] unless it is as near as that to where the motors were told to go meanwhile
_STEP = 0.005  # [m] tracking errors are multiples of this


@dataclass(frozen=True, slots=True, kw_only=True)
class Ros2Params(Checked):
    """What the node is told; lengths [m], angles [rad], times [s].

    Attributes:
        robot: name or URDF file of the robot.
        mode: one of `MODES`.
        world_frame: frame of goals, paths and maps; that of odometry where no fix is taken.
        odom_frame, base_frame: frames that odometry has to be in; None: any.
        odom, joint_states, cmd_vel, goal_pose, plan_in, hand_pose: topics.
        hand: frame of the robot that goals on ``hand_pose`` are for; None: none are taken.
        actions: those of `ACTIONS` that are served, where nav2_msgs is there; None: none. Beside Nav2's own servers of
            the same name leave these out.
        scans: topics of lasers; None, or one empty name: none.
        clouds: topics of point clouds.
        depths: topics of depth images, rectified; each has its ``camera_info`` beside it.
        depth_near, depth_far: shortest and longest depth that these cameras can tell.
        depth_pixels: of images with more pixels, squares of some are taken as one.
        map: topic of an occupancy grid; None: none.
        fix: topic of a ``PoseWithCovarianceStamped`` of the base in the world; None: none.
        fix_from_tf: whether the transform on ``/tf`` from ``world_frame`` to ``odom_frame``, both of which have to be
            named then, is taken as such a fix instead, with the pose of odometry.
        tf_noise, tf_angle_noise: standard deviations of such a fix, as a transform has none of its own.
        emergency: topic of a ``Bool`` that is true while the emergency stop is pressed; None: none. Where one is
            named and nothing has come, the stop counts as pressed.
        mounts: poses of sensors that no link of the robot has the name of: frame, x, y, z, roll, pitch, yaw, with
            colons between.
        stamped: whether velocities are TwistStamped rather than Twist.
        arm: one of `ARMS`. Most controllers of velocities have no watchdog: where this program is killed the arm
            would go on.
        arm_topic: topic of the arm's commands.
        cmd_vel_in, joint_velocities_in: topics of what somebody else commands, to be guarded: a Twist, and a
            Float64MultiArray in the order of the robot's joints.
        stamped_in: whether the former is TwistStamped.
        oldest_command: age from which on such a command counts no more.
        oldest: largest age of a message that is still used.
        oldest_scene: a scene that is older is not driven on: it is as old as the sensor that is behind all others.
        tracking_error, silence: as `DriveParams` and `MonitorParams` have them; 0: by the rate of odometry.
        speed: part of the speeds that the robot's limits allow, which nothing exceeds; where it drives to goals it may
            be set to less, and back, while it runs. At 0 it stands.
        backward: whether the robot may plan, or be commanded, backwards: something has to look there.
        within: largest distance of the base from a path of others.
        path_posture: posture of the arm on such a path: ``home``, or another one that the robot's SRDF has a name
            for, or positions as ``joint:value``, the other joints as at home. The arm is moved before the robot sets
            out. None: it stays as it is when the path comes.
        level: frame of the robot that is kept as level as it is when the node starts, such as a tray's, on the way to
            goals and along paths of others. The robot drives on where that is not possible.
        goal_position, goal_angle: how near counts as reached.
        footprint_ahead: the ``footprint`` holds the robot for so long on its motion; 0: now.
        low, high: heights between which the points of clouds count.
        patience: how long the node waits for the robot's topics.
        log: file that the executor writes; None: none.
    """

    robot: str = "silvermate"
    mode: str = "drive"
    world_frame: str | None = None
    odom_frame: str | None = None
    base_frame: str | None = None
    odom: str = "odom"
    joint_states: str = "joint_states"
    scans: tuple[str, ...] | None = ("scan",)
    clouds: tuple[str, ...] | None = None
    depths: tuple[str, ...] | None = None
    depth_near: Positive = 0.3
    depth_far: Positive = 4.0
    depth_pixels: Count = 20_000
    map: str | None = None
    fix: str | None = None
    fix_from_tf: bool = False
    tf_noise: Positive = 0.02
    tf_angle_noise: Positive = 0.01
    emergency: str | None = None
    mounts: tuple[str, ...] | None = None
    goal_pose: str = "goal_pose"
    hand_pose: str = "hand_pose"
    hand: str | None = None
    plan_in: str = "plan_in"
    actions: tuple[str, ...] | None = ACTIONS
    cmd_vel: str = "cmd_vel"
    stamped: bool = True
    arm: str = "trajectory"
    arm_topic: str = "arm_controller/joint_trajectory"
    cmd_vel_in: str = "cmd_vel_in"
    joint_velocities_in: str = "joint_velocities_in"
    stamped_in: bool = True
    oldest_command: Positive = 0.15
    oldest: Positive = 0.5
    oldest_scene: Positive = 0.25
    tracking_error: NonNegative = 0.0
    silence: NonNegative = 0.0
    speed: Annotated[float, Bound(above=0.0, high=1.0)] = LASER_EASE
    backward: bool = False
    within: Positive = 0.3
    path_posture: tuple[str, ...] | None = None
    level: str | None = None
    goal_position: Positive = 0.05
    goal_angle: Positive = 0.05
    footprint_ahead: NonNegative = 0.0
    low: Finite = 0.1
    high: Finite = 1.6
    patience: Positive = 30.0
    log: str | None = None

    def __post_init__(self) -> None:
        Checked.__post_init__(self)
        check_choice("arm", self.arm, ARMS)
        check_choice("mode", self.mode, MODES)
        if self.fix_from_tf and not (self.world_frame and self.odom_frame):
            raise ParameterError("fix_from_tf=True: world_frame and odom_frame have to be named, map and odom say")
        if self.fix_from_tf and self.fix is not None:
            raise ParameterError(f"fix_from_tf=True and fix={self.fix!r}: a fix comes from one of them")
        for action in self.actions or ():
            check_choice("actions", action, ACTIONS)
        for mount in self.mounts or ():
            mount_of(mount)
        for name in ("path_posture", "level"):
            if getattr(self, name) and self.arm == "none":
                raise ParameterError(f"{name}={getattr(self, name)!r}: with arm='none' the arm is not commanded")
        if self.level and self.mode == "guard":
            raise ParameterError(f"level={self.level!r}: with mode='guard' somebody else commands the arm")

    @property
    def seen(self) -> tuple[str, ...]:
        """The topics of sensors, all of which scenes rest on."""
        return *(self.scans or ()), *(self.depths or ()), *(self.clouds or ())

    @property
    def fixes(self) -> str:
        """The topic from which fixes come; empty: none do."""
        return TF if self.fix_from_tf else self.fix or ""

    @property
    def frame(self) -> str:
        """The frame of what is published in the world."""
        return self.world_frame or self.odom_frame or "odom"

    @staticmethod
    def names() -> dict[str, object]:
        """The parameters' names and defaults."""
        return {field.name: field.default for field in fields(Ros2Params)}


def mount_of(text: str) -> tuple[str, tuple[float, ...]]:
    """Frame, and x, y, z [m], roll, pitch, yaw [rad] of a sensor on the base.

    Raises:
        ParameterError: the text has another form.
    """
    frame, *values = text.split(":")
    try:
        numbers = tuple(float(value) for value in values)
    except ValueError:
        numbers = ()
    if not frame or len(numbers) != 6:
        raise ParameterError(f"mounts: {text!r} is not frame:x:y:z:roll:pitch:yaw")
    return frame, numbers


def posture_of(robot: RobotModel, told: tuple[str, ...] | None) -> Array | None:
    """(n,) positions of the joints [rad or m] that ``path_posture`` names; None where it does not.

    Raises:
        ParameterError: neither one name nor joints with values.
        ConfigurationError: there is no such posture, or no such joint, or one is beyond its range.
    """
    if not told:
        return None
    if len(told) == 1 and ":" not in told[0]:
        q = robot.home() if told[0] == "home" else robot.state(told[0])
    else:
        joints: dict[str, float] = {}
        for entry in told:
            name, _, value = entry.partition(":")
            try:
                joints[name] = float(value)
            except ValueError:
                raise ParameterError(
                    f"path_posture: {entry!r} is neither the one name of a posture nor joint:value"
                ) from None
        q = robot.home(joints=joints)
    return robot.space.to_coordinates(q)[robot.space.base_nv :]


def drive_params(params: Ros2Params, limits: MotionLimits, period: float) -> DriveParams:
    """How the robot is driven where odometry comes every ``period`` [s].

    What is not said follows from it: some messages may be lost, and between two of them the robot goes on unseen.
    """
    usual, monitor = DriveParams(), MonitorParams()
    top = float(limits.drive_speed.max(initial=0.0))
    silence = params.silence or max(monitor.silence, _LOST_MESSAGES * period)
    unseen = _STEP * round(top * period / _STEP)
    error = params.tracking_error or max(usual.tracking_error, min(unseen, monitor.largest))
    return replace(
        usual,
        assumptions=LASER_ASSUMPTIONS,
        monitor=replace(monitor, silence=silence, longest_arc=_LONGEST_GAP, same_place=_SAME_PLACE),
        tracking_error=error,
        max_scene_age=params.oldest_scene,
        backward=params.backward,
        turn_speed=seen_turn_speed(behind=params.backward, arm=len(limits.joint_speed) > 0),
        goal_position=params.goal_position,
        goal_angle=params.goal_angle,
    )
