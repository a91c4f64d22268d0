"""Limits: how fast wheels and joints may turn and how fast that may change; and the coordinates of the drive.

A path is timed in *drive coordinates*: the travel of each wheel's rim for a differential drive, the three components
of the body's travel for an omnidirectional base, nothing for a fixed one; then the joints. In them every limit of the
motors is a plain box, and a constant velocity is an exact arc of the base.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from elastic_strips.arrays import Array, Mask
from elastic_strips.errors import ParameterError, RobotError, nearest_name
from elastic_strips.robot import BaseKind, RobotModel
from elastic_strips.robot.space import UNLIMITED_SPEED
from elastic_strips.robot.wheels import DrivenWheels
from elastic_strips.summary import Summary
from elastic_strips.validation import NonNegative, check_fields, check_number, check_type, named_arguments

BASE_SPEED = (1.0, 1.0, 1.5)
"""Speeds x, y, yaw [m/s, m/s, rad/s] that are assumed of an omnidirectional base."""
_ASK = "give wheel_speed=…, track=… and wheel_radius=… (options of drive: --wheel-speed, --track, --wheel-radius)"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class MotionLimits(Summary):
    """Symmetric box limits of a robot's motors.

    Attributes:
        track: distance between the driven wheels [m]; 0 where the base is not a differential drive.
        wheel_radius: radius of the driven wheels [m]; 0 where the base is not a differential drive.
        drive_speed: (k,) limits of the drive coordinates: rims left, right [m/s] (k = 2), or the body's x, y, yaw
            [m/s, m/s, rad/s] (k = 3), or none (k = 0).
        drive_acceleration: (k,) limits of their change [m/s² or rad/s²].
        joint_speed: (n,) limits of the joints' speeds [rad/s or m/s].
        joint_acceleration: (n,) limits of their accelerations [rad/s² or m/s²].

    Examples:
        >>> robot = es.load_robot("silvermate")
        >>> slow = es.MotionLimits.for_robot(robot, wheel_speed=0.3)  # the others as its URDF has them
        >>> trajectory = es.retime(es.Strip(robot, [robot.home(), robot.home(x=1.0)]), slow)
        >>> bool(trajectory.v[:, 0].max() <= 0.3)
        True
    """

    track: NonNegative
    wheel_radius: NonNegative
    drive_speed: Array
    drive_acceleration: Array
    joint_speed: Array
    joint_acceleration: Array

    def __post_init__(self) -> None:
        """Check and freeze.

        Raises:
            ParameterError: a limit that is not positive and finite, or arrays whose lengths do not match.
        """
        for name in ("drive_speed", "drive_acceleration", "joint_speed", "joint_acceleration"):
            try:
                array = np.array(getattr(self, name), dtype=float)
            except (TypeError, ValueError):
                raise ParameterError(f"{name} is not an array of numbers") from None
            if array.ndim != 1:
                raise ParameterError(f"{name} has shape {array.shape}; it must be one row of limits")
            if not (np.isfinite(array).all() and (array > 0.0).all()):
                raise ParameterError(f"{name} = {array.tolist()} must be positive and finite")
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        drive, joints = len(self.drive_speed), len(self.joint_speed)
        if drive not in (0, 2, 3) or len(self.drive_acceleration) != drive:
            raise ParameterError(
                f"{drive} limits of the drive's speed and {len(self.drive_acceleration)} of its acceleration; there are"
                " 2 each for a differential drive, 3 for an omnidirectional base, 0 for a fixed one"
            )
        if len(self.joint_acceleration) != joints:
            raise ParameterError(f"{joints} joint speeds and {len(self.joint_acceleration)} joint accelerations")
        check_fields(self)
        for name, length in (("track", self.track), ("wheel_radius", self.wheel_radius)):
            if drive == 2 and length == 0.0:
                raise ParameterError(f"MotionLimits.{name}={length!r} [m] must be positive for a differential drive")

    @staticmethod
    @named_arguments
    def for_robot(
        robot: RobotModel,
        *,
        wheel_speed: float | None = None,
        wheel_acceleration: float = 1.2,
        track: float | None = None,
        wheel_radius: float | None = None,
        base_speed: Sequence[float] = BASE_SPEED,
        base_acceleration: Sequence[float] = (1.2, 1.2, 3.0),
        joint_speed: float | Mapping[str, float] | None = None,
        joint_acceleration: float | Mapping[str, float] = 4.0,
        prismatic_acceleration: float = 1.0,
    ) -> MotionLimits:
        """The limits of a robot: speeds from its description, accelerations as given (no URDF states any).

        Args:
            robot: the robot.
            wheel_speed: largest speed of a driven wheel's rim [m/s]; from the URDF's wheels where None.
            wheel_acceleration: largest acceleration of a rim [m/s²].
            track: distance between the driven wheels [m]; from the URDF where None.
            wheel_radius: radius of the driven wheels [m]; from the URDF where None.
            base_speed: largest speeds x, y, yaw [m/s, m/s, rad/s] of an omnidirectional base, in its own frame.
            base_acceleration: its largest accelerations [m/s², m/s², rad/s²].
            joint_speed: largest speed of all joints, or joint → value [rad/s or m/s]; joints not named keep the
                model's.
            joint_acceleration: accelerations of all revolute joints [rad/s²], or joint → value; what is not given: 4
                rad/s².
            prismatic_acceleration: accelerations of the prismatic joints that ``joint_acceleration`` does not name
                [m/s²].

        Raises:
            ParameterError: a limit that neither the robot's description nor the caller gives, or that is out of range.
        """
        check_type("robot", robot, RobotModel, RobotError)
        speed, acceleration = _joint_limits(robot, joint_speed, joint_acceleration, prismatic_acceleration)
        unstated = [name for name, value in zip(robot.joint_names, speed, strict=True) if np.isnan(value)]
        wheels: tuple[str, ...] = ()
        if robot.base_kind is BaseKind.DIFF_DRIVE:
            if wheel_speed is None or track is None or wheel_radius is None:
                found = _driven_wheels(robot)
                track = found.track if track is None else track
                wheel_radius = found.radius if wheel_radius is None else wheel_radius
                if wheel_speed is None:
                    wheels = () if 0.0 < found.speed < UNLIMITED_SPEED else found.joints
                    wheel_speed = found.speed * wheel_radius
            drive, change = [wheel_speed] * 2, [wheel_acceleration] * 2
        elif robot.base_kind is BaseKind.OMNI:
            track = wheel_radius = 0.0
            drive, change = list(base_speed), list(base_acceleration)
            if len(drive) != 3 or len(change) != 3:
                raise ParameterError("base_speed and base_acceleration have three entries: x, y, yaw")
        else:
            track = wheel_radius = 0.0
            drive, change = [], []
        if unstated or wheels:
            raise ParameterError(_ask_speeds(robot, unstated, wheels))
        return MotionLimits(
            track=float(track),
            wheel_radius=float(wheel_radius),
            drive_speed=np.array(drive, dtype=float),
            drive_acceleration=np.array(change, dtype=float),
            joint_speed=speed,
            joint_acceleration=acceleration,
        )

    @property
    def drive_dim(self) -> int:
        """Number k of drive coordinates."""
        return len(self.drive_speed)

    @property
    def speed(self) -> Array:
        """(k + n,) limits of all speeds: drive, then joints."""
        return np.concatenate([self.drive_speed, self.joint_speed])

    @property
    def acceleration(self) -> Array:
        """(k + n,) limits of all accelerations: drive, then joints."""
        return np.concatenate([self.drive_acceleration, self.joint_acceleration])

    def to_drive(self, twist: Array) -> Array:
        """Drive coordinates (…, k) of body twists or travels (…, 3): x, y [m or m/s], yaw [rad or rad/s].

        A differential drive has no coordinate for sideways travel: y is left out.
        """
        twist = np.asarray(twist, dtype=float)
        if self.drive_dim == 2:
            half = 0.5 * self.track * twist[..., 2]
            return np.stack([twist[..., 0] - half, twist[..., 0] + half], axis=-1)
        return twist.copy() if self.drive_dim == 3 else np.zeros((*twist.shape[:-1], 0))

    def to_twist(self, drive: Array) -> Array:
        """Body twists or travels (…, 3) of drive coordinates (…, k); (…, 0) for a fixed base."""
        drive = np.asarray(drive, dtype=float)
        if self.drive_dim == 2:
            twist = np.zeros((*drive.shape[:-1], 3))
            twist[..., 0] = 0.5 * (drive[..., 0] + drive[..., 1])
            twist[..., 2] = (drive[..., 1] - drive[..., 0]) / self.track
            return twist
        return drive.copy()

    def to_coordinates(self, v: Array) -> Array:
        """Drive coordinates and joints (…, k + n) of tangent vectors (…, nv)."""
        base = 3 if self.drive_dim else 0
        return np.concatenate([self.to_drive(v[..., :base]), v[..., base:]], axis=-1)

    def to_tangent(self, y: Array) -> Array:
        """Tangent vectors (…, nv) of drive coordinates and joints (…, k + n)."""
        k = self.drive_dim
        return np.concatenate([self.to_twist(y[..., :k]), y[..., k:]], axis=-1)

    def scaled(self, speed: float, acceleration: float) -> MotionLimits:
        """The limits with speeds and accelerations each multiplied by a factor > 0."""
        return replace(
            self,
            drive_speed=self.drive_speed * speed,
            drive_acceleration=self.drive_acceleration * acceleration,
            joint_speed=self.joint_speed * speed,
            joint_acceleration=self.joint_acceleration * acceleration,
        )


def _driven_wheels(robot: RobotModel) -> DrivenWheels:
    try:
        return robot.wheels
    except RobotError as error:
        raise ParameterError(f"{error}: {_ASK}") from None


def _joint_limits(
    robot: RobotModel,
    speed: float | Mapping[str, float] | None,
    acceleration: float | Mapping[str, float],
    prismatic_acceleration: float,
) -> tuple[Array, Array]:
    """(n,) speeds, NaN where there is none, and (n,) accelerations."""
    names, stated = robot.joint_names, robot.model.velocityLimit[robot.space.base_nv :]
    speeds = _named(speed, names, "joint_speed")
    changes = _named(acceleration, names, "joint_acceleration")
    out_speed, out_change = np.empty(len(names)), np.empty(len(names))
    for i, (name, sliding) in enumerate(zip(names, sliding_joints(robot), strict=True)):
        value = speeds.get(name, float(stated[i]))
        out_speed[i] = value if name in speeds or 0.0 < value < UNLIMITED_SPEED else np.nan
        # one number for all joints means the revolute ones: 4 is plenty for an arm and absurd for a lift
        named = isinstance(acceleration, Mapping) and name in acceleration
        out_change[i] = prismatic_acceleration if sliding and not named else changes.get(name, 4.0)
    return out_speed, out_change


def _ask_speeds(robot: RobotModel, joints: Sequence[str], wheels: Sequence[str]) -> str:
    """What to do where joints and wheels state no speed."""
    arguments, options = [], []
    if joints:
        arguments.append("joint_speed={" + ", ".join(f"{name!r}: …" for name in joints) + "} [rad/s or m/s]")
        options += [f"--joint-speed {name}=…" for name in joints]
    if wheels:
        arguments.append("wheel_speed=… [m/s at the rim]")
        options.append("--wheel-speed …")
    named = [f"joint {name!r}" for name in joints] + [f"wheel {name!r}" for name in wheels]
    return (
        f"{robot.name!r} states no speed limit of {', '.join(named)}: write "
        '<limit effort="…" velocity="…"/> [rad/s or m/s] into each of these <joint> elements of its URDF, or give '
        f"{' and '.join(arguments)} (options of drive: {' '.join(options)})"
    )


def sliding_joints(robot: RobotModel) -> Mask:
    """(n,) which planned joints slide, so that their coordinate is a length [m]."""
    return robot.tree.sliding


def _named(values: float | Mapping[str, float] | None, names: Sequence[str], what: str) -> dict[str, float]:
    if values is None:
        return {}
    if not isinstance(values, Mapping):
        return dict.fromkeys(names, check_number(what, values, above=0.0))
    for name in values:
        if name not in names:
            raise ParameterError(f"{what}: there is no planned joint {name!r}{nearest_name(name, names)}")
    return {name: check_number(f"{what}[{name!r}]", value, above=0.0) for name, value in values.items()}
