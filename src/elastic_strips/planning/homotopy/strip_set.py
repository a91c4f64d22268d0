"""Strip sets: strips on different sides of the obstacles, deformed side by side; which one to follow, and why."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import numpy.typing as npt

from elastic_strips.arrays import Array, Indices
from elastic_strips.errors import ConfigurationError
from elastic_strips.ownership import OneThread, exclusive
from elastic_strips.planning.problem import PlanningProblem
from elastic_strips.robot import BaseKind, RobotModel
from elastic_strips.scene import Scene
from elastic_strips.strip import AxisConstraint, Deformer, DeformParams, DeformReport, Strip
from elastic_strips.strip.report import SLIP_LIMIT
from elastic_strips.strip.solver import project_rolling
from elastic_strips.summary import Summary
from elastic_strips.validation import Bound, Checked, Count, NonNegative, Positive, Whole, check_count

from .alternatives import Alternative, AlternativesSearch, base_path, strip_cost
from .classes import ClusterMap, cluster_map, homotopy_class, separating_obstacles, single_obstacles

_log = logging.getLogger(__name__)
_ANGLE_LEVER = 0.25  # [m/rad] how much a radian, of the base or a joint, counts against a metre
_LEFT_OUT_DISTANCE = 0.03  # [m] a node that is so near the robot is left out


@dataclass(frozen=True, slots=True, kw_only=True)
class StripSetParams(Checked):
    """How many strips a set keeps, and when it changes over.

    Attributes:
        count: largest number of strips, the current one included.
        margin: share by which another strip must be cheaper than the current one to be better.
        patience: how many times in a row another strip must be found better before it is followed, and broken
            before it is dropped; or the current one be broken before it is replanned.
        divergence_distance: how far ahead [m] the directions of strips are compared, once the robot has gone as far
            since it was planned.
        divergence_angle: a strip is dropped if its direction then differs from that of a certified current one by more
            than this [rad]: the robot has passed the place where they part.
        plan_every: a planner is called at most once in this many ticks; 0 calls none.
        timeout: longest time of a planner's call within a tick [s].
        backward: whether a straight line may be driven backwards.
    """

    count: Count = 3
    margin: Annotated[float, Bound(low=0.0, below=1.0)] = 0.15  # no strip costs nothing
    patience: Count = 5
    divergence_distance: NonNegative = 0.6
    divergence_angle: NonNegative = 1.8
    plan_every: Whole = 50
    timeout: Positive = 0.5
    backward: bool = True


class _Member:
    """One strip with the workspace that deforms it."""

    def __init__(
        self, robot: RobotModel, params: DeformParams, constraint: AxisConstraint | None, found: Alternative
    ) -> None:
        self.deformer = Deformer(robot, params, constraint=constraint)
        self.report, self.homotopy_class, self.method = found.report, found.homotopy_class, found.method
        self.origin = found.strip.coordinates[0].copy()  # where the robot was when it was planned
        self.broken = self.better = 0  # ticks in a row, of those in which it was deformed

    def __str__(self) -> str:
        return f"a strip of {self.report.strip.length:.2f} m"

    def deform(self, scene: Scene) -> None:
        self.report = self.deformer.step(self.report.strip, scene)
        self.broken = 0 if self.report.usable else self.broken + 1

    @property
    def travelled(self) -> float:
        """How far from there the strip begins now [m]; 0 for a fixed base."""
        strip = self.report.strip
        return float(np.hypot(*(strip.coordinates[0] - self.origin)[:2])) if strip.robot.space.planar else 0.0

    @property
    def cost(self) -> float:
        return strip_cost(self.report, self.deformer.params)

    def alternative(self) -> Alternative:
        r = self.report
        return Alternative(r.strip, r, self.homotopy_class, self.method, r.strip.length, self.cost)


def _failure(report: DeformReport) -> str:
    """Why a strip is of no use."""
    broken = report.certificate.broken
    return str(broken) if broken is not None else report.reason


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class StripSetReport(Summary):
    """A tick of a strip set.

    Attributes:
        current: index in ``alternatives`` of the strip to follow, or None where there is none at all.
        alternatives: the members as they now are; only those named in ``fresh`` were deformed in this very tick, the
            others' certificates are of an earlier scene.
        fresh: indices of the members that were deformed in this tick, the current one first.
        certified: whether the current strip is certified against this tick's scene.
        events: what happened, with the reasons, in words.
        planned: whether a planner was called.
    """

    current: int | None
    alternatives: tuple[Alternative, ...]
    fresh: tuple[int, ...]
    certified: bool
    events: tuple[str, ...]
    planned: bool

    @property
    def best(self) -> Alternative | None:
        """The alternative to follow."""
        return None if self.current is None else self.alternatives[self.current]


class StripSet(OneThread):
    """Workspace: keeps strips of different classes, deforms them against each new scene, and says which is the best.

    A tick deforms the current strip and one of the others, in turn. Only where the current one breaks, others are
    deformed in the same tick until one is certified. A planner is called at most once in
    ``plan_every`` ticks, and less often where it has found nothing more.

    Args:
        robot: the robot of the strips.
        goal: configuration (nq,) where they end.
        params: parameters of the set; the defaults where None.
        deform: parameters of the deformation; the default preset where None.
        seed: seed of the planner.
        constraint: constraint that the strips are drawn to; planned ones satisfy it.
    """

    def __init__(
        self,
        robot: RobotModel,
        goal: npt.ArrayLike,
        *,
        params: StripSetParams | None = None,
        deform: DeformParams | None = None,
        seed: int = 0,
        constraint: AxisConstraint | None = None,
    ) -> None:
        self.robot: RobotModel = robot
        self.params: StripSetParams = params or StripSetParams()
        self.deform: DeformParams = deform or DeformParams()
        self.goal: Array = robot.check_q(goal, what="goal")
        self.seed: int = check_count("seed", seed)
        self._constraint = constraint
        self._planner = Deformer(robot, self.deform, constraint=constraint)
        self._members: list[_Member] = []
        self._current: _Member | None = None
        self._turn = self._since_plan = self._calls = self._futile = 0
        self._said_none = False

    def __len__(self) -> int:
        return len(self._members)

    @exclusive
    def plan(self, scene: Scene, start: npt.ArrayLike, *, timeout: float = 5.0) -> StripSetReport:
        """Forget all strips and plan new ones.

        Args:
            scene: the obstacles, as they stand.
            start: configuration (nq,) where the robot is.
            timeout: longest time [s].

        Raises:
            ConfigurationError: start or goal is not valid, or in collision; the message names the pair.
            ParameterError: a timeout that is not positive.
        """
        self._members, self._current, self._said_none = [], None, False
        events: list[str] = []
        self._plan(scene, self.robot.check_q(start, what="start"), events, timeout)
        return self._report(events, self._members, planned=True)

    @exclusive
    def step(self, scene: Scene, start: npt.ArrayLike | None = None, *, decide: bool = True) -> StripSetReport:
        """One tick: deform against a new scene, and decide which strip to follow.

        Args:
            scene: the obstacles.
            start: configuration (nq,) where the robot is; None where it has not moved.
            decide: whether to change over; if not, the current strip stays the current one until :meth:`leave`.

        Raises:
            ConfigurationError: a start that is not valid, or no start yet.
        """
        if start is None and not self._members:
            raise ConfigurationError("StripSet.step: there are no strips yet; give the start, or call plan")
        events: list[str] = []
        where = self._members[0].report.strip.q[0] if start is None else self.robot.check_q(start, what="start")
        if start is not None:
            self._reconnect(where)
        self._since_plan += 1
        fresh: list[_Member] = []
        if self._current is not None:
            self._current.deform(scene)
            fresh.append(self._current)
        others = [m for m in self._members if m is not self._current]
        if others:
            self._turn = (self._turn + 1) % len(others)
            others[self._turn].deform(scene)
            fresh.append(others[self._turn])
        if decide:
            self._decide(scene, others, fresh, events)
        self._drop(events)
        planned = self._lacks()
        if planned:
            before = set(map(id, self._members))
            self._plan(scene, where, events, self.params.timeout)
            fresh += [m for m in self._members if id(m) not in before]
        return self._report(events, fresh, planned=planned)

    @exclusive
    def leave(self, scene: Scene, start: npt.ArrayLike, why: str) -> StripSetReport:
        """Follow another strip than the current one, because the robot cannot follow that one any more.

        It is the cheapest one that is certified from where the robot is, after up to ``patience`` ticks each. Where
        there is none, all strips are forgotten: `best` of the report is None.

        Args:
            scene: the obstacles.
            start: configuration (nq,) where the robot is.
            why: the reason, for the report's events.

        Raises:
            ConfigurationError: a start that is not valid.
        """
        self._reconnect(self.robot.check_q(start, what="start"))
        others, events = [m for m in self._members if m is not self._current], list[str]()
        for member in others:
            for _ in range(self.params.patience):
                member.deform(scene)
                if member.report.usable:
                    break
        sound = [m for m in others if m.report.usable]
        if sound:
            left = self._current
            self._switch(scene, min(sound, key=lambda m: m.cost), why, events)
            if left is not None:
                self._members.remove(left)
        else:
            self._members, self._current, others = [], None, []
            events.append(f"no alternative left: {why}")
        return self._report(events, others, planned=False)

    # the parts of a tick

    def _reconnect(self, start: Array) -> None:
        """Let the strips begin where the robot is."""
        here = self.robot.space.to_coordinates(start)
        for member in self._members:
            if np.abs(self.robot.space.difference(member.report.strip.coordinates[:1], here[None])).max() > 1e-9:
                member.report = reconnect(member.deformer, member.report, here)

    def _decide(self, scene: Scene, others: list[_Member], fresh: list[_Member], events: list[str]) -> None:
        """Change over at once from a broken strip to a certified one; to a better one after some ticks."""
        current = self._current
        if current is not None and current.report.usable:
            self._said_none = False
            for other in others:
                if other not in fresh:
                    continue
                better = other.report.usable and other.cost < (1.0 - self.params.margin) * current.cost
                other.better = other.better + 1 if better else 0
                if other.better >= self.params.patience:
                    why = f"it costs {other.cost:.2f} m against {current.cost:.2f} m, {other.better} times in a row"
                    self._switch(scene, other, why, events)
                    return
            return
        for other in sorted(others, key=lambda m: m.cost):
            if other not in fresh:
                other.deform(scene)
                fresh.append(other)
            if other.report.usable:
                self._switch(scene, other, _failure(current.report) if current else "there was none to follow", events)
                return
        if not self._said_none:
            self._said_none = True
            events.append(f"no alternative left: {_failure(current.report) if current else 'nothing is planned'}")

    def _switch(self, scene: Scene, to: _Member, why: str, events: list[str]) -> None:
        old, self._current, self._said_none = self._current, to, False
        for member in self._members:
            member.better = 0
        if old is None:
            events.append(f"took up {to}: {why}")
            return
        events.append(f"switched from {self._sides(scene, old, to)}: {why}")

    def _sides(self, scene: Scene, old: _Member, new: _Member) -> str:
        """``"left of box to right of it"``."""
        if not self.robot.space.planar:
            return "one strip to another"
        hit = old.report.certificate.broken  # the old path leads through this one, not past it
        points = [c for c in single_obstacles(self.robot, scene) if hit is None or c.name != hit.obstacle]
        parted = separating_obstacles(base_path(old.report.strip), base_path(new.report.strip), points)
        if not parted:
            return "one strip to another on the same side"
        name, side = next(iter(parted.items()))
        more = f" (and {len(parted) - 1} more)" if len(parted) > 1 else ""
        return f"{side} of {name} to {'left' if side == 'right' else 'right'} of it{more}"

    def _drop(self, events: list[str]) -> None:
        """Drop other strips that have been broken for long, or that the robot has left behind."""
        current = self._current
        for member in tuple(self._members):
            if member is current:
                continue
            why = _failure(member.report) if member.broken >= self.params.patience else ""
            ahead = self.params.divergence_distance
            if not why and member.travelled > ahead and current is not None and current.report.usable:
                angle = divergence_angle(current.report.strip, member.report.strip, ahead)
                if angle > self.params.divergence_angle:
                    why = f"it leads {np.degrees(angle):.0f}° off the current one: the robot has passed where they part"
            if why:
                self._members.remove(member)
                events.append(f"dropped {member}: {why}")

    def _lacks(self) -> bool:
        """Whether to call the planner: where the current strip is broken, or, less and less often, for more strips."""
        every = self.params.plan_every
        if every == 0 or self._since_plan < every:
            return False
        if self._current is None or self._current.broken >= self.params.patience:
            return True
        return len(self._members) < self.params.count and self._since_plan >= every * 2 ** min(self._futile, 5)

    def _unlike(self, members: list[_Member], events: list[str]) -> list[_Member]:
        """The members without those that have come to the same class as a better one."""
        kept: list[_Member] = []
        for member in sorted(members, key=lambda m: (m is not self._current, m.cost)):
            if any(member.homotopy_class == other.homotopy_class for other in kept):
                self._members.remove(member)
                events.append(f"dropped {member}: it passes on the same sides as a better one")
            else:
                kept.append(member)
        return kept

    def _plan(self, scene: Scene, start: Array, events: list[str], timeout: float) -> None:
        """Call the planner for what is missing; a certified strip replaces a broken current one."""
        self._since_plan, self._calls = 0, self._calls + 1
        keep = [m for m in self._members if m.report.usable]
        clusters = self._classified(keep, scene, start)
        if clusters is not None:
            keep = self._unlike(keep, events)
        try:
            found = self._searched(scene, start, timeout, keep, clusters)
        except ConfigurationError as error:
            if not self._members:
                raise
            events.append(f"could not replan: {error}")
            return
        new = [_Member(self.robot, self.deform, self._constraint, a) for a in found.alternatives]
        if new:
            events.append(f"{'replanned' if self._calls > 1 else 'planned'}: {found.reason}")
        elif not keep:
            events.append(f"no strip: {found.reason}")
        self._take(new, keep, scene, events)

    def _classified(self, members: list[_Member], scene: Scene, start: Array) -> ClusterMap | None:
        """The obstacles' clusters; the members get their class among them. None for a fixed base, with one class."""
        if not self.robot.space.planar:
            return None
        endpoints = self.robot.space.to_coordinates(np.stack((start, self.goal)))[:, :2]
        paths = [base_path(m.report.strip) for m in members]
        clusters = cluster_map(self.robot, scene, np.vstack((endpoints, *paths)))
        for member, path in zip(members, paths, strict=True):
            member.homotopy_class = homotopy_class(path, clusters.clusters)
        return clusters

    def _searched(
        self, scene: Scene, start: Array, timeout: float, keep: list[_Member], clusters: ClusterMap | None
    ) -> AlternativesSearch:
        """What a search finds beside the members that are kept."""
        problem = PlanningProblem(
            self.robot,
            scene,
            start,
            self.goal,
            deformer=self._planner,
            seed=self.seed + self._calls,
            timeout=timeout,
            backward=self.params.backward,
        )
        search = AlternativesSearch(
            problem,
            max(self.params.count - len(keep), 1),
            without=[m.homotopy_class for m in keep],
            clusters=clusters,
            ompl_attempts=1 if keep else 3,
        )
        search.run()
        return search

    def _take(self, new: list[_Member], keep: list[_Member], scene: Scene, events: list[str]) -> None:
        """Add what was found; what is broken goes, and the current strip too where something else is certified."""
        current = self._current
        if not keep and new and current is not None:
            self._members = []  # what was broken has no use beside what is certified
            self._switch(scene, new[0], f"replanned after {_failure(current.report)}", events)
        else:
            self._members = [m for m in self._members if m is current or m in keep]
        self._members += new
        self._futile = 0 if new else self._futile + 1
        if self._current is None and self._members:
            self._current = min(self._members, key=lambda m: m.cost)

    def _report(self, events: list[str], fresh: list[_Member], *, planned: bool) -> StripSetReport:
        for event in events:
            _log.info("%s", event)
        current = self._current
        ordered = sorted(fresh, key=lambda m: m is not current)
        return StripSetReport(
            current=None if current is None else self._members.index(current),
            alternatives=tuple(m.alternative() for m in self._members),
            fresh=tuple(self._members.index(m) for m in ordered if m in self._members),
            certified=current is not None and current.report.usable,
            events=tuple(events),
            planned=planned,
        )


