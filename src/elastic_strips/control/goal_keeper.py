"""Goal keeper: the goals of a drive, the plans that lead to them, and what was reached."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor as Workers
from concurrent.futures import Future
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array
from elastic_strips.collision.certificate import LEFT_PATH
from elastic_strips.errors import ConfigurationError, ElasticStripsError
from elastic_strips.planning import BasePose, Goal, PlanReport, check_endpoints
from elastic_strips.robot import PlanarFootprint, RobotModel
from elastic_strips.scene import Scene
from elastic_strips.scene.sight import sight_shares
from elastic_strips.strip import DeformParams, Strip
from elastic_strips.strip.followed import FollowedPath
from elastic_strips.validation import check_array, check_number

from .executor import ExecutorLink
from .interfaces import GoalReached, RunState
from .itinerary import Goals, configuration_of, frames_of, goals_in_order, hand_places, off_goal, place_of
from .local_planner import LocalPlanner
from .params import DriveParams, Tolerance
from .path_drive import PathDrive
from .plan_queue import PlanQueue
from .replanning import Replanned, Replanner, standing
from .strip_timer import PlanResult

_STRIP_START_OFFSET = 0.02
"""A robot at least this far [m, rad] from the beginning of a strip that was planned while it braked stands
elsewhere."""
_PLANNING_TIME = 0.1
"""Time [s] that a plan to another goal is given while the robot drives: the strip begins where it will be then."""
_NEARER = (1.1, 1.5)
"""Distances [m] from a goal, from which a robot looks at it where all ways to be there seem taken from afar …"""
_SIDES = 12  # … from so many sides
_IN_SIGHT_TO = 0.25  # [m] before a hand's place, that it is seen from there
_MOST_PLACES = 6  # of a hand, that are to be seen
_MOST_SHARE = 0.2
"""Part of the hand's places, that may be seen less from a place than from the one that sees most of them."""
_ELSEWHERE = 0.5  # [m] from one such place to the next
_MOST_LOOKS = 3  # such places, after which there is no way to the goal for now …
_LOOKS_ANEW = 20.0  # [s] after which it looks from all of them again: things have moved, or others hide them
_LOOKS_AGAIN = 8.0  # [s] from one plan to the goal to the next at the last of them
_DRIVES_ON = 0.5
"""Time [s] for which the robot drives on towards the goal before, while the way to another one is planned."""


def may_look(robot: RobotModel, scene: Scene, goal: Goal | Sequence[Goal], deform: DeformParams) -> bool:
    """Whether something stands at a goal that a robot may look at from nearer: in a scene by sensors, which see better
    from there, or see from there alone that it is gone."""
    if not _by_sensors(scene) or place_of(robot, goal) is None:
        return False
    q = configuration_of(robot, goal)
    return q is None or _taken(robot, scene, q, deform)


def may_leave(robot: RobotModel, scene: Scene, start: npt.ArrayLike, deform: DeformParams) -> bool:
    """Whether a robot stands too near something in a scene by sensors, and not in it: it may move away from it, or that
    goes, or is further away than it seemed."""
    q, touching = robot.check_q(start, what="start"), replace(deform, clearance=0.0)
    return _by_sensors(scene) and _taken(robot, scene, q, deform) and not _taken(robot, scene, q, touching)


def _by_sensors(scene: Scene) -> bool:
    """Whether a scene is of sensors that see what is free."""
    return bool(scene.held_up) or len(scene.seen) < len(scene)


def _taken(robot: RobotModel, scene: Scene, q: Array, deform: DeformParams) -> bool:
    """Whether something stands where the robot would be in a configuration."""
    try:
        check_endpoints(robot, standing(scene.seen), q, q, deform)
    except ConfigurationError:
        return True
    return False


