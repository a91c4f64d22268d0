"""ROS robot: a simulated robot as a ROS 2 node in a process of its own, which judges how it was driven.

It knows nothing of who drives it: velocities in, odometry with slip, joint states and scans out, over DDS. Its motors
stop by themselves where commands stay out. At its end it tells whether it touched anything, from its true states.
"""

from __future__ import annotations

import heapq
import itertools
import math
import signal
import time
from array import array
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from types import FrameType
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from elastic_strips.arrays import Array
from elastic_strips.control.driver import COMMAND_TIMEOUT
from elastic_strips.control.estimation import compose, exp
from elastic_strips.control.interfaces import Command, Measurement
from elastic_strips.errors import ParameterError, nearest_name
from elastic_strips.perception.own_body import Posture, SensorMount
from elastic_strips.perception.readings import DepthImage, LaserScan
from elastic_strips.robot import RobotModel, load_robot
from elastic_strips.ros2.driver import close_node, load, open_node, quality
from elastic_strips.ros2.messages import MessageError, fill_pose, fill_stamp, nanoseconds, twist_of
from elastic_strips.scene import Box, Cylinder, Scene, World
from elastic_strips.sim.closed_loop import MACHINE
from elastic_strips.sim.evaluation import evaluate
from elastic_strips.sim.plant import KinematicPlant, Plant
from elastic_strips.sim.sensors import DepthParams, SensorConfig, SensorSuite, named_sensors
from elastic_strips.trajectory import MotionLimits

from .measure import Figures

_PERIOD = 0.005  # [s] of the simulated motors
_CAMERA = "camera_optical"  # frame of the depth camera
_WAY_STEP = 0.1  # [s] from one place that is told to the next
_NOT_RUN = 0.15  # [s] from which on it is told that its computer has not run it
_REST_SPEED = 0.01  # [m/s, rad/s]
_FAST_SPEED = 0.3  # [m/s]
_FULL_HEIGHT = 1.5  # [m] of what stands in the corridor: a laser says nothing of heights
_SENT_WRONG = ("lost", "late", "shuffled", "twice")
_TOPICS = ("odom", "joints", "scan", "cloud", "depth", "fix")
FAULTS = (*(f"{topic}_{how}" for topic in _TOPICS for how in _SENT_WRONG), "odom_nan", "joints_nan", "scan_nan",
          "odom_frame", "scan_frame", "scan_old", "clock", "emergency", "emergency_missing", "map_jump")  # fmt: skip
"""What may go wrong with what it says: topics whose messages stop, come late, in pairs of the wrong order, or twice;
NaN and unknown frames; scans that are said to be two seconds old; all stamps off by 5 s; the emergency stop, and one
that says nothing from the start; localization that is off by 0.5 m."""
_LATE = 0.6  # [s] by which messages of a topic are late
_JUMP = np.array([0.3, 0.4, 0.0])  # [m, rad] by which localization jumps
_LAYERS = (0.2, 0.5, 0.8, 1.1, 1.4)  # [m] heights of a cloud's points


class TimedFault(NamedTuple):
    """One of `FAULTS`, from when on, and for how long [s]; the time begins when the robot first moves fast."""

    kind: str
    at: float
    lasts: float

    @staticmethod
    def of(text: str) -> TimedFault:
        """What ``KIND:AT[:FOR]`` says.

        Raises:
            ParameterError: it says nothing of the kind.
        """
        kind, *numbers = text.split(":")
        if kind not in FAULTS:
            raise ParameterError(f"fault {kind!r} is not known{nearest_name(kind, FAULTS)}")
        try:
            at, lasts = (*(float(number) for number in numbers), math.inf)[:2]
        except ValueError:
            raise ParameterError(f"fault {text!r} is not KIND:AT[:FOR], in seconds") from None
        return TimedFault(kind, at, lasts)


