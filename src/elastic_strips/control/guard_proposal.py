"""Proposal: the command nearest to a desired one that keeps from all that is near; a small quadratic programme.

It is only a proposal: distances change along a motion otherwise than their gradients say. What is driven is certified.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from elastic_strips.arrays import Array, Indices, Mask
from elastic_strips.collision import BodySet, MotionBounds, ObstacleProximity, SelfProximity
from elastic_strips.ownership import OneThread, exclusive
from elastic_strips.robot import Kinematics, RobotModel
from elastic_strips.trajectory import MotionLimits, ReferenceState

from .prediction import Outlook

_BEYOND = 1.5e-3  # [m] beyond the clearance at which the proposal stops, so that its motion is certified
_SLACK = 0.02  # part of a pair's largest speed by which it may come too near for the whole speed of one motor
_OUT_TIME = 0.05  # [s] in which what is inside the clearance, or hardly outside, leaves it
_OUT_SPEED = 0.05  # [m/s] and the largest speed with which it does
_MORE, _LESS, _MOST = 0.1, 0.01, 2.0  # by which caution rises and falls, and how far
_ROUNDS = 3  # of adding pairs that the last proposal would come too near
_MOST_PAIRS = 40  # that a round adds
_HOLD_TRAVEL = 1.5  # times the hold: what a speed covers before it brakes, its rise included
_EXACT = 2e-5  # [m] to which distances are known
_IMMOVABLE = 1e-4  # [m/s] a pair that nothing makes faster than this is not parted
_MOVES = 1e-6  # of its largest speed: a coordinate that is to be slower is to rest
_SAME = 1e-9  # [m/s]


@dataclass(frozen=True, slots=True, eq=False)
class NearPairs:
    """What is near one configuration.

    Attributes:
        rows: (K, nv) how fast the two of each pair part, for each unit of velocity [m/s].
        distance: (K,) of each pair [m], less what is not known of a moving obstacle.
        need: (K,) clearance [m] to keep.
        cover: (K,) what the obstacle may cover by itself until the robot would stand [m].
        names: (K,) link and obstacle, or link and link, by their names in messages.
        outer: how many of the pairs, the first ones, are with obstacles.
    """

    rows: Array
    distance: Array
    need: Array
    cover: Array
    names: tuple[tuple[str, str], ...]
    outer: int

    @property
    def own(self) -> NearPairs:
        """Those of two links of the robot alone."""
        rest = slice(self.outer, None)
        return NearPairs(
            self.rows[rest], self.distance[rest], self.need[rest], self.cover[rest], self.names[rest], outer=0
        )

    def of(self, link: str, obstacle: str) -> float:
        """The distance [m] of a pair by its names; NaN where it is not near."""
        found = [d for d, names in zip(self.distance.tolist(), self.names, strict=True) if names == (link, obstacle)]
        return min(found, default=math.nan)


@dataclass(frozen=True, slots=True, eq=False)
class Proposal:
    """A proposed velocity.

    Attributes:
        v: (nv,) body twist and joint rates.
        cause: number of the pair that bends it most; None where nothing does.
    """

    v: Array
    cause: int | None


class Proposer(OneThread):
    """Workspace: what is near a robot, and velocities that keep from it.

    Args:
        robot: the robot.
        limits: limits of its motors.
        self_clearance: distance [m] to keep between the robot's own links.
        part: share of the acceleration limits with which motions brake.
        reach: obstacles nearer than this [m] count; self_reach: links to each other.

    Attributes:
        caution: how much longer braking is taken to last, at least 1; see :meth:`learn`.
    """

    def __init__(
        self,
        robot: RobotModel,
        limits: MotionLimits,
        *,
        self_clearance: float,
        part: float,
        reach: float,
        self_reach: float,
    ) -> None:
        import scipy.optimize  # noqa: F401  # late: slow to import, and no command of a guard is to wait for it

        self.robot: RobotModel = robot
        self.limits: MotionLimits = limits
        self.self_clearance: float = self_clearance
        self.caution: float = 1.0
        self._bodies = bodies = BodySet.links(robot)
        self._kin = Kinematics(robot.tree, 1)
        self._obstacles = ObstacleProximity(bodies, influence=reach, tolerance=_EXACT)
        pairs = robot.pairs_within(0.0)
        self._self = SelfProximity(bodies, pairs, MotionBounds(bodies), influence=self_reach, tolerance=_EXACT)
        self._change = part * limits.acceleration
        slides = limits.drive_dim == 2  # nothing moves it sideways
        self.columns: Indices = np.array([i for i in range(robot.nv) if not (slides and i == 1)], dtype=np.intp)
        self.scale: Array = self._scale(slides)

    def _scale(self, slides: bool) -> Array:
        """(m,) the largest velocities of what can be commanded, by which changes are measured."""
        limits = self.limits
        if slides:
            forward = float(limits.drive_speed.min())
            drive = [forward, 2.0 * forward / limits.track]
        else:
            drive = limits.drive_speed.tolist()
        return np.array([*drive, *limits.joint_speed])

    @exclusive
    def reset(self) -> None:
        """Forget all that is known, as is needed after an exception."""
        self._obstacles.reset()
        self._self.reset()

    def learn(self, *, refused: bool) -> None:
        """Be more cautious after a proposal whose motion was refused, and less so again after others."""
        self.caution = min(self.caution + _MORE, _MOST) if refused else max(self.caution - _LESS, 1.0)

    @exclusive
    def look(self, start: ReferenceState, outlook: Outlook, *, settle: float, clearance: float) -> NearPairs:
        """What is near a state of the robot.

        Args:
            start: the state.
            outlook: of the scene.
            settle: time [s] that the robot needs to stand, besides the braking time of its present speeds.
            clearance: to keep from obstacles [m].
        """
        kin, bodies, possible = self._kin, self._bodies, outlook.possible
        kin.update(start.coordinates[None])
        delay = start.time - outlook.scene.time if len(possible) else 0.0
        self._obstacles.update(kin, outlook.scene, possible.predict(np.array([delay])) if len(possible) else None)
        self._self.update(kin)
        near, own = self._obstacles.contacts(), self._self.contacts()
        rows = np.empty((len(near) + len(own), self.robot.nv))
        if len(near):
            rows[: len(near)] = kin.directional(near.node, bodies.joint[near.body], near.witness, near.direction)
        if len(own):
            one, two = (bodies.joint[self._self.pairs[own.pair, k]] for k in (0, 1))
            rows[len(near) :] = kin.directional(own.node, one, own.first, own.direction)
            rows[len(near) :] -= kin.directional(own.node, two, own.second, own.direction)
        cover = np.zeros(len(rows))
        candidates = self._obstacles.candidates
        assert candidates is not None
        if len(possible) and len(near):
            number = np.full(len(outlook.scene), -1)
            number[possible.obstacles] = np.arange(len(possible))
            mover = number[candidates.obstacle[near.part]]
            at = np.flatnonzero(mover >= 0)
            m, span = mover[at], settle + float(self.braking(start.v).max(initial=0.0))
            nearer = np.einsum("ki,ki->k", near.direction[at], possible.velocity[m]) * span
            more = 0.5 * possible.acceleration[m] * ((delay + span) ** 2 - delay * delay)
            cover[at] = np.maximum(nearer + possible.speed[m] * span + more, 0.0)
        need = np.full(len(rows), self.self_clearance)
        need[: len(near)] = clearance
        labels = bodies.labels
        names = [(labels[b], candidates.obstacle_name(p)) for b, p in zip(near.body, near.part, strict=True)]
        names += [(labels[i], labels[j]) for i, j in self._self.pairs[own.pair]]
        return NearPairs(rows, np.concatenate((near.distance, own.distance)), need, cover, tuple(names), len(near))

    def braking(self, v: Array) -> Array:
        """(nv,) how long the coordinates take to brake from velocities ``v`` (nv,) [s]; the base's brake together."""
        limits, base = self.limits, self.robot.space.base_nv
        times = np.abs(limits.to_coordinates(v)) / self._change
        out = np.empty(self.robot.nv)
        out[:base] = times[: limits.drive_dim].max(initial=0.0)
        out[base:] = times[limits.drive_dim :]
        return out

    @exclusive
    def propose(
        self, desired: Array, start: ReferenceState, pairs: NearPairs, *, hold: float, turns: bool = True
    ) -> Proposal:
        """The velocity nearest to a desired one with which no pair comes nearer than the robot can brake for.

        What is to rest stays at rest. The bounds are soft: where they contradict each other each is broken by a little.

        Args:
            desired: (nv,) velocity.
            start: the state whose ``pairs`` these are.
            pairs: what is near.
            hold: time [s] for which a velocity is held before the robot brakes.
            turns: whether the turning of a differential drive may be changed.
        """
        if not len(pairs.distance):
            return Proposal(desired, None)
        room = pairs.distance - pairs.need - pairs.cover - _BEYOND
        share, brake = np.abs(pairs.rows * start.v), self.braking(start.v)
        span = 0.5 * (share @ brake) / np.maximum(share.sum(axis=1), _SAME) + _HOLD_TRAVEL * hold
        span *= self.caution
        least = -room / span
        short = np.where(pairs.cover > 0.0, -np.inf, pairs.need + 0.5 * _BEYOND - pairs.distance)
        least[room < 0.0] = np.clip(short[room < 0.0] / _OUT_TIME, 0.0, _OUT_SPEED)
        return self.nearest(desired, pairs, least, turns=turns)

    def nearest(self, desired: Array, pairs: NearPairs, least: Array, *, turns: bool) -> Proposal:
        """The velocity nearest to a desired one with which pairs part at ``least`` (K,) [m/s]; see :meth:`propose`."""
        rows = pairs.rows[:, self.columns] * (self.scale * self._free(desired, turns))
        want = desired[self.columns] / self.scale
        size = np.sqrt(np.einsum("ki,ki->k", rows, rows))
        movable, size = size > _IMMOVABLE, np.maximum(size, _IMMOVABLE)
        rows, least = rows / size[:, None], (least - pairs.rows @ desired) / size  # of what is changed
        x, used = np.zeros_like(want), np.zeros(len(rows), dtype=bool)
        cause: int | None = None
        for _ in range(_ROUNDS):
            short = np.where(used | ~movable, 0.0, least - rows @ x)
            new = np.flatnonzero(short > _SLACK * 1e-2)
            if not len(new):
                break
            used[new[np.argsort(-short[new], kind="stable")[:_MOST_PAIRS]]] = True
            at = np.flatnonzero(used)
            x, push = _nearest(rows[at], least[at])
            cause = int(at[int(np.argmax(push))])
        if cause is None:
            return Proposal(desired, None)
        v = np.zeros_like(desired)
        v[self.columns] = (want + x) * self.scale
        return Proposal(v, cause)

    def _free(self, desired: Array, turns: bool) -> Mask:
        """(m,) which of the commanded coordinates may be changed: those that are to move."""
        free, k = np.abs(desired[self.columns]) > _MOVES * self.scale, self.limits.drive_dim
        if k == 3:  # it slides, but turns only where it is to turn
            free[:2] = free[:2].any()
        elif k == 2 and not turns:
            free[1] = False
        return free


def _nearest(rows: Array, least: Array) -> tuple[Array, Array]:
    """The smallest x (m,) with ``rows`` (K, m) @ x ≥ ``least`` (K,), softly, and how much each row pushes (K,).

    It is the least-distance problem of Lawson and Hanson, solved by non-negative least squares; each row has a variable
    of its own that gives way for ``_SLACK``.
    """
    from scipy.optimize import nnls  # late: slow to import

    count, m = rows.shape
    system = np.zeros((m + count + 1, count))
    system[:m] = rows.T
    system[m : m + count].flat[:: count + 1] = _SLACK
    system[-1] = least
    target = np.zeros(m + count + 1)
    target[-1] = 1.0
    push, _ = nnls(system, target, maxiter=20 * count + 100)
    rest = system @ push - target
    return -rest[:m] / min(rest[-1], -1e-12), push
