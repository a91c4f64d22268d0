"""Live: a strip that is kept certified in a thread of its own while obstacles and goal are moved, say by mouse."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque

import numpy as np

from elastic_strips.arrays import Array, ArrayLike
from elastic_strips.errors import ConfigurationError, RobotError, SceneError
from elastic_strips.planning.keeper import StripKeeper
from elastic_strips.robot import RobotModel
from elastic_strips.robot.inverse_kinematics import rotation_of
from elastic_strips.robot.space import wrap_angle
from elastic_strips.scene import Scene
from elastic_strips.strip import DeformParams, DeformReport, Strip
from elastic_strips.validation import check_array, check_number, check_type

from .drag import Drag, base_pose
from .hand import hand_solvers
from .viewer import Viewer

_log = logging.getLogger(__name__)
_TURN_SPEED = 3.0  # of what is moved [rad/s]
_STILL = 1e-6  # [m or rad] by which nothing has moved in a picture
_RECENT_TICKS = 50  # whose median is shown


class LiveStrip:
    """A strip that gives way, tick by tick, while obstacles and goal are moved.

    Things that are moved, by :meth:`move`, :meth:`move_goal` or with the mouse in the viewer's page, go there no faster
    than ``speed``. Where the strip stays broken for 0.4 s a path is replanned, in another thread, and taken where
    it is certified in the scene of that moment. While start or goal touches something the strip waits, and says so.
    Obstacles that have a motion move on by the clock until they are grabbed; then they stay where they are put.

    Examples:
        >>> live = LiveStrip(robot, scene, strip, viewer=Viewer())  # doctest: +SKIP
        >>> live.move("shelf", (1.5, 0.4, 0.6))  # doctest: +SKIP
    """

    def __init__(
        self,
        robot: RobotModel,
        scene: Scene,
        strip: Strip,
        *,
        viewer: Viewer | None = None,
        params: DeformParams | None = None,
        rate: float = 50.0,
        speed: float = 2.0,
        thread: bool = True,
    ) -> None:
        """Start ticking.

        Args:
            robot: the robot of the strip.
            scene: the obstacles.
            strip: the strip to begin with.
            viewer: shows the strip, and things are dragged in it; None: no viewer.
            params: the deformer's parameters.
            rate: ticks a second.
            speed: largest speed of moved things [m/s].
            thread: False leaves it to the caller to call :meth:`tick`; time then goes on by 1 / ``rate`` [s] with each
                call.

        Raises:
            InputError: a rate or a speed out of range, another robot's strip, or an argument of another type.
        """
        check_type("robot", robot, RobotModel, RobotError)
        check_type("scene", scene, Scene, SceneError)
        check_type("strip", strip, Strip)
        check_type("viewer", viewer, Viewer, none=True)
        check_number("rate", rate, low=1.0, high=1000.0, unit="Hz")
        check_number("speed", speed, above=0.0, high=100.0, unit="m/s")
        self._robot, self._scene = robot, scene
        self._period, self._speed = 1.0 / rate, speed
        self._keeper = StripKeeper(robot, scene, strip, params=params, period=self._period)
        self._viewer = viewer
        self._lock = threading.Lock()
        self._targets: dict[str, Array] = {}
        self._goal: Array | None = None  # (nv,) coordinates
        self._hand_goal: Array | None = None  # pose (4, 4)
        self._hands = hand_solvers(robot)  # of the ticks, and of whoever holds the lock
        self._held: tuple[str | None, bool, Array] | None = None  # name, hand, and the pose (4, 4) when it was grabbed
        self._ticks: deque[float] = deque([self.report.seconds], maxlen=_RECENT_TICKS)
        self._shown: tuple[DeformReport, Scene, list[tuple[str, str]]] | None = None  # the newest picture
        self._count = 0
        self._first_time = scene.time
        self._ended = threading.Event()
        if viewer is not None:
            viewer.show(robot, scene, self.report)
            viewer.listen(self._hear, goal=robot.space.planar, hand=self._hands is not None)
        self._thread: threading.Thread | None = None
        if thread:
            self._thread = threading.Thread(target=self._run, name="elastic-strips live", daemon=True)
            self._thread.start()

    @property
    def report(self) -> DeformReport:
        """The report of the newest tick."""
        return self._keeper.report

    @property
    def scene(self) -> Scene:
        """The obstacles as of the newest tick."""
        return self._scene

    @property
    def replans(self) -> int:
        """How many planned paths were taken."""
        return self._keeper.replans

    @property
    def ticks(self) -> int:
        """How many ticks there were."""
        return self._count

    @property
    def alive(self) -> bool:
        """Whether it still ticks."""
        return not self._ended.is_set() and (self._thread is None or self._thread.is_alive())

    def move(self, name: str, at: ArrayLike) -> None:
        """Let an obstacle go to another place.

        Args:
            name: name of the obstacle.
            at: (3,) place of its origin [m], or pose (4, 4).

        Raises:
            SceneError: there is no obstacle of that name.
            InputError: ``at`` is not a place.
        """
        there = np.asarray(at, dtype=float)
        pose = np.array(self._scene.obstacle(name).pose)
        if there.shape == (4, 4):
            pose = np.array(self._scene.moved(name, there).obstacle(name).pose)  # checked
        else:
            pose[:3, 3] = check_array("at", at, (3,))
        with self._lock:
            self._targets[name] = pose

    def move_goal(self, x: float, y: float, yaw: float = 0.0) -> None:
        """Let the base's goal go to another place [m, m, rad]; the joints' goals stay.

        Raises:
            ConfigurationError: the robot's base is fixed.
            InputError: something that is not a number.
        """
        if not self._robot.space.planar:
            raise ConfigurationError(f"{self._robot.name!r} stands on a fixed base, so its goal does not move")
        where = [check_number(n, v, unit=u) for n, v, u in (("x", x, "m"), ("y", y, "m"), ("yaw", yaw, "rad"))]
        with self._lock:
            goal = self.report.strip.coordinates[-1] if self._goal is None else self._goal
            self._goal = np.array([*where, *goal[3:]])

    def move_hand(self, at: ArrayLike) -> None:
        """Let the goal's hand go to another place by the robot's joints, as far as they reach; its base stays.

        Args:
            at: (3,) place of the last control point [m], or pose (4, 4) of its link there, in the world.

        Raises:
            ConfigurationError: the robot has no joint that moves its last control point.
            InputError: ``at`` is not a place.
        """
        if self._hands is None:
            raise ConfigurationError(f"{self._robot.name!r} has no joint that moves its hand")
        pose = np.eye(4)
        if np.shape(at) == (4, 4):
            there = check_array("at", at, (4, 4))
            pose[:3, :3], pose[:3, 3] = rotation_of(there[:3, :3]), there[:3, 3]
        else:
            pose[:3, 3] = check_array("at", at, (3,))
            with self._lock:
                pose[:3, :3] = self._hands[1].pose(self.report.strip.coordinates[-1])[:3, :3]
        with self._lock:
            self._hand_goal = pose

    def close(self) -> None:
        """End the ticks; the viewer stays as it is."""
        self._ended.set()
        if self._viewer is not None:
            self._viewer.listen(None)
        if self._thread is not None and threading.current_thread() is not self._thread:
            self._thread.join(5.0)
        self._keeper.close()

    def __enter__(self) -> LiveStrip:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _repr_html_(self) -> str:
        if self._viewer is None or self._viewer.url is None:
            return self.report.strip._repr_html_()
        return (
            f'<iframe src="{self._viewer.own_url}" style="width: 100%; height: 480px; border: 0; border-radius: 8px">'
            "</iframe>"
        )

    # Messages of the pages, in the thread that hears them

    def _hear(self, drag: Drag) -> None:
        if drag.kind == "release":
            self._held = None
            return
        if drag.kind == "grab":
            pose = self._pose(drag.name, drag.hand)
            self._held = None if pose is None else (drag.name, drag.hand, pose)
            if self._viewer is not None and pose is not None and drag.name is not None:
                self._viewer.single(drag.name)
        elif self._held is not None and self._held[:2] == (drag.name, drag.hand):
            pose = drag.applied(self._held[2])
            if drag.name is not None:
                with self._lock:
                    self._targets[drag.name] = pose
            elif drag.hand:
                with self._lock:
                    self._hand_goal = pose
            else:
                self.move_goal(float(pose[0, 3]), float(pose[1, 3]), float(np.arctan2(pose[1, 0], pose[0, 0])))

    def _pose(self, name: str | None, hand: bool) -> Array | None:
        """Pose (4, 4) of something that can be grabbed: of an obstacle, or of hand or base at the goal."""
        if name is not None:
            return np.array(self._scene.obstacle(name).pose) if name in self._scene else None
        if hand:
            with self._lock:
                return None if self._hands is None else self._hands[1].pose(self.report.strip.coordinates[-1])
        return base_pose(self.report.strip.coordinates[-1]) if self._robot.space.planar else None

    # The loop

    def _run(self) -> None:
        began = due = time.monotonic()
        began -= self._first_time
        try:
            while not self._ended.is_set():
                self._tick(time.monotonic() - began)
                due = max(due + self._period, time.monotonic())
                self._ended.wait(due - time.monotonic())
        except Exception:
            _log.exception("the live strip has ended")

    def tick(self) -> DeformReport:
        """Make one tick if no thread does; return its report."""
        self._tick(self._first_time + (self._count + 1) * self._period)
        return self.report

    def _tick(self, now: float) -> None:
        keeper, moving = self._keeper, any(obstacle.motion is not None for obstacle in self._scene)
        scene = self._moved(self._scene.at(now) if moving else self._scene)
        strip = keeper.taken(scene) or self._towards_goal(self.report.strip)
        self._scene = scene
        report = keeper.tick(now, strip, scene)
        self._count += 1
        self._ticks.append(report.seconds)
        if self._viewer is not None:
            notes = [("replanned", "looking for a way" if keeper.searching else str(keeper.replans))]
            shown, self._shown = self._shown, (report, scene, notes)
            if shown is not None and shown[1] is scene and shown[2] == notes and _alike(shown[0], report):
                self._shown = shown  # pages draw when something changes
            else:
                self._viewer.update(report, scene, tick=float(np.median(self._ticks)), notes=notes)

    def _moved(self, scene: Scene) -> Scene:
        """The scene with what is moved one step nearer to where it is wanted."""
        with self._lock:
            targets = dict(self._targets)
        for name, pose in targets.items():
            obstacle = scene.obstacle(name)
            there = _towards(np.asarray(obstacle.pose), pose, self._speed * self._period, _TURN_SPEED * self._period)
            scene = scene.with_observations([obstacle.observed(there, None)])
            if np.array_equal(there, pose):
                with self._lock:
                    if self._targets.get(name) is pose:
                        del self._targets[name]
        return scene

    def _towards_goal(self, strip: Strip) -> Strip:
        """The strip with its last node one step nearer to where the goal is wanted, the others the less the nearer to
        the start."""
        with self._lock:
            goal, hand, self._hand_goal = self._goal, self._hand_goal, None
        coordinates = np.array(strip.coordinates)
        if hand is not None and self._hands is not None:
            goal = self._hands[0].reached(coordinates[-1] if goal is None else goal, hand)
            with self._lock:
                self._goal = goal
        if goal is None:
            return strip
        space = self._robot.space
        off = goal - coordinates[-1]
        angles = np.r_[[False, False, True][: space.base_nv], space.circular].astype(bool)
        off[angles] = wrap_angle(off[angles])
        way = float(np.hypot(*off[:2])) if space.planar else 0.0
        turns = np.abs(off[2:] if space.planar else off)
        far = max(way / (self._speed * self._period), float(turns.max(initial=0.0)) / (_TURN_SPEED * self._period))
        if far <= 1.0:
            with self._lock:
                self._goal = None if self._goal is goal else self._goal
        share = np.linspace(0.0, 1.0, len(coordinates))[:, None]
        return Strip.from_coordinates(self._robot, coordinates + share * off / max(far, 1.0))


def _alike(one: DeformReport, other: DeformReport) -> bool:
    """Whether two reports give the same picture."""
    q, p = one.strip.q, other.strip.q
    if (one.status, one.reason) != (other.status, other.reason) or q.shape != p.shape:
        return False
    same = np.array_equal(one.certificate.segments, other.certificate.segments)
    return same and float(np.abs(q - p).max(initial=0.0)) < _STILL


def _towards(pose: Array, target: Array, step: float, turn: float) -> Array:
    """``pose`` (4, 4) at most ``step`` [m] and ``turn`` [rad] nearer to ``target``; exactly that where it is near."""
    from scipy.spatial.transform import Rotation  # late: slow to import

    off = target[:3, 3] - pose[:3, 3]
    rotation = Rotation.from_matrix(pose[:3, :3].T @ target[:3, :3]).as_rotvec()
    share = min(1.0, step / max(float(np.linalg.norm(off)), 1e-12), turn / max(float(np.linalg.norm(rotation)), 1e-12))
    if share >= 1.0:
        return target
    there = np.eye(4)
    there[:3, :3] = pose[:3, :3] @ Rotation.from_rotvec(share * rotation).as_matrix()
    there[:3, 3] = pose[:3, 3] + share * off
    return there