class GoalKeeper:
    """Workspace: the goals of a drive, and the plans that lead to them, which are computed beside the control loop.

    Args:
        start: (nv,) coordinate row of the robot.
        goal_q: configuration (nq,) of the first goal, to which the planner's strip leads.
        goal: that goal as it was asked for.
        goals: those after it.
        executor, planner, replanner: the parts of the controller.
        params: parameters of the drive.
        workers: run the plans; an own thread where None.
        forget_motions: called where motions that are planned, but have not begun, lead elsewhere.

    Attributes:
        goals: goals after the present one.
        goal_q, goal: configuration (nq,) and coordinate row (nv,) of the present one; while the way to it is planned,
            of the one before.
        reached: the goals that were reached so far, in order of time.
        tolerance: how near counts as reached.
        path: the path that is followed, or None.
        next_path: the path that is followed once the joints are as they are to be on it, or None.
        plans: what computes the plans.
        looks: whether the present goal is a place near the goal from which the robot looks at that, which is the next.
        cancelled: why the goal was given up; empty where it was not.
        no_way: why nothing leads to the goal; empty where something does.
    """

    def __init__(
        self,
        start: Array,
        goal_q: Array,
        goal: Goal | Sequence[Goal],
        goals: Sequence[Goal | Sequence[Goal]],
        executor: ExecutorLink,
        planner: LocalPlanner,
        replanner: Replanner,
        params: DriveParams,
        workers: Workers | None,
        forget_motions: Callable[[], None],
    ) -> None:
        self._robot: RobotModel = planner.robot
        self._executor, self._planner, self._replanner = executor, planner, replanner
        self._params, self._forget_motions = params, forget_motions
        self.tolerance: Tolerance = params.tolerance
        self.plans: PlanQueue = PlanQueue(workers)
        self.goals: list[Goal | Sequence[Goal]] = list(goals)
        self.goal_q: Array = goal_q
        self.goal: Array = self._robot.space.to_coordinates(goal_q)
        self.reached: list[GoalReached] = []
        self.path: PathDrive | None = None
        self.next_path: PathDrive | None = None
        self.cancelled: str = ""
        self.no_way: str = ""
        self._moves_joints = False  # on the way to what they are to be on the next path
        self._counted = False  # whether the present goal was written down as reached
        self._replan: Future[Replanned] | None = None  # plans a strip to the same goal
        self._next: Future[PlanReport] | None = None  # plans the first strip to another goal
        self._next_goal: Goal | Sequence[Goal] = self.goal_q  # that goal
        self._asked_goal: Goal | Sequence[Goal] = goal  # the present one, as it was asked for
        self.looks: bool = False
        self._nearer: Sequence[Goal] = ()  # places from which the robot looks at the goal before it goes on to it
        self._looked_from: list[Array] = []  # (2,) each [m], from where nothing was free at the goal
        self._looked = -np.inf  # [s] when it has looked from the last of them
        self._blocked = ""  # why
        self._led = True  # whether a strip leads to the present goal, or led there
        self._plan_from: Array = start  # (nv,) where either begins
        self._asked = -np.inf  # [s] when another goal was asked for
        self._onward_plan: Future[PlanReport] | None = None  # plans the strip from the present goal to the next
        self._onward: PlanReport | None = None  # that plan, where motions go on along its strip

    # What is asked for

    def retarget(self, t: float, goal: Goals, scene: Scene, latency: float) -> None:
        """Take another goal, or several, in place of all that there were; see :meth:`Controller.retarget`."""
        first, *following = goals_in_order(self._robot, goal)
        self.goals = following
        self.cancelled, self.looks, self._looked_from = "", False, []
        self._set_goal(t, first, scene, latency)

    def follow(
        self, t: float, path: npt.ArrayLike, within: float, wait: bool, joints: npt.ArrayLike | None, latency: float
    ) -> None:
        """Follow a path of the base in place of all goals; see :meth:`Controller.follow`."""
        rows = check_array("path", path, (None, 3 if np.shape(path)[-1:] == (3,) else 2))
        robot = self._robot
        if not robot.space.planar:
            raise ConfigurationError(f"follow: the base of {robot.name!r} is fixed")
        posture = None if joints is None else self._posture(joints)
        check_number("within", within, above=self._planner.margins.tracking_error, unit="m")
        followed = FollowedPath(rows[:, :2], within)
        far = self._too_far(t, followed)
        if far:
            raise ConfigurationError(f"follow: {far}")
        before = self.next_path or self.path
        if posture is None and before is not None:
            posture = before.joints
        yaw = float(rows[-1, 2]) if rows.shape[1] == 3 else None
        drive = PathDrive(robot, followed, yaw, posture, wait=wait)
        self.goals, self.looks = [], False
        known = None if before is None else before.joints
        same = known is not None and posture is not None and np.array_equal(known, posture)
        if same and self.next_path is not None:  # the joints are on their way
            self.next_path = drive
            self._planner.keep_to(followed if self._moves_joints else None)
            return
        self.forget()
        self.cancelled = ""
        if same or self._holds(t, drive):  # what keeps an arm from its posture on the way is no reason to stop
            self._begin_path(t, drive, latency)
            return
        self.next_path = drive
        self.no_way = "it comes to rest, to move its joints before it follows a path"

    def _posture(self, joints: npt.ArrayLike) -> Array:
        """Positions (n,) of the joints, as coordinates."""
        space = self._robot.space
        if not np.size(joints) and space.nv == space.base_nv:
            return np.zeros(0)
        given = check_array("joints", joints, (space.nv - space.base_nv,))
        row = self._executor.estimate.copy()
        row[space.base_nv :] = given
        return space.to_coordinates(self._robot.check_q(space.from_coordinates(row), what="joints"))[space.base_nv :]

    def _too_far(self, t: float, path: FollowedPath) -> str:
        """That the base is too far from a path to follow it; empty where it is not."""
        least = self._planner.margins.tracking_error
        off = float(path.off(self._executor.reference(t).coordinates[None, :2])[0])
        if off <= path.within - least:
            return ""
        return (
            f"the base is {off:.3f} m from the path; within={path.within:g} m allows {path.within - least:.3f} m, "
            f"for the tracking error is up to {least:g} m"
        )

    def _holds(self, t: float, path: PathDrive) -> bool:
        """Whether the joints are as they are to be on a path."""
        here, there = self._executor.reference(t).coordinates[None], self._executor.estimate.copy()
        if path.joints is None:
            return True
        there[self._robot.space.base_nv :] = path.joints
        return float(off_goal(self._robot, here, there)[0, 2]) <= self.tolerance.joints

    def _begin_path(self, t: float, path: PathDrive, latency: float) -> None:
        """Follow a path, from where the robot will be when that is planned."""
        executor = self._executor
        moves, active = not executor.at_rest(t), executor.active
        begin = active.at(t + latency).coordinates if moves else active.coordinates[-1]
        self.path = path
        self._planner.keep_to(path.path)
        strip = path.strip_from(begin)
        self._lead_to(strip)
        self._planner.take(strip, beside=moves)

    def _get_ready(self, t: float, path: PathDrive, scene: Scene, latency: float) -> None:
        """Move the joints as they are to be on a path, from where the robot stands; and then follow it."""
        executor, replanner = self._executor, self._replanner
        if self.planning or not executor.at_rest(t):
            return
        far = self._too_far(t, path.path)  # it came to rest meanwhile
        if far:
            self.cancel(far)
            return
        if self._holds(t, path) and executor.settled:
            self.forget()
            self._begin_path(t, path, latency)
            return
        none = self._moves_joints and (self.no_way or replanner.no_way)
        if none and not path.wait:
            self.cancel(f"the joints cannot be moved for the path: {none}")
        elif not self._moves_joints or (self.no_way and t >= self._asked + self._params.replan_after):
            assert path.joints is not None
            row = executor.active.coordinates[-1].copy()
            row[self._robot.space.base_nv :] = path.joints
            self._set_goal(t, self._robot.space.from_coordinates(row), scene, latency)
            self.next_path, self._moves_joints = path, True
            self._planner.keep_to(path.path)

    def cancel(self, reason: str) -> None:
        """Give up the goal and all after it; see :meth:`Controller.cancel`."""
        self.goals, self.looks = [], False
        self.forget()
        self.cancelled = self.no_way = reason
        self._executor.retarget(self.goal, self.tolerance)
        self._executor.reject(reason)

    def forget(self) -> None:
        """Forget what leads to the goals that there were."""
        self.no_way, self.path, self.next_path, self._moves_joints = "", None, None, False
        self._planner.keep_to(None)
        for plan in (self._next, self._onward_plan, self._replan):
            if plan is not None:
                plan.cancel()  # where it has not begun
        self._next = self._onward_plan = self._replan = self._onward = None
        self._forget_motions()

    def forget_replan(self) -> None:
        """Forget a strip that begins where the robot would have come to rest."""
        self._replan = None

    # What has come of it

    @property
    def planning(self) -> bool:
        """Whether the way to another goal is still planned."""
        return self._next is not None

    @property
    def gave_up(self) -> bool:
        """Whether nothing leads to the goal, and nothing is planned that may: ``no_way`` says why."""
        return bool(self.no_way) and not self.planning and self.next_path is None

    @property
    def goes_on(self) -> bool:
        """Whether motions go on from the present goal to the next one."""
        return self._onward is not None

    def drives_on(self, t: float) -> bool:
        """Whether the robot drives on towards the goal before, while the way to another one is planned."""
        return self.planning and t < self._asked + _DRIVES_ON

    def set_out(self, t: float, scene: Scene, latency: float) -> None:
        """Set out for the next goal where this one is reached."""
        executor = self._executor
        if self.next_path is not None:
            self._get_ready(t, self.next_path, scene, latency)
        elif not (self.goals and executor.settled) or self.planning:
            return
        elif executor.run.state is RunState.REACHED or (
            self.looks_here(t) and (not self.no_way or t >= self._asked + _LOOKS_AGAIN)
        ):
            self._set_goal(t, self.goals.pop(0), scene, latency)

    def count(self, t: float) -> None:
        """Write down that the goal is reached, once it is."""
        ready = not self.planning and self.next_path is None
        if self._executor.run.state is RunState.REACHED and ready and not self._counted:
            self._counted = True
            self._reach(t, self._executor.estimate, passed=False)

    def pass_goal(self, t: float, at: Array) -> None:
        """The robot has gone on from the goal to the next one, without a stop; there it was at the row ``at`` (nv,)."""
        self._planner.passed = None
        if self._onward is None:  # other goals were asked for meanwhile, and the strip to them is being planned
            return
        self._reach(t, at, passed=True)
        report, self._onward, self._onward_plan, self._replan = self._onward, None, None, None
        self._asked_goal, self.looks = self.goals.pop(0), False
        self._take_goal(report)

    def looks_here(self, t: float) -> bool:
        """Whether the robot stands where it looks at the goal from nearer, or cannot go on to there."""
        if not (self.looks and self._executor.at_rest(t)):
            return False
        if self.no_way or self._replanner.no_way:
            return True
        position, yaw, _ = off_goal(self._robot, self._executor.estimate[None], self.goal)[0].tolist()
        return position <= self.tolerance.position and yaw <= self.tolerance.yaw

    def _reach(self, t: float, at: Array, *, passed: bool) -> None:
        if self.looks:
            return
        self._looked_from = []
        position, yaw, joints = off_goal(self._robot, at[None], self.goal)[0].tolist()
        frame, hand = self._off_hand(at)
        self.reached.append(GoalReached(t, self.goal, position, yaw, joints, frame, hand, passed))
        if passed:
            self._executor.log("passed", f"goal {len(self.reached)}, {1e3 * position:.0f} mm off")

    def _off_hand(self, at: Array) -> tuple[str, float]:
        """The frame that was asked to be somewhere, of several the one that is furthest off, and how far [m] it is off
        at the row ``at`` (nv,) from where it is at the goal; where none was asked for, the last control point, which
        has no name here."""
        robot = self._robot
        there, here = (robot.space.from_coordinates(row) for row in (self.goal, at))
        apart = {
            frame: np.linalg.norm((robot.frame_pose(here, frame) - robot.frame_pose(there, frame))[:3, 3])
            for frame in frames_of(self._asked_goal)
        }
        if not apart:
            points = robot.control_points(here) - robot.control_points(there)
            apart = {"": np.linalg.norm(points[-1])}
        furthest = max(apart, key=apart.__getitem__)
        return furthest, float(apart[furthest])

    # Plans

    def look_onward(self, scene: Scene) -> None:
        """Plan the strip from the goal to the next one, and let motions go on along it as soon as it is there."""
        if not self.goals or self._params.stop_at_goals or not self._replanner.flows or self._onward is not None:
            return
        if self.looks:  # from here nothing was free there
            return
        if self._onward_plan is None:
            self._onward_plan = self.plans.submit(self._replanner.onward(scene, self.goal_q, self.goals[0]))
        elif self._onward_plan.done() and self._onward_plan.exception() is None:  # else it is planned at the goal
            report = self._onward_plan.result()
            if report.certified:
                self._onward = report
                self._planner.lead_on(report.strip, self.tolerance)

    def replan(self, t: float, scene: Scene) -> bool:
        """Start planning a strip where that is due, and take it when it is ready; True while the robot waits for it.

        It begins where the robot will come to rest, and is taken when it stands there. A robot that evades takes it at
        once: it will stand elsewhere, and joins the strip from wherever that is, as any that it has left. Where it
        brakes, and will stand elsewhere for that, a strip from there is planned instead.
        """
        if self._next is not None:
            if not self._next.done():
                return True
            self._take_next(t, self._next, scene)
        replanner, executor = self._replanner, self._executor
        if not replanner.pending and self._replan is None:
            return False
        end, reference = executor.active.coordinates[-1], executor.reference(t)
        stands = not (reference.v.any() or self._apart(reference.coordinates, end))
        beside = self._joins_from_beside(end, stands)
        if self._replan is None and t >= replanner.due:
            if self._goal_is_taken(scene):
                replanner.pending = False
                self._plan_to(self._asked_goal, end, scene)
                return True
            start = self._configuration(end)
            self._plan_from = end
            # Where there is no way to how the robot was to be there, there may be one to another way to be there.
            several = replanner.no_way and configuration_of(self._robot, self._asked_goal) is None
            otherwise = self._asked_goal if several else None
            self._replan = self.plans.submit(replanner.another(scene, start, self.goal_q, otherwise))
        if self._replan is not None and self._replan.done() and (stands or beside):
            found = self._finish(self._replan, replanner.take)
            if found.strip is not None:
                self._onward_plan = self._onward = None
                if self._apart(self._robot.space.to_coordinates(found.strip.q[-1]), self.goal):
                    self._forget_motions()
                    self._lead_to(found.strip)
                self._planner.take(found.strip, beside=beside)
            executor.log("replanned", found.reason)
        return True

    def blocked(self, t: float, path: PathDrive, result: PlanResult, at_rest: bool) -> bool:
        """Where the robot stands and cannot go on along the path that it follows, say for what it waits, and lay the
        strip onto the path anew; or give the path up, which is answered by True."""
        executor = self._executor
        stuck = path.stuck(t, executor.reference(t).coordinates, moves=result.accepted or not at_rest)
        if not stuck:
            return False
        broken = None if result.certificate is None else result.certificate.broken
        broken = result.report.certificate.broken if broken is None else broken
        what = "a way" if broken is None else (broken.labels or (broken.link, broken.obstacle))[1]
        if not path.wait and stuck >= self._params.replan_after:
            self.cancel(f"the path is blocked by {what}: {result.reason}")
            return True
        if what not in path.told:
            path.told.add(what)
            executor.log("waiting", f"for {what}: {result.reason}")
        if path.due(t, self._params.replan_after):
            out = broken is not None and broken.kind == LEFT_PATH
            strip = path.strip_from(executor.active.coordinates[-1], turns=out)
            self._planner.take(strip, as_it_is=out)
        return False

    def _set_goal(self, t: float, goal: Goal | Sequence[Goal], scene: Scene, latency: float) -> None:
        """Start planning the way to a goal, from where the robot will be by then."""
        executor = self._executor
        self.forget()
        executor.retarget(self.goal, self.tolerance)
        moves, begin = not executor.at_rest(t), t + latency + _PLANNING_TIME
        self._asked = t
        self._plan_to(goal, (executor.active.at(begin) if moves else executor.reference(t)).coordinates, scene)

    def _plan_to(self, goal: Goal | Sequence[Goal], at: Array, scene: Scene) -> None:
        """Have the first strip to a goal planned, from a coordinate row (nv,)."""
        self._next_goal, self._plan_from = goal, at
        self._next = self.plans.submit(self._replanner.first(scene, self._configuration(at), goal))

    def _goal_is_taken(self, scene: Scene) -> bool:
        """Whether something stands where the robot would be at the goal, and there are other ways to be at it, or it
        may look at it from nearer."""
        goal, robot, deform = self._asked_goal, self._robot, self._replanner.deform
        if configuration_of(robot, goal) is not None:
            return len(self._looked_from) <= _MOST_LOOKS and may_look(robot, scene, goal, deform)
        return _taken(robot, scene, self.goal_q, deform)

    def _configuration(self, row: Array) -> Array:
        """(nq,) configuration at which a plan begins; a joint that is estimated a little beyond its range is at its
        end."""
        space = self._robot.space
        within = np.clip(row, space.lower, space.upper)
        near = np.abs(within - row) < _STRIP_START_OFFSET
        return space.from_coordinates(np.where(near, within, row))

    def _take_next(self, t: float, plan: Future[PlanReport], scene: Scene) -> None:
        """Follow the first strip to another goal, from beside it where the robot moves."""
        self._next = None
        try:
            report = plan.result()
        except Exception as error:  # on any error: the present strip leads to another goal
            if isinstance(error, ElasticStripsError) and self._not_free(t, error, scene):
                return  # what stands at the goal may go away: the strip to it is watched on
            self.no_way = f"no way to the goal: {error}"
            raise
        executor = self._executor
        stands, end = executor.at_rest(t), executor.active.coordinates[-1]
        if stands and self._apart(self._plan_from, end):  # it came to rest meanwhile
            self._plan_to(self._next_goal, end, scene)
            return
        looks = self._next_goal is self._nearer
        if looks:
            self._executor.log("looking", "the robot goes to look at its goal from nearer")
            if not self.looks:
                self.goals.insert(0, self._asked_goal)
        self._asked_goal, self.looks = self._next_goal, looks
        self._take_goal(report)
        self._planner.take(report.strip, beside=not stands)

    def _not_free(self, t: float, error: ElasticStripsError, scene: Scene) -> bool:
        """No way to be at the goal was found, or none to a place from which it is seen.

        Returns:
            Whether the robot goes on, or will try again.
        """
        goal, executor = self._next_goal, self._executor
        nearer = goal is self._nearer
        new = not (self.looks or nearer or goal is self._asked_goal)  # no strip leads to it
        start, deform = self._configuration(self._plan_from), self._replanner.deform
        leaves = new and may_leave(self._robot, scene, start, deform)
        if new and not (leaves or may_look(self._robot, scene, goal, deform)):
            return False
        if new and (not executor.at_rest(t) or self._apart(self._plan_from, executor.active.coordinates[-1])):
            self._plan_to(goal, executor.active.coordinates[-1], scene)  # once more, from where it comes to rest
            return True
        if not nearer:
            executor.log("replanned", f"no other way to be at the goal: {error}")
            self._blocked = str(error)
            if new:
                self._led, self._asked_goal, self.looks = False, goal, leaves
        if self.looks and not nearer:  # it stands where it was to see more, and goes on from there
            self.goals.insert(0, goal)
        if not nearer and self._look_nearer(t, goal, scene):
            return True
        if self.looks or not self._led:
            self.no_way, self._asked = f"no way to the goal: {self._blocked}", t
        return True

    def _look_nearer(self, t: float, goal: Goal | Sequence[Goal], scene: Scene) -> bool:
        """Plan to a place near a goal from which it is seen, where sensors have shown something at it from afar: there
        they are not as exact, and may not see that it is gone."""
        executor, at = self._executor, place_of(self._robot, goal)
        may = may_look(self._robot, scene, goal, self._replanner.deform)
        if at is None or not (may and executor.at_rest(t)):
            return False
        here = executor.active.coordinates[-1]
        if self._is_elsewhere(here[:2]):  # else it got nowhere since
            self._looked_from.append(here[:2].copy())
            self._looked = t
        if len(self._looked_from) > _MOST_LOOKS:
            if t < self._looked + _LOOKS_ANEW:
                return False
            self._looked_from, self._looked = [here[:2].copy()], t
        sides = 2.0 * np.pi / _SIDES * np.arange(_SIDES)
        places = [at + far * np.array([np.cos(side), np.sin(side)]) for far in _NEARER for side in sides]
        places = self._with_sight([place for place in places if self._is_elsewhere(place)], goal, at, scene)
        self._nearer = [BasePose(*place.tolist(), yaw=float(np.arctan2(*(at - place)[::-1]))) for place in places]
        self._plan_to(self._nearer, here, scene)
        return True

    def _with_sight(self, places: list[Array], goal: Goal | Sequence[Goal], at: Array, scene: Scene) -> list[Array]:
        """Those of some places (2,) from which most is seen of where a hand is to be: a camera sits about as high as
        the robot, and what is known to stand hides things from it."""
        height = PlanarFootprint.of(self._robot, self._robot.home_q).height
        points = hand_places(goal)
        points = points[:: -(-len(points) // _MOST_PLACES)] if len(points) else np.array([[*at, 0.5 * height]])
        eyes = np.array([[*place, height] for place in places]).reshape(-1, 3)
        shares = sight_shares(standing(scene.seen), eyes, points, _IN_SIGHT_TO)
        most = float(shares.max(initial=0.0)) - _MOST_SHARE
        return [
            place for place, share in zip(places, shares.tolist(), strict=True) if share > 0.0 and share >= most
        ] or places

    def _is_elsewhere(self, place: Array) -> bool:
        """Whether a place (2,) is away from all from which the robot has looked at its goal."""
        return all(float(np.hypot(*(place - before))) > _ELSEWHERE for before in self._looked_from)

    def _take_goal(self, report: PlanReport) -> None:
        """The goal is where a strip ends that is followed from now on."""
        self._forget_motions()
        self._executor.log("goal", report.reason)
        self._replanner.begin(report)
        self._lead_to(report.strip)

    def _lead_to(self, strip: Strip) -> None:
        self._led = True
        self.goal_q = strip.q[-1]
        self.goal = self._robot.space.to_coordinates(self.goal_q)
        self._counted = False
        self._executor.retarget(self.goal, self.tolerance)

    def _joins_from_beside(self, end: Array, stands: bool) -> bool:
        """Whether the robot joins the strip that is ready from beside it, because it evades.

        A strip is discarded that begins where a robot that brakes will not stand.
        """
        plan = self._replan
        if plan is None or not plan.done():
            return False
        apart = self._apart(self._plan_from, end)
        beside = self._planner.off_strip and (apart or not stands)
        if apart and not beside:  # it braked
            self._finish(plan, self._replanner.discard)
        return beside

    def _finish(self, plan: Future[Replanned], told: Callable[[Replanned], None]) -> Replanned:
        """The outcome of a plan, told to the replanner in any case; what has failed is raised after that."""
        self._replan = None
        error = plan.exception()
        found = plan.result() if error is None else Replanned(None, "")
        told(found)
        if error is not None:
            raise error
        return found

    def _apart(self, one: Array, other: Array) -> bool:
        """Whether a strip that begins at one configuration does not begin at another."""
        return float(np.abs(self._robot.space.difference(one, other)).max(initial=0.0)) > _STRIP_START_OFFSET