def divergence_angle(one: Strip, other: Strip, ahead: float) -> float:
    """Angle [rad] between the directions in which two strips with the same start lead.

    A direction is that from the start to the place ``ahead`` [m] along the base's path, or to the strip's end where
    that is nearer. 0 for a fixed base.
    """
    if not one.robot.space.planar:
        return 0.0
    directions = []
    for strip in (one, other):
        xy = strip.coordinates[:, :2]
        along = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(xy, axis=0).T))))
        at = min(ahead, float(along[-1]))
        directions.append(np.array([np.interp(at, along, xy[:, k]) for k in range(2)]) - xy[0])
    cross = float(directions[0][0] * directions[1][1] - directions[0][1] * directions[1][0])
    return abs(float(np.arctan2(cross, directions[0] @ directions[1])))


def reconnect(deformer: Deformer, report: DeformReport, coordinates: Array) -> DeformReport:
    """A report whose strip begins at coordinates (nv,) and goes on from the nearest point.

    Its certificate is unknown until the next tick, because the first segment is new; the report stays the old one
    except for its strip.
    """
    strip = report.strip
    segment = _nearest(strip, coordinates)
    rest = strip.coordinates[segment + 1 :]
    first = coordinates.copy()
    if strip.robot.space.planar:
        first[2] += 2.0 * np.pi * np.rint((rest[0, 2] - first[2]) / (2.0 * np.pi))
    skip = int(len(rest) > 1 and np.linalg.norm(_weighed(strip, first[None], rest[:1])) < _LEFT_OUT_DISTANCE)
    source = np.arange(segment + 1 + skip, len(strip))
    rows = np.vstack((first, rest[skip:]))
    if strip.robot.base_kind is BaseKind.DIFF_DRIVE:
        rows, slip = project_rolling(strip.robot.space, rows)
        if slip > SLIP_LIMIT:  # it cannot be driven; the next tick starts without known distances
            endpoints = strip.robot.space.from_coordinates(rows[[0, -1]])
            endpoints[-1] = strip.q[-1]
            return replace(report, strip=Strip.from_coordinates(strip.robot, rows, ends=endpoints), slip=slip)
    known: Indices = np.concatenate(([-1], source)).astype(np.intp)
    return replace(report, strip=deformer.carry(strip, rows, known))


def _nearest(strip: Strip, coordinates: Array) -> int:
    """The segment nearest to coordinates; chords instead of arcs."""
    nodes = strip.coordinates
    along = _weighed(strip, nodes[:-1], nodes[1:])
    to = _weighed(strip, nodes[:-1], np.broadcast_to(coordinates, nodes[:-1].shape))
    square = np.maximum((along * along).sum(axis=1), 1e-18)
    share = np.clip((along * to).sum(axis=1) / square, 0.0, 1.0)
    return int(np.argmin(np.linalg.norm(to - share[:, None] * along, axis=1)))


def _weighed(strip: Strip, a: Array, b: Array) -> Array:
    v = strip.robot.space.difference(a, b)
    base = 2 if strip.robot.space.planar else 0
    v[:, base:] *= _ANGLE_LEVER
    return v
