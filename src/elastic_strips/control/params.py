"""Parameters: rates, margins, and what is assumed of obstacles; validated where they are made."""

from __future__ import annotations

from dataclasses import dataclass, field

from elastic_strips.errors import ParameterError
from elastic_strips.strip import DeformParams, OrientationConstraint
from elastic_strips.validation import check_number, check_numbers, check_type

DRIVE_STRIP = DeformParams(max_nodes=200, max_spacing=0.3, min_spacing=0.1, certificate_depth=5)
"""Parameters of strips that are driven: nodes may be further apart and the certificate coarser, for motions have a
certificate of their own."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ObstacleAssumptions:
    """What the safety of the motion rests on: how wrong the sensed scene and its prediction can be.

    An obstacle that is sensed at a pose with a velocity is within ``position_error + velocity_error·t +
    ½·acceleration·t²`` of where constant velocity takes it, t after the snapshot. One whose motion is unknown
    (:class:`~elastic_strips.scene.UnknownMotion`) is within its speed bound times t of where it is.

    Attributes:
        position_error: error of a sensed pose [m].
        velocity_error: error of a sensed velocity [m/s].
        acceleration: largest acceleration of an obstacle whose velocity is sensed [m/s²].
        max_speed: largest speed of an obstacle [m/s]: no prediction is wrong by more than twice that times t.
    """

    position_error: float = 0.005
    velocity_error: float = 0.02
    acceleration: float = 0.5
    max_speed: float = 2.0

    def __post_init__(self) -> None:
        check_numbers(self, zero=("position_error", "velocity_error", "acceleration"))


@dataclass(frozen=True, slots=True, kw_only=True)
class EvasionParams:
    """How manoeuvres among moving obstacles are compared; none of this is needed for safety, which is certified.

    Attributes:
        horizon: how far ahead manoeuvres are rolled out [s]; step: at which steps they are looked at [s].
        acceleration: part of the drive's acceleration limits that they use.
        radius, radius_growth: a robot counts as near to what moves below radius + radius_growth·t, t ahead [m, m/s].
        lookahead: what moves counts as where it will be within this time, too [s].
        proximity_weight: cost of being next to something, per second.
        discount_time: time [s] within which a prediction loses weight.
        risk_threshold: risk [s] up to which the strip, or waiting, is good enough.
        min_gain: what another path has to gain [s] before a robot that waits unthreatened sets off.
        shortlist: so many of the best are compared with what stands; tries: so many are certified at most.
    """

    horizon: float = 3.0
    step: float = 0.15
    acceleration: float = 0.9
    radius: float = 0.25
    radius_growth: float = 0.2
    lookahead: float = 0.8
    proximity_weight: float = 4.0
    discount_time: float = 2.0
    risk_threshold: float = 0.2
    min_gain: float = 0.6
    shortlist: int = 60
    tries: int = 4

    def __post_init__(self) -> None:
        check_numbers(self, zero=("radius_growth", "lookahead", "risk_threshold", "min_gain"))
        if not self.acceleration <= 1.0:
            raise ParameterError(f"EvasionParams.acceleration={self.acceleration!r} must be at most 1")
        if not self.step <= 0.5 * self.horizon:
            raise ParameterError(f"EvasionParams.step={self.step!r} must be at most half the horizon")


@dataclass(frozen=True, slots=True, kw_only=True)
class Tolerance:
    """How near a goal counts as reached: the base [m], its heading [rad], each joint [rad or m]; inf: any."""

    position: float = 0.05
    yaw: float = 0.05
    joints: float = 0.05

    def __post_init__(self) -> None:
        for name in ("position", "yaw", "joints"):
            value = getattr(self, name)
            if not value >= 0.0:
                raise ParameterError(f"{name} = {value!r} must be at least 0 (inf: any)")


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveParams:
    """How a strip is driven; times [s], lengths [m], angles [rad].

    Attributes:
        deform: parameters of the strip; its clearance is raised to what execution needs.
        assumptions: of the obstacles.
        evasion: how the robot gets out of the way of what moves; None: it only brakes and waits.
        constraint: what the strip has to satisfy besides its goal.
        control_dt: period of the control loop.
        plan_every: control periods from one planning tick to the next.
        latency: control periods from sensing to the first command of the motion that was planned on it.
        sample_dt: step of planned motions; between samples base and joints go on exact arcs and lines.
        tracking_error: how far any point of the robot may be from where the planned motion has it. In the closed loop,
            with motors that have no reserves: at most 0.012 m in 40 runs among moving obstacles.
        margin: clearance that is kept beyond the tracking error.
        settle_time: how long the robot may creep on after a planned motion has ended.
        recover_iterations: further iterations of a tick in which the strip has lost its certificate.
        motion_every: planning ticks from one new motion to the next, while the one that is executed is certified again
            at every tick, or the robot waits, and nothing new appears.
        maintain_every: planning ticks from one insertion and removal of nodes to the next.
        horizon: longest time ahead that the strip gives way to predicted motion.
        max_scene_age: a scene that is older is not driven on.
        replan_after: a strip that stays broken so long, at rest, is planned anew.
        replan_time: simulated duration of planning anew.
        speeds: fractions of full speed that are tried one after the other until one is certified.
        speed_scale, acceleration_scale: parts of the motors' limits that motions are planned with; the rest is used
            where the path changes and they would not do.
        goal_position, goal_angle: tolerance at the goal, of the base [m], and of heading and joints [rad or m].
        time_limit: longest run.
    """

    deform: DeformParams = DRIVE_STRIP
    assumptions: ObstacleAssumptions = field(default_factory=ObstacleAssumptions)
    evasion: EvasionParams | None = None
    constraint: OrientationConstraint | None = None
    control_dt: float = 0.01
    plan_every: int = 5
    latency: int = 2
    sample_dt: float = 0.02
    tracking_error: float = 0.02
    margin: float = 0.005
    settle_time: float = 0.15
    recover_iterations: int = 4
    motion_every: int = 2
    maintain_every: int = 3
    horizon: float = 3.0
    max_scene_age: float = 0.25
    replan_after: float = 0.8
    replan_time: float = 0.3
    speeds: tuple[float, ...] = (1.0, 0.5, 0.25)
    speed_scale: float = 0.95
    acceleration_scale: float = 0.75
    goal_position: float = 0.05
    goal_angle: float = 0.05
    time_limit: float = 120.0

    def __post_init__(self) -> None:
        check_numbers(self, zero=("latency", "settle_time", "recover_iterations"))
        for what, kind, none in (
            ("deform", DeformParams, False), ("assumptions", ObstacleAssumptions, False),
            ("evasion", EvasionParams, True), ("constraint", OrientationConstraint, True), ("speeds", tuple, False),
        ):  # fmt: skip
            check_type(f"DriveParams.{what}", getattr(self, what), kind, none=none)
        if not self.speeds:
            raise ParameterError("DriveParams.speeds=() must be fractions in (0, 1]; there is none")
        for speed in self.speeds:
            check_number("each of DriveParams.speeds, which must be fractions,", speed, above=0.0, high=1.0)

    @property
    def clearance(self) -> float:
        """Distance [m] that planned motions prove to obstacles: tracking error and margin."""
        return self.tracking_error + self.margin

    @property
    def strip(self) -> DeformParams:
        """Parameters of the strip, with the clearance that planned motions need."""
        return self.deform.replaced(clearance=max(self.deform.clearance, self.clearance))

    @property
    def tolerance(self) -> Tolerance:
        """How near counts as reached."""
        return Tolerance(position=self.goal_position, yaw=self.goal_angle, joints=self.goal_angle)