@dataclass(frozen=True, slots=True, kw_only=True)
class RosRobotParams:
    """What the robot is like.

    Attributes:
        robot: its name.
        seed: seed of the corridor, of slip and of noise.
        odometry, joints: rates [Hz].
        reliable: whether its sensors are reliable; else best effort.
        stamped: whether it wants TwistStamped.
        arm: ``"trajectory"`` or ``"velocity"``.
        timeout: how long a velocity holds [s].
        delay: by how much all that it says is late [s].
        loss: part of its messages that is lost.
        seconds: how long it runs, at most.
        faults: what goes wrong.
        length: of the corridor [m].
        depth: whether it has a depth camera on its head, besides the laser.
        magnified: each pixel of its images comes as so many by so many: 4 makes 640 × 480.
        cloud: whether what the laser sees comes as a cloud, too, up to a height.
        fix: rate of its localization [Hz]; 0: none.
        plant: ``"kinematic"`` or ``"mujoco"``.
    """

    robot: str = "silvermate"
    seed: int = 0
    odometry: float = 50.0
    joints: float = 50.0
    reliable: bool = False
    stamped: bool = True
    arm: str = "trajectory"
    timeout: float = COMMAND_TIMEOUT
    delay: float = 0.0
    loss: float = 0.0
    seconds: float = 60.0
    faults: tuple[TimedFault, ...] = ()
    length: float = 6.0
    depth: bool = False
    magnified: int = 1
    cloud: bool = False
    fix: float = 0.0
    plant: str = "kinematic"


def pillar_corridor(seed: int, length: float = 6.0) -> tuple[World, float]:
    """A straight corridor between two walls, with pillars to both sides; and where it ends [m], the robot begins at 0.

    All stands from the floor up to above the laser, which says nothing about heights.
    """
    rng = np.random.default_rng(seed)
    half, end = 1.3, length
    walls = [
        Box((length + 4.0, 0.1, _FULL_HEIGHT), at=(0.5 * length, side * (half + 0.05), 0.5 * _FULL_HEIGHT), name=name)
        for side, name in ((1.0, "wall-left"), (-1.0, "wall-right"))
    ]
    pillars = []
    side = 1.0 if rng.random() < 0.5 else -1.0
    for k, x in enumerate(np.arange(1.8, length - 1.0, 1.7)):
        at = (float(x + rng.uniform(-0.2, 0.2)), side * float(rng.uniform(0.55, 0.9)), 0.5 * _FULL_HEIGHT)
        radius = float(rng.uniform(0.08, 0.2))
        pillars.append(Cylinder(radius, _FULL_HEIGHT, at=at, name=f"pillar-{k}"))
        side = -side
    return World(Scene([*walls, *pillars])), end


@dataclass(slots=True)
class _Heard:
    """The commands that have come.

    Attributes:
        twist: the newest velocity (3,), and
        until: how long it holds, on the monotonic clock [s].
        times: when they came.
        arm: pieces of the arm's trajectory: end [s, monotonic], rates (n,).
    """

    twist: Array = field(default_factory=lambda: np.zeros(3))
    until: float = -math.inf
    times: list[float] = field(default_factory=list)
    speeds: list[float] = field(default_factory=list)
    arm: list[tuple[float, Array]] = field(default_factory=list)


