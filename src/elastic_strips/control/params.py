"""Parameters: rates, margins, and assumptions about obstacles; validated where they are made."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import inf
from typing import Annotated

from elastic_strips.errors import ParameterError
from elastic_strips.strip import AxisConstraint, DeformParams
from elastic_strips.validation import (
    Bound,
    Checked,
    Count,
    Fraction,
    NonNegative,
    Positive,
    Whole,
    check_fields,
    named_arguments,
)

from .estimation import EstimatorParams
from .tracking import TrackingGains

DRIVE_STRIP = DeformParams(max_nodes=200, max_spacing=0.3, min_spacing=0.1, certificate_depth=5)
"""Parameters of strips that are driven: nodes may be further apart and the certificate coarser, because motions have a
certificate of their own."""
_OrAny = Annotated[float, Bound(low=0.0, infinite=True)]
_Speed = Annotated[float, Bound(above=0.0, infinite=True)]
_Part = Annotated[float, Bound(above=0.0, high=1.0)]


@dataclass(frozen=True, slots=True, kw_only=True)
class ObstacleAssumptions(Checked):
    """The assumptions on which the motion's safety rests: how wrong the sensed scene and its prediction can be.

    An obstacle that is sensed at a pose with a velocity is within ``position_error + velocity_error·t +
    ½·acceleration·t²`` of where constant velocity takes it, t after the snapshot. One whose motion is unknown
    (:class:`~elastic_strips.scene.UnknownMotion`) is within its speed bound times t of where it is.

    Attributes:
        position_error: error of a sensed pose [m].
        velocity_error: error of a sensed velocity [m/s].
        acceleration: largest acceleration of an obstacle whose velocity is sensed [m/s²].
        max_speed: largest speed of an obstacle [m/s]: no prediction is wrong by more than twice that times t.
    """

    position_error: NonNegative = 0.005
    velocity_error: NonNegative = 0.02
    acceleration: NonNegative = 0.5
    max_speed: Positive = 2.0


LASER_ASSUMPTIONS = ObstacleAssumptions(position_error=0.04, velocity_error=0.2)
"""Bounds of the errors of tracks from a laser at 20 Hz; tests compare them with the true errors."""
LASER_EASE = 0.6
"""Part of the largest speeds for a robot with only a laser: an obstacle that appears from behind another one is
tracked as moving only some tenths of a second later, and the robot has to be at rest when it arrives."""
CAMERA_EASE = 0.8
"""That part for a robot with a depth camera, too, which sees most things earlier, over what stands before them. Not for
a 3-D lidar alone, which turns ten times a second."""

_SIDE_TURN_SPEED = 1.0  # [rad/s]


def seen_turn_speed(*, behind: bool, arm: bool) -> float:
    """How fast [rad/s] a base may turn for what its sensors see; inf: as fast as its motors allow.

    Who stands beside a robot that sees only ahead comes into view as it turns towards them. They have to be told from
    what stands, and the robot has to be at rest, before a hand is there that it stretches out ahead. What is no wider
    than its base sweeps hardly anything as it turns.

    Args:
        behind: whether sensors look behind the robot.
        arm: whether it has joints that reach out.
    """
    return inf if behind or not arm else _SIDE_TURN_SPEED


@dataclass(frozen=True, slots=True)
class Margins:
    """What motions keep from obstacles at present.

    Attributes:
        tracking_error: largest distance [m] of any point of the robot from its place by the planned motion.
        margin: clearance [m] that is kept beyond it.
    """

    tracking_error: float
    margin: float

    @property
    def clearance(self) -> float:
        """Distance [m] that motions prove to obstacles."""
        return self.tracking_error + self.margin


@named_arguments
@dataclass(frozen=True, slots=True, kw_only=True)
class EvasionParams:
    """How manoeuvres among moving obstacles are compared; none of this is needed for safety, which is certified.

    Attributes:
        horizon: how far ahead manoeuvres are rolled out [s].
        step: time [s] between the poses that are evaluated.
        acceleration: part of the drive's acceleration limits that they use.
        radius, radius_growth: a robot counts as near to a moving obstacle below radius + radius_growth·t, t ahead [m,
            m/s].
        lookahead: a moving obstacle counts at all places where it will be within this time, too [s].
        proximity_weight: cost of being next to something, per second.
        discount_time: time [s] within which a prediction loses weight.
        risk_threshold: risk [s] up to which the strip, or waiting, is good enough.
        min_gain: time that another path has to gain [s] before a robot that waits unthreatened sets off.
        shortlist: number of the best that are compared with static obstacles.
        tries: largest number that is certified.
    """

    horizon: Positive = 3.0
    step: Positive = 0.15
    acceleration: _Part = 0.9
    radius: Positive = 0.25
    radius_growth: NonNegative = 0.2
    lookahead: NonNegative = 0.8
    proximity_weight: Positive = 4.0
    discount_time: Positive = 2.0
    risk_threshold: NonNegative = 0.2
    min_gain: NonNegative = 0.6
    shortlist: Count = 60
    tries: Count = 4

    def __post_init__(self) -> None:
        check_fields(self)
        if not self.step <= 0.5 * self.horizon:
            raise ParameterError(f"EvasionParams.step={self.step!r} must be at most half the horizon")


@dataclass(frozen=True, slots=True, kw_only=True)
class MonitorParams(Checked):
    """When an assumption counts as broken.

    Attributes:
        control_share: part of ``DriveParams.tracking_error`` that control takes up by itself. Where localization is so
            coarse that the rest is not enough, motions are planned for a larger tracking error.
        largest: largest tracking error [m] that motions are planned for.
        brake_at: part of the tracking error that the distance from the reference and the error of the estimate may take
            up together; then the robot brakes.
        prove_at: part of that from which on the active motion is certified again, with a larger error, so that the
            robot need not brake.
        sigmas: standard deviations of the estimate that count as its largest error.
        clock_skew: largest time [s] by which a time stamp may be later than now.
        silence: longest time [s] without a usable measurement of wheels or joints.
        longest_arc: longest time [s] from one measurement to the next whose travel counts as one arc.
        same_place: how far [m, rad] odometry that was silent for longer, or went faster than the motors can by its
            stamps, may be from where the motors were told to go, to be believed all the same; 0: only a fix says where
            the robot is then.
        longest_period: longest control period, by the median of the last ones; in a slower loop the robot stands. At
            12 Hz robots were up to 12 mm off their reference, at 7 Hz up to 61 mm.
        motor_error: speed [m/s, rad/s] by which a drive coordinate may differ from the model of its motor.
        motor_time: longest time [s] for which a drive coordinate may differ by more; then power is cut.
        standing_travel: how far [m, rad] a drive coordinate may go on within ``standing_time`` [s] once it was told to
            stand, and ought to; then power is cut.
        motor_wait: time [s] at rest for which the power stays off.
        wheel_lag: time constant [s] of the motors' model.
        recoveries: how often a robot may be found further off its reference than was proven, and go on from there,
            within ``recovery_span``; then it stands for ``recovery_pause``, or until
            :meth:`~elastic_strips.control.Controller.resume`.
        recovery_span: time [s] within which it counts.
        recovery_pause: time [s] for which odometry and fixes have to agree while the robot stands.
        vanished: a scene that lacks this part of the obstacles of the one before is not believed at once.
        scene_doubt: time [s] after which such a scene is believed, at rest.
        motion_trust: time [s] for which the motion of an obstacle counts as unknown after its poses last contradicted
            it.
        heartbeat: longest time [s] in which executor and planning, each in its process, hear nothing of each other.
        planner_hangs: longest time [s] from the end of one planning tick to that of the next, before a robot that moves
            says that planning hangs; it goes on to the end of its motion.
    """

    control_share: Fraction = 0.5
    largest: Positive = 0.1
    brake_at: Fraction = 1.0
    prove_at: _Part = 0.75
    sigmas: Positive = 3.0
    clock_skew: NonNegative = 0.02
    silence: Positive = 0.05
    longest_arc: Positive = 0.3
    same_place: NonNegative = 0.0
    longest_period: Positive = 0.075
    motor_error: Positive = 0.15
    motor_time: Positive = 0.1
    standing_travel: Positive = 0.005
    standing_time: Positive = 0.3
    motor_wait: NonNegative = 1.0
    wheel_lag: NonNegative = 0.04
    recoveries: Count = 5
    recovery_span: Positive = 20.0
    recovery_pause: NonNegative = 10.0
    vanished: Fraction = 0.8
    scene_doubt: NonNegative = 1.0
    motion_trust: Positive = 2.0
    heartbeat: Positive = 0.25
    planner_hangs: Positive = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Tolerance(Checked):
    """How near a goal counts as reached: the base [m], its heading [rad], each joint [rad or m]; inf: any."""

    position: _OrAny = 0.05
    yaw: _OrAny = 0.05
    joints: _OrAny = 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveParams(Checked):
    """How a strip is driven; times [s], lengths [m], angles [rad].

    Attributes:
        deform: parameters of the strip; its clearance is raised to what execution needs.
        assumptions: what is assumed about the obstacles.
        monitor: when the assumptions about robot and inputs count as broken.
        evasion: how the robot evades moving obstacles; None: it only brakes and waits.
        constraint: what the strip has to satisfy besides its goal: strips are planned so that they do, and are drawn to
            it while they give way. A constraint that cannot be satisfied does not stop the robot.
        gains: gains of tracking, and the lags of the motors that it leads; `calibrate` measures them.
        sensing: what the estimator assumes about wheels and fixes.
        backward: whether plans and manoeuvres may lead backwards; not for robots that see only ahead of them.
        turn_speed: how fast the base turns at most [rad/s], besides what the motors allow. Who stands beside a robot
            that sees only ahead has to be seen before its hand is there: 1 rad/s, where it has an arm.
        control_dt: period of the control loop.
        plan_every: control periods from one planning tick to the next; half as many where a tick has the strip's step
            alone, because that and the motion take more than half the nominal latency together.
        latency: control periods from sensing to the first command of the motion that was planned on it.
        sample_dt: step of planned motions; between samples base and joints go on exact arcs and lines.
        tracking_error: largest distance of any point of the robot from its place by the planned motion. Measured on
            planned corridors (880 runs, 3.5 hours; Silvermate, TIAGo) with the default plant, gains and estimator: 99 %
            within 0.0091 m, the largest 0.0179 m, nearly all of it by the slip of the wheels. Twice the slip 0.025 m,
            motors with 1.5 or 0.5 times the assumed lag 0.025 m, fixes twice as noisy 0.021 m; MuJoCo 0.028 m.
        margin: clearance that is kept beyond the tracking error.
        settle_time: how long the robot may creep on after a planned motion has ended.
        recover_iterations: further iterations of a tick in which the strip has lost its certificate.
        motion_every: planning ticks from one new motion to the next, while the one that is executed is certified again
            at every tick, or the robot waits, and nothing new appears.
        maintain_every: planning ticks from one insertion and removal of nodes to the next.
        horizon: longest time ahead that the strip gives way to predicted motion.
        max_scene_age: a scene that is older is not driven on.
        replan_after: time after which a strip that stays broken, at rest, is replanned.
        replan_time: least time from the decision to replan until that begins.
        speeds: fractions of full speed that are tried one after the other until one is certified.
        speed_scale, acceleration_scale: parts of the motors' limits that motions are planned with; the rest is used
            where the path changes and these parts are not enough.
        goal_position, goal_angle: tolerance at the goal, of the base [m], and of heading and joints [rad or m].
        stop_at_goals: whether the robot comes to rest at each of several goals; else it goes on from one to the next
            without a stop, within the tolerance, where the way leads on.
        time_limit: longest run.

    Examples:
        >>> careful = es.DriveParams(margin=0.05, time_limit=60.0)
        >>> robot = es.load_robot("silvermate")
        >>> controller = es.Controller(robot, robot.home(), robot.home(x=3.0), params=careful)
        >>> controller.close()
    """

    deform: DeformParams = DRIVE_STRIP
    assumptions: ObstacleAssumptions = field(default_factory=ObstacleAssumptions)
    monitor: MonitorParams = field(default_factory=MonitorParams)
    evasion: EvasionParams | None = field(default_factory=EvasionParams)
    constraint: AxisConstraint | None = None
    gains: TrackingGains = field(default_factory=lambda: TrackingGains(headroom=1.0))
    sensing: EstimatorParams = field(default_factory=EstimatorParams)
    backward: bool = True
    turn_speed: _Speed = inf
    control_dt: Positive = 0.01
    plan_every: Count = 5
    latency: Whole = 2
    sample_dt: Positive = 0.02
    tracking_error: Positive = 0.02
    margin: Positive = 0.005
    settle_time: NonNegative = 0.15
    recover_iterations: Whole = 2
    motion_every: Count = 2
    maintain_every: Count = 3
    horizon: Positive = 3.0
    max_scene_age: Positive = 0.25
    replan_after: Positive = 0.8
    replan_time: NonNegative = 0.3
    speeds: tuple[_Part, ...] = (1.0, 0.5, 0.25)
    speed_scale: _Part = 0.95
    acceleration_scale: _Part = 0.75
    goal_position: Positive = 0.05
    goal_angle: Positive = 0.05
    stop_at_goals: bool = False
    time_limit: Positive = 120.0

    @staticmethod
    def standing(**changes: object) -> DriveParams:
        """Parameters for reaching in while the base stands: 8 mm from everything, slow, and precise at the end.

        No wheel slips then, and only the joints' part of the tracking error is left. The goal has to be known to
        a millimetre, as by a camera at the hand.

        Args:
            changes: parameters with other values.
        """
        near = DriveParams(
            deform=DRIVE_STRIP.replaced(influence=0.1, near=0.03),
            evasion=None,
            tracking_error=0.007,
            margin=0.001,
            goal_position=0.01,
            goal_angle=0.01,
            speed_scale=0.3,
        )
        return replace(near, **changes)  # type: ignore[arg-type]

    @property
    def margins(self) -> Margins:
        """What planned motions keep from obstacles while the robot is known as well as assumed."""
        return Margins(self.tracking_error, self.margin)

    @property
    def clearance(self) -> float:
        """Distance [m] that planned motions prove to obstacles: tracking error and margin."""
        return self.margins.clearance

    @property
    def strip(self) -> DeformParams:
        """Parameters of the strip, with the clearance that planned motions need."""
        return self.deform.replaced(clearance=max(self.deform.clearance, self.clearance))

    @property
    def tolerance(self) -> Tolerance:
        """How near counts as reached."""
        return Tolerance(position=self.goal_position, yaw=self.goal_angle, joints=self.goal_angle)