class RosRobot:
    """Workspace: the robot; `run` lets it live.

    Args:
        params: what it is like.
        arguments: arguments of ROS.

    Raises:
        MissingExtraError: rclpy is not installed.
    """

    def __init__(self, params: RosRobotParams, arguments: list[str]) -> None:
        self.params: RosRobotParams = params
        self.robot: RobotModel = load_robot(params.robot)
        self.limits: MotionLimits = MotionLimits.for_robot(self.robot)
        self.world, self.end = pillar_corridor(params.seed, params.length)
        self._plant: Plant = KinematicPlant(self.robot, self.limits, MACHINE, seed=params.seed)
        if params.plant == "mujoco":
            from elastic_strips.sim.mujoco.plant import MujocoPlant

            step = 0.5 * _PERIOD  # [s]
            self._plant = MujocoPlant(self.robot, self.limits, self.world, MACHINE, seed=params.seed, timestep=step)
        self._plant.reset(self.robot.space.to_coordinates(self.robot.home()))
        config: SensorConfig = named_sensors("laser,head-camera" if params.depth else "laser", params.robot)
        config = replace(config, sensors=tuple(replace(s, latency=0.0) for s in config.sensors))
        self._sensors = SensorSuite(self.robot, self.world, config, seed=params.seed)
        self._frame = config.sensors[0].frame  # type: ignore[union-attr]
        posture = Posture(self.robot)
        posture.place(self._plant.coordinates)
        self._imagers = [  # their poses (4, 4) on the base
            SensorMount(posture, (s.frame,), s.T_frame_camera).poses()[1][0]
            for s in config.sensors
            if isinstance(s, DepthParams)
        ]
        self._odometry = (0.0, 0.0, 0.0)
        self._odometry_error = np.zeros(3)  # variances
        self._rng = np.random.default_rng(params.seed + 1)
        self._heard = _Heard()
        self._late: list[tuple[float, int, Any, Any]] = []  # a heap: when [s], and in which order
        self._told = itertools.count()
        self._held: dict[str, Any] = {}  # of a topic, the message that comes after the next one
        self._rows: list[tuple[float, Array, Array]] = []
        self._ending = False
        self._began = math.nan  # on the monotonic clock [s]
        self._fast_at: float | None = None
        self._stood_at: float | None = None  # for the first time after that, and after what goes wrong has begun
        self._not_run: list[tuple[float, float]] = []  # from when until when [s]
        self.context, self.node = open_node("robot", arguments)
        self._kinds = {name: load(f"{name}_msgs.msg") for name in ("nav", "sensor", "geometry", "std", "trajectory")}
        kinds, sensed = self._kinds, quality(5, reliable=params.reliable)
        self._twist = kinds["geometry"].TwistStamped if params.stamped else kinds["geometry"].Twist
        self._odom_out = self.node.create_publisher(kinds["nav"].Odometry, "odom", sensed)
        self._joints_out = self.node.create_publisher(kinds["sensor"].JointState, "joint_states", sensed)
        self._scan_out = self.node.create_publisher(kinds["sensor"].LaserScan, "scan", sensed)
        self._depth_out = self.node.create_publisher(kinds["sensor"].Image, "depth/image", quality(2))
        self._info_out = self.node.create_publisher(kinds["sensor"].CameraInfo, "depth/camera_info", quality(2))
        self._cloud_out = self.node.create_publisher(kinds["sensor"].PointCloud2, "points", quality(2))
        fix = kinds["geometry"].PoseWithCovarianceStamped
        self._fix_out = self.node.create_publisher(fix, "pose", quality(1, reliable=True))
        kept = quality(1, reliable=True, kept=True)
        self._emergency_out = self.node.create_publisher(kinds["std"].Bool, "emergency", kept)
        self._pressed: bool | None = None
        once = quality(1, reliable=True)
        hear = self.node.create_subscription
        self._cmd = hear(self._twist, "cmd_vel", lambda _: None, once)
        if params.arm == "trajectory":
            kind, topic = kinds["trajectory"].JointTrajectory, "arm_controller/joint_trajectory"
        else:
            kind, topic = kinds["std"].Float64MultiArray, "arm_velocity_controller/commands"
        self._arm = hear(kind, topic, lambda _: None, once)

    def run(self, note: Callable[[str], object]) -> Figures:
        """Live until SIGINT, SIGTERM or the end of its time; what it has seen of its drive.

        Args:
            note: is told when it is ready, when it first moves fast, and when it first stands after that.
        """

        def end(number: int, frame: FrameType | None) -> None:
            self._ending = True

        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, end)
        began = self._began = time.monotonic()
        try:
            note(f"ready at the beginning of {self.end:g} m{self._mount()}")
            self._live(began, note)
        finally:
            close_node(self.context, self.node)
        return self._judged()

    def _live(self, began: float, note: Callable[[str], object]) -> None:
        steps, params, epoch = 0, self.params, self._epoch(began)
        next_odometry = next_joints = next_fix = 0.0
        travel = Measurement(0.0, None, self._plant.coordinates)
        stop_at, last = math.inf, 0.0
        while True:
            now = time.monotonic() - began
            if now > last + _NOT_RUN:
                self._not_run.append((last, now))
            last = now
            if now > params.seconds or self._ending:
                stop_at = min(stop_at, now + 1.0)  # its motors stop by themselves
            if now > stop_at:
                return
            due = int(now / _PERIOD)
            if due <= steps:
                time.sleep(max(0.0, (steps + 1) * _PERIOD - now))
                continue
            while steps < due:
                steps += 1
                travel = self._step(began + steps * _PERIOD)
                self._rows.append((steps * _PERIOD, self._plant.coordinates.copy(), self._plant.v.copy()))
            self._listen()  # what comes now says nothing about the steps before
            t = steps * _PERIOD
            if self._fast_at is None and abs(self._plant.v[0]) > _FAST_SPEED:
                self._fast_at = t
                note("it moves fast")
            stands = float(np.abs(self._plant.v).max()) < _REST_SPEED
            wrong_at = (
                math.inf if self._fast_at is None else self._fast_at + (params.faults[0].at if params.faults else 0)
            )
            if t >= wrong_at and self._stood_at is None and stands:
                self._stood_at = t
                note("it stands again")
            stamp = epoch + round(1e9 * t)  # of its own time: it may not have been run since
            if self._wrong("clock", t):
                stamp -= 5_000_000_000
            self._tell_emergency(t)
            if t >= next_odometry:
                next_odometry = max(next_odometry + 1.0 / params.odometry, t - 1.0)
                self._tell_odometry(stamp, t)
            if t >= next_joints:
                next_joints = max(next_joints + 1.0 / params.joints, t - 1.0)
                self._tell_joints(stamp, t, travel.joints)
            if params.fix and t >= next_fix:
                next_fix = max(next_fix + 1.0 / params.fix, t - 1.0)
                self._tell_fix(stamp, t)
            for reading in self._sensors.observe(t, self._plant.coordinates):
                if isinstance(reading, LaserScan):
                    self._tell_scan(stamp, t, reading)
                    if params.cloud:
                        self._tell_cloud(stamp, t, reading)
                elif isinstance(reading, DepthImage):
                    self._tell_depth(stamp, t, reading)
            while self._late and self._late[0][0] <= now:
                _, _, publisher, message = heapq.heappop(self._late)
                publisher.publish(message)

    def _epoch(self, began: float) -> int:
        """The time [ns] of ROS at a time on the monotonic clock [s], by the two readings that are nearest to each
        other."""
        readings = []
        for _ in range(10):
            before, stamp = time.monotonic(), self.node.get_clock().now().nanoseconds
            readings.append((time.monotonic() - before, stamp - round(1e9 * (before - began))))
        return min(readings)[1]

    def _step(self, now: float) -> Measurement:
        heard, n = self._heard, len(self.robot.joint_names)
        twist = heard.twist if now <= heard.until and not self._pressed else np.zeros(3)
        rates = np.zeros(n)
        if not self._pressed:
            rates = next((piece for end, piece in heard.arm if now <= end), rates)
        measured = self._plant.step(Command(self.limits.to_drive(twist), rates), _PERIOD)
        if measured.drive is not None:
            x, y, yaw = self.limits.to_twist(measured.drive).tolist()
            self._odometry = compose(self._odometry, exp((x, y, yaw)))
            way = abs(x) + abs(yaw)
            self._odometry_error += (0.02 * way) ** 2 + 1e-9
        return measured

    def _listen(self) -> None:
        now = time.monotonic()
        for subscription, take in ((self._cmd, self._on_velocity), (self._arm, self._on_arm)):
            for _ in range(20):
                with subscription.handle:
                    taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
                if taken is None:
                    break
                try:
                    take(taken[0], now)
                except MessageError as error:
                    self.node.get_logger().warning(str(error))

    def _on_velocity(self, message: Any, now: float) -> None:
        twist = twist_of(message.twist if self.params.stamped else message)
        age = 0.0
        if self.params.stamped:  # the timeout counts from when it was sent
            age = 1e-9 * (self.node.get_clock().now().nanoseconds - nanoseconds(message.header.stamp))
        heard = self._heard
        heard.twist, heard.until = twist, now - max(age, 0.0) + self.params.timeout
        heard.times.append(now)
        heard.speeds.append(float(np.abs(twist).max()))

    def _on_arm(self, message: Any, now: float) -> None:
        n = len(self.robot.joint_names)
        if self.params.arm != "trajectory":
            self._heard.arm = [(now + self.params.timeout, np.array(message.data, dtype=float).reshape(n))]
            return
        order = [list(message.joint_names).index(name) for name in self.robot.joint_names]
        at, here, pieces = 0.0, self._plant.coordinates[self.robot.space.base_nv :], []
        for point in message.points:
            end = 1e-9 * nanoseconds(point.time_from_start)
            there = np.array(point.positions, dtype=float)[order]
            pieces.append((now + end, (there - here) / max(end - at, 1e-3)))
            at, here = end, there
        self._heard.arm = pieces

    def _wrong(self, kind: str, t: float) -> bool:
        since = None if self._fast_at is None else t - self._fast_at
        return since is not None and any(f.kind == kind and f.at <= since < f.at + f.lasts for f in self.params.faults)

    def _publish(self, topic: str, publisher: Any, message: Any, t: float) -> None:
        if self._rng.random() < self.params.loss or self._wrong(f"{topic}_lost", t):
            return
        delay = self.params.delay + _LATE * self._wrong(f"{topic}_late", t)
        messages = [message] * (1 + self._wrong(f"{topic}_twice", t))
        if self._wrong(f"{topic}_shuffled", t) and topic not in self._held:
            self._held[topic] = message
            return
        if topic in self._held:
            messages.append(self._held.pop(topic))
        for each in messages:
            if delay > 0.0:
                heapq.heappush(self._late, (t + delay, next(self._told), publisher, each))
            else:
                publisher.publish(each)

    def _tell_emergency(self, t: float) -> None:
        if any(fault.kind == "emergency_missing" for fault in self.params.faults):
            return
        pressed = self._wrong("emergency", t)
        if pressed is not self._pressed:
            self._pressed = pressed
            self._emergency_out.publish(self._kinds["std"].Bool(data=pressed))

    def _tell_odometry(self, stamp: int, t: float) -> None:
        message = self._kinds["nav"].Odometry()
        fill_stamp(message.header.stamp, stamp)
        message.header.frame_id = "nowhere" if self._wrong("odom_frame", t) else "odom"
        message.child_frame_id = "base_link"
        fill_pose(message.pose.pose, np.array(self._odometry))
        if self._wrong("odom_nan", t):
            message.pose.pose.position.x = math.nan
        covariance = np.zeros((6, 6))
        covariance[[0, 1, 5], [0, 1, 5]] = self._odometry_error
        message.pose.covariance = covariance.ravel().tolist()
        v = self._plant.v[:3]
        message.twist.twist.linear.x, message.twist.twist.angular.z = float(v[0]), float(v[2])
        self._publish("odom", self._odom_out, message, t)

    def _tell_joints(self, stamp: int, t: float, joints: Array) -> None:
        if not self.robot.joint_names:
            return
        message = self._kinds["sensor"].JointState()
        fill_stamp(message.header.stamp, stamp)
        positions = np.where(self._wrong("joints_nan", t), np.nan, np.asarray(joints, dtype=float))
        message.name, message.position = list(self.robot.joint_names), positions.tolist()
        self._publish("joints", self._joints_out, message, t)

    def _tell_scan(self, stamp: int, t: float, scan: LaserScan) -> None:
        message = self._kinds["sensor"].LaserScan()
        fill_stamp(message.header.stamp, stamp - (2_000_000_000 if self._wrong("scan_old", t) else 0))
        message.header.frame_id = "nowhere" if self._wrong("scan_frame", t) else self._frame
        angles = scan.angles
        message.angle_min, message.angle_max = float(angles[0]), float(angles[-1])
        message.angle_increment = float(angles[-1] - angles[0]) / (len(angles) - 1)
        message.range_min, message.range_max = float(scan.range_min), float(scan.range_max)
        nan = self._wrong("scan_nan", t)
        message.ranges = np.where(nan, np.nan, scan.ranges).astype(np.float32).tolist()
        self._publish("scan", self._scan_out, message, t)

    def _tell_cloud(self, stamp: int, t: float, scan: LaserScan) -> None:
        near = np.isfinite(scan.ranges) & (scan.ranges < scan.range_max)
        r, angle = scan.ranges[near], scan.angles[near]
        flat = np.column_stack((r * np.cos(angle), r * np.sin(angle), np.zeros(len(r))))
        level = float(scan.T_base_sensor[2, 3])
        points = np.vstack([flat + np.array([0.0, 0.0, height - level]) for height in _LAYERS]).astype("<f4")
        sensor = self._kinds["sensor"]
        message = sensor.PointCloud2(height=1, width=len(points), point_step=12, row_step=12 * len(points))
        fill_stamp(message.header.stamp, stamp)
        message.header.frame_id = self._frame
        message.fields = [
            sensor.PointField(name=axis, offset=4 * k, datatype=sensor.PointField.FLOAT32, count=1)
            for k, axis in enumerate("xyz")
        ]
        message.data = array("B", points.tobytes())
        self._publish("cloud", self._cloud_out, message, t)

    def _tell_fix(self, stamp: int, t: float) -> None:
        noise = self._rng.normal(0.0, (0.005, 0.005, 0.003))
        jump = _JUMP if self._wrong("map_jump", t) else np.zeros(3)
        message = self._fix_out.msg_type()
        fill_stamp(message.header.stamp, stamp)
        message.header.frame_id = "map"
        fill_pose(message.pose.pose, self._plant.coordinates[:3] + noise + jump)
        covariance = np.zeros((6, 6))
        covariance[[0, 1, 5], [0, 1, 5]] = 2.5e-5, 2.5e-5, 1e-5
        message.pose.covariance = covariance.ravel().tolist()
        self._publish("fix", self._fix_out, message, t)

    def _mount(self) -> str:
        """Where the depth camera is, as the node's parameter ``mounts`` has it."""
        for camera in self._imagers:
            x, y, z = camera[:3, 3].tolist()
            roll, pitch, yaw = pin.rpy.matrixToRpy(camera[:3, :3]).tolist()
            return f"; mounts:=['{_CAMERA}:{x:.6f}:{y:.6f}:{z:.6f}:{roll:.6f}:{pitch:.6f}:{yaw:.6f}']"
        return ""

    def _tell_depth(self, stamp: int, t: float, image: DepthImage) -> None:
        by = self.params.magnified
        sensor, (rows, columns) = self._kinds["sensor"], (by * image.depth.shape[0], by * image.depth.shape[1])
        info, message = sensor.CameraInfo(height=rows, width=columns), sensor.Image(height=rows, width=columns)
        (fx, fy), (cx, cy) = image.focal, image.center
        cx, cy = by * (cx + 0.5) - 0.5, by * (cy + 0.5) - 0.5
        info.k = [by * fx, 0.0, cx, 0.0, by * fy, cy, 0.0, 0.0, 1.0]
        depth = np.where(np.isfinite(image.depth), 1e3 * image.depth, np.where(np.isnan(image.depth), 0.0, 65535.0))
        message.encoding, message.step = "16UC1", 2 * columns
        pixels = np.repeat(np.repeat(np.rint(depth).astype("<u2"), by, axis=0), by, axis=1)
        message.data = array("B", pixels.tobytes())
        for name, each, publisher in (("info", info, self._info_out), ("depth", message, self._depth_out)):
            fill_stamp(each.header.stamp, stamp)
            each.header.frame_id = _CAMERA
            self._publish(name, publisher, each, t)

    def _judged(self) -> Figures:
        times = np.array([row[0] for row in self._rows])
        coordinates, v = (np.array([row[k] for row in self._rows]) for k in (1, 2))
        seen = evaluate([times, coordinates, v], self.robot, self.world)
        speed = np.abs(v).max(axis=1)
        gaps = np.diff(self._heard.times)
        stands = speed < _REST_SPEED
        stops = np.flatnonzero(stands[1:] & ~stands[:-1])
        first = next((t for t, fast in zip(times, speed > _REST_SPEED, strict=True) if fast), None)
        moves = np.flatnonzero(speed > _REST_SPEED)
        last = float(times[moves[-1]]) if len(moves) else None
        shown = [0.5, 0.99] if len(gaps) else []
        return {
            "seed": self.params.seed,
            "at": coordinates[-1, :3].tolist(),
            "at_by_odometry": list(self._odometry),
            "end_m": self.end,
            "way": np.round(coordinates[:: round(_WAY_STEP / _PERIOD), :3], 4).tolist(),
            "moved_from_s": first,
            "moved_until_s": last,
            "fast_from_s": self._fast_at,
            "stood_from_s": self._stood_at,
            "began_monotonic_s": self._began,
            "path_m": seen.path_m,
            "top_speed_mps": float(np.abs(v[:, 0]).max()),
            "stops": len(stops),
            "at_rest": bool(speed[-1] < _REST_SPEED),
            "contacts_at_speed": len(seen.collisions),
            "contacts_at_rest": len(seen.rest_contacts),
            "touched": sorted({contact.obstacle for contact in seen.contacts}),
            "contacts": [
                {"time_s": c.time, "link": c.link, "obstacle": c.obstacle, "depth_m": c.depth, "speed_mps": c.speed}
                for c in seen.contacts
            ],
            "least_clearance_m": seen.min_clearance_m,
            "commands": len(self._heard.times),
            "last_command_was_rest": bool(self._heard.speeds and self._heard.speeds[-1] == 0.0),
            "not_run_s": [[round(t, 3) for t in span] for span in self._not_run],
            "fault_at_s": None
            if self._fast_at is None or not self.params.faults
            else self._fast_at + self.params.faults[0].at,
            "command_gaps_ms": [round(1e3 * float(np.quantile(gaps, q)), 2) for q in shown]
            + ([round(1e3 * float(gaps.max()), 2)] if len(gaps) else []),
        }
