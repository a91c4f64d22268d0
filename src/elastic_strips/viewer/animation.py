"""Animation: a robot that drives along a strip while the strip is deformed, and a recorded run."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from elastic_strips.arrays import Array, ArrayLike, Document, Indices
from elastic_strips.collision import PathCertificate
from elastic_strips.control.record import Record
from elastic_strips.errors import InputError, RobotError, SceneError
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Obstacle, Scene
from elastic_strips.strip import Strip
from elastic_strips.strip.report import DeformReport
from elastic_strips.validation import check_number, check_type, shown

from . import commands, geometry
from .commands import Command, Track
from .drawing import (
    CERTIFIED,
    HAND_THREAD,
    REFUSED,
    THREADS,
    UNCHECKED,
    Drawing,
    Report,
    Snapshot,
    bare_legend,
    segment_colors,
)
from .drawing_obstacles import MOVING, MOVING_COLOR, estimated_legend
from .geometry import Floats, RobotPoses, linear
from .path_report import PathReport
from .seen_replay import draw_seen

STATE_COLORS = {
    "moving": "#2b6cb0",
    "slowing": "#d69e2e",
    "stopped": "#8c5a2b",
    "reached": "#2f9e68",
    "failed": "#7b2d8e",
}
_REFERENCE = "#24303c"
_FRAME_RATE, _MAX_FRAMES = 20.0, 600  # the page interpolates between them
_MAX_STRIPS, _MAX_RECORDED, _MAX_NODES = 24, 32, 24
_MAX_TRACE, _MAX_TRAILS = 400, 48
_TRAIL_GHOSTS = ((0.4, 0.3), (0.8, 0.19), (1.2, 0.1))  # how far behind [s], opacity
_NEXT_TICK = 0.15  # [s] after which a plan is another one than that which was refused
_CARD_PERIOD, _EVENT_TIME = 0.1, 2.5  # the card changes so often, and shows an event so long [s]
_CAMERA_HEIGHT = 1.0  # of the camera; higher than for a strip, as obstacles hide what goes on behind them


@dataclass(frozen=True, slots=True)
class StripAnimation:
    """A robot that drives along a strip, or along a sequence of them while the strip is deformed.

    The strips, nodes (N, nq) with a report or None for each, are evenly spread over the duration [s]. Obstacles of the
    scene that have a motion move. ``notes`` are further rows of the card.
    """

    robot: RobotModel
    scene: Scene
    strips: tuple[Array, ...]
    reports: tuple[Report | None, ...]
    duration: float
    notes: tuple[tuple[str, str], ...] = ()

    def snapshot(self) -> Snapshot:
        """The first moment, with the camera turned to it; of a refuted path, the configuration that shows it."""
        report = self.reports[0]
        q = report.q if isinstance(report, PathReport) else None
        return Snapshot(self.robot, self.scene, self.strips[0], report, frame=True, q=q, notes=self.notes)


@dataclass(frozen=True, slots=True)
class RunReplay:
    """A record, played from ``begin`` to ``end`` [s], ``speed`` times as fast as it was."""

    robot: RobotModel
    record: Record
    begin: float
    end: float
    speed: float

    @property
    def duration(self) -> float:
        """How long it plays [s]."""
        return (self.end - self.begin) / self.speed


Animated = Strip | DeformReport | PathReport | ArrayLike
"""A strip, a report about one, or configurations (N, nq)."""


# A strip


def strip_animation(
    robot: RobotModel, scene: Scene, subject: object, duration: float, notes: Iterable[tuple[str, str]] = ()
) -> StripAnimation:
    """The checked animation of an ``Animated``, or of several.

    Raises:
        InputError: Nothing to play, a duration that is not positive, or nodes of the wrong size.
    """
    check_type("robot", robot, RobotModel, RobotError)
    check_type("scene", scene, Scene, SceneError)
    check_number("duration", duration, above=0.0, high=3600.0, unit="s")
    if isinstance(subject, PathCertificate):
        raise InputError("a certificate of a path has no path: show viewer.PathReport.of(robot, path, certificate)")
    if isinstance(subject, np.ndarray) or hasattr(subject, "q") or hasattr(subject, "strip"):
        subject = [subject]
    if not isinstance(subject, Iterable) or isinstance(subject, (str, bytes)):
        raise InputError(f"a strip, a report, a path (N, nq) or a sequence of them is played, not {shown(subject)}")
    strips, reports = [], []
    for item in subject:
        strip, report = strip_and_report(item)
        try:
            nodes = np.asarray(getattr(strip, "q", strip), dtype=float)
        except (TypeError, ValueError):
            raise InputError(f"this is not a strip, a report or configurations (N, nq): {shown(strip)}") from None
        if nodes.ndim != 2 or not len(nodes) or nodes.shape[1] != robot.nq:
            raise InputError(f"a path has shape {nodes.shape}; {robot.name!r} wants (N, {robot.nq}) with N >= 1")
        strips.append(nodes)
        reports.append(report)
    if not strips:
        raise InputError("there is no strip to play; give a strip, a report, a path (N, nq) or a sequence of them")
    return StripAnimation(robot, scene, tuple(strips), tuple(reports), float(duration), tuple(notes))


def strip_and_report(item: object) -> tuple[object, Report | None]:
    """Return the strip of a report and the report, or what was given and None."""
    report = cast(Report, item) if hasattr(item, "certificate") and hasattr(item, "strip") else None
    return getattr(item, "strip", item), report


def draw_strips(drawing: Drawing, play: StripAnimation) -> list[Command]:
    """Return the commands that show the first moment and play the rest."""
    space = play.robot.space
    out = drawing.draw(play.snapshot())
    poses, _ = drawing.prepare(play.robot)
    drawing.playing = True
    frames, fps = _frames(play.duration)
    share = np.linspace(0.0, 1.0, frames + 1)
    coordinate_arrays = [space.to_coordinates(nodes) for nodes in play.strips]
    poses.update(_driven(poses, coordinate_arrays, share))
    tracks = _robot_tracks(drawing, poses.matrices(drawing.joints))
    for obstacle in drawing.obstacles.moving(play.scene):
        path = drawing.obstacles.path(obstacle)
        tracks += commands.motion_tracks(path, _obstacle_poses(obstacle, play.scene.time + share * play.duration))
    if len(coordinate_arrays) > 1:
        out += drawing.hide()
        out += _sequence(drawing, play, coordinate_arrays, tracks, frames)
    out.append(drawing.camera(np.concatenate(coordinate_arrays), play.scene))
    out.append(commands.animation(tracks, fps))
    return out


def _frames(duration: float) -> tuple[int, float]:
    """How many frames there are, and how many a second."""
    frames = int(np.clip(round(duration * _FRAME_RATE), 2, _MAX_FRAMES))
    return frames, frames / duration


def _robot_tracks(drawing: Drawing, matrices: Floats) -> list[Track]:
    """Let the robot's bodies move: (F, B, 16) matrices."""
    paths = enumerate(drawing.body_paths)
    return [track for b, path in paths for track in commands.motion_tracks(path, matrices[:, b])]


def _obstacle_poses(obstacle: Obstacle, times: Array) -> Floats:
    return commands.columns(np.array([obstacle.at(float(t)).pose for t in times]))


def _driven(poses: RobotPoses, coordinate_arrays: Sequence[Array], share: Array) -> Array:
    """Where the robot is in each frame: coordinate rows (F, nv).

    It drives along the strip; if the strips of a sequence begin where the robot is, it is there.
    """
    space, places, starts = poses.space, [], []
    for coordinates in coordinate_arrays:
        poses.update(coordinates)
        places.append(geometry.arc_length(poses.points()))
        starts.append(coordinates[0])
    follows = len(coordinate_arrays) > 1 and float(np.abs(np.diff(starts, axis=0)).max()) > 1e-4
    place = share * (len(coordinate_arrays) - 1)
    index = np.minimum(place.astype(int), max(len(coordinate_arrays) - 2, 0))
    eased = share * share * (3.0 - 2.0 * share)

    def at(which: int, s: float) -> Array:
        if follows:
            return coordinate_arrays[which][0]
        where = np.array([s * places[which][-1]])
        return geometry.interpolated(space, coordinate_arrays[which], places[which], where)[0]

    if len(coordinate_arrays) == 1:
        return geometry.interpolated(space, coordinate_arrays[0], places[0], eased * places[0][-1])
    before = np.array([at(int(i), float(s)) for i, s in zip(index, eased, strict=True)])
    after = np.array([at(int(i) + 1, float(s)) for i, s in zip(index, eased, strict=True)])
    return space.interpolate(before, after, place - index)


def _sequence(
    drawing: Drawing, play: StripAnimation, coordinate_arrays: Sequence[Array], tracks: list[Track], frames: int
) -> list[Command]:
    """Draw some of the strips and let each be seen in its turn."""
    poses, _ = drawing.prepare(play.robot)
    count = min(len(coordinate_arrays), _MAX_STRIPS)
    chosen = np.unique(np.linspace(0, len(coordinate_arrays) - 1, count).round().astype(int))
    begins = np.round(chosen / (len(coordinate_arrays) - 1) * frames).astype(int)
    out: list[Command] = []
    for k, which in enumerate(chosen):
        path = f"/playback/{k}"
        poses.update(coordinate_arrays[which])
        colors = segment_colors(play.reports[which], len(coordinate_arrays[which]) - 1)
        out += drawing.strip(path, coordinate_arrays[which], poses.points(), colors, light=True)
        out.append(commands.visible(path, k == 0))
        end = begins[k + 1] if k + 1 < len(chosen) else frames + 1
        times = np.arange(frames + 1)
        tracks.append(commands.visible_track(path, (times >= begins[k]) & (times < end)))
    return out


# A recorded run


def run_replay(robot: RobotModel, record: Record, *, speed: float, begin: float | None, end: float | None) -> RunReplay:
    """The checked replay of a record.

    Raises:
        InputError: another robot than the recorded one, a speed that is not positive, or nothing between begin and end.
    """
    record.check_robot(robot)
    check_number("speed", speed, low=1e-3, high=1e3)
    first, last = float(record.control.time[0]), float(record.control.time[-1])
    a, b = max(first, first if begin is None else begin), min(last, last if end is None else end)
    if not b > a:
        raise InputError(
            f"there is nothing to play from {a:g} to {b:g} s; the record goes from {first:g} to {last:g} s"
        )
    return RunReplay(robot, record, a, b, float(speed))


def draw_run(drawing: Drawing, play: RunReplay) -> list[Command]:
    """Return the commands that show the first moment and play the rest."""
    record, robot = play.record, play.robot
    frames, fps = _frames(play.duration)
    times = np.linspace(play.begin, play.end, frames + 1)
    coordinates = geometry.interpolated(robot.space, record.control.coordinates, record.control.time, times)
    state = record.control.state[np.searchsorted(record.control.time, times, side="right") - 1]
    scene = record.world.scene.at(play.begin)
    passing = frozenset({*record.world.appears, *record.world.vanishes})

    poses, out = drawing.prepare(robot)
    out += drawing.stop()
    out += drawing.obstacles.draw(scene, alone=passing)
    poses.update(coordinates)
    matrices, points = poses.matrices(drawing.joints), poses.points()
    out.append(commands.transforms("/robot", drawing.body_paths, matrices[0]))
    tracks = _robot_tracks(drawing, matrices)
    out += _obstacles(drawing, record, scene, times, tracks)
    out += draw_seen(record.seen, times, tracks)
    out += _traces(play, coordinates, state, points[:, -1], tracks)
    out += _ring(play, coordinates, state, tracks)
    shown = _recorded_strips(drawing, play, times, tracks)
    out += shown
    goal = coordinates[-1] if record.goal is None else record.goal
    out += drawing.markers(np.stack((record.control.coordinates[0], goal)))
    if robot.joint_names:
        poses.update(goal[None])
        out += drawing.hand_ball(poses.points()[0])
    out += [*drawing.hide(), commands.visible("/hulls", False)]
    drawing.playing = True
    out.append(drawing.camera(np.concatenate((coordinates, goal[None])), scene, height=_CAMERA_HEIGHT))
    out += _captions(drawing, play, times, points, bool(shown))
    out.append(commands.animation(tracks, fps))
    return out


def _obstacles(drawing: Drawing, record: Record, scene: Scene, times: Array, tracks: list[Track]) -> list[Command]:
    """Let obstacles move, with their trails, and be seen while they exist."""
    world, out = record.world, []
    moving = drawing.obstacles.moving(scene)
    trail = _TRAIL_GHOSTS[: _MAX_TRAILS // max(len(moving), 1)]
    for obstacle in moving:
        path = drawing.obstacles.path(obstacle)
        tracks += commands.motion_tracks(path, _obstacle_poses(obstacle, times))
        begin = max(world.appears.get(str(obstacle.name), -np.inf), times[0])
        mesh = geometry.obstacle_mesh(obstacle)
        if mesh is None:
            continue
        for k, (lag, opacity) in enumerate(trail):
            behind = f"/playback/trails/{k}/{path.rsplit('/', 1)[1]}"
            look = commands.material(MOVING, opacity=opacity, hides=False)
            out.append(commands.mesh(behind, mesh, look, cast=False))
            tracks += commands.motion_tracks(behind, _obstacle_poses(obstacle, np.maximum(times - lag, begin)))
            there = np.array([world.exists(str(obstacle.name), t) and t - lag > begin for t in times])
            tracks.append(commands.visible_track(behind, there))
    for name in dict.fromkeys((*world.appears, *world.vanishes)):
        there = np.array([world.exists(name, t) for t in times])
        tracks.append(commands.visible_track(drawing.obstacles.path(scene.obstacle(name)), there))
    return out


def _traces(
    play: RunReplay, coordinates: Array, state: NDArray[np.uint8], hand: Array, tracks: list[Track]
) -> list[Command]:
    """Draw the reference as a thin line, and where base and hand have been so far, coloured by state."""
    robot, record = play.robot, play.record
    out: list[Command] = []
    rows, base = record.control, np.column_stack((coordinates[:, :2], np.zeros(len(coordinates))))
    if robot.space.planar:
        inside = (rows.time >= play.begin) & (rows.time <= play.end) & np.isfinite(rows.reference).all(axis=1)
        nodes = rows.reference[inside]
        nodes = nodes[_evenly(nodes[:, :2], _MAX_TRACE)]
        colors = np.tile(linear(_REFERENCE), (max(len(nodes) - 1, 0), 1))
        band = geometry.ribbon(robot.space, nodes, colors, width=0.014, height=0.02, steps=1)
        if band is not None:
            out.append(commands.mesh("/playback/trace/reference", band, commands.material(lit=False), cast=False))
    colors = np.array([linear(_color(record, code)) for code in range(len(record.states))])
    for name, points in (("hand", hand), ("base", base)) if robot.space.planar else (("hand", hand),):
        chosen = _evenly(points, _MAX_TRACE)
        if len(chosen) < 2:
            continue
        path, look = f"/playback/trace/{name}", commands.material(lit=False)
        rods = geometry.between(points[chosen[:-1]], points[chosen[1:]], 0.007 if name == "hand" else 0.016)
        out.append(commands.mesh(path, geometry.rod(), look, instances=len(rods), cast=False))
        out.append(commands.instances(path, rods, colors[state[chosen[:-1]]]))
        passed = np.searchsorted(chosen[1:], np.arange(len(coordinates)), side="right")
        tracks.append(commands.count_track(path, passed))
    return out


def _evenly(points: Array, count: int) -> Indices:
    """At most ``count`` of points (N, d), at least a centimetre apart along their way, first and last among them."""
    along = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))))
    if not along[-1] > 0.005:
        return np.zeros(min(len(points), 1), dtype=np.intp)
    wanted = np.linspace(0.0, along[-1], int(np.clip(along[-1] / 0.01, 1, count - 1)) + 1)
    return np.unique(np.searchsorted(along, wanted - 1e-12))


def _ring(play: RunReplay, coordinates: Array, state: NDArray[np.uint8], tracks: list[Track]) -> list[Command]:
    """Lay a ring about the base that shows where it heads, and the state by its colour."""
    place = np.tile(np.eye(4), (len(coordinates), 1, 1))
    if play.robot.space.planar:
        place[:, :2, 3] = coordinates[:, :2]
        c, s = np.cos(coordinates[:, 2]), np.sin(coordinates[:, 2])
        place[:, 0, 0], place[:, 0, 1], place[:, 1, 0], place[:, 1, 1] = c, -s, s, c
    place[:, 2, 3] = 0.012
    tracks += commands.motion_tracks("/playback/state", commands.columns(place))
    out: list[Command] = []
    for code in np.unique(state).tolist():
        path = f"/playback/state/{code}"
        look = commands.material(linear(_color(play.record, code)), opacity=0.85, lit=False)
        out.append(commands.mesh(path, geometry.ring(0.52, 0.6), look, cast=False))
        tracks.append(commands.visible_track(path, state == code))
    return out


def _recorded_strips(drawing: Drawing, play: RunReplay, times: Array, tracks: list[Track]) -> list[Command]:
    """Draw some of the strips, each to be seen until the next one."""
    planning = play.record.planning
    lengths = np.diff(planning.node_offset)
    looked_at = np.array([bool(name) for name in planning.statuses] or [False])[planning.status]  # in that tick
    there = np.flatnonzero((lengths > 1) & looked_at & (planning.time <= play.end))
    late = np.flatnonzero(planning.time[there] <= play.begin)
    there = there[late[-1] if len(late) else 0 :]
    if not len(there):
        return []
    rows = there[np.unique(np.linspace(0, len(there) - 1, _MAX_RECORDED).round().astype(int))]
    poses, _ = drawing.prepare(play.robot)
    out: list[Command] = []
    for k, row in enumerate(rows.tolist()):
        nodes = planning.strip(row)
        nodes = nodes[np.unique(np.linspace(0, len(nodes) - 1, _MAX_NODES).round().astype(int))]
        poses.update(nodes)
        color = linear(CERTIFIED if planning.certified[row] else REFUSED)
        path = f"/playback/strips/{k}"
        out += drawing.strip(path, nodes, poses.points(), np.tile(color, (len(nodes) - 1, 1)), light=True)
        until = planning.time[rows[k + 1]] if k + 1 < len(rows) else np.inf
        tracks.append(commands.visible_track(path, (times >= planning.time[row]) & (times < until)))
    return out


def _captions(drawing: Drawing, play: RunReplay, times: Array, points: Array, strips: bool) -> list[Command]:
    """The content of the card over time."""
    record, planning = play.record, play.record.planning
    speed = np.linalg.norm(np.gradient(points, times, axis=0), axis=-1).max(axis=-1)
    codes = record.control.state
    moments = np.union1d(
        np.arange(play.begin, play.end, max(_CARD_PERIOD * play.speed, (play.end - play.begin) / 600)),
        record.control.time[1:][np.diff(codes.astype(int)) != 0],
    )
    moments = moments[(moments >= play.begin) & (moments <= play.end)]
    used = [record.states[code] for code in np.unique(codes).tolist()]
    legend = [[name, STATE_COLORS.get(name, UNCHECKED)] for name in used] + [["reference", _REFERENCE]]
    if strips:
        legend += [["strip certified", CERTIFIED], ["strip not certified", REFUSED]]
        legend.append(THREADS)
    if play.robot.space.planar:
        legend.append(["goal", HAND_THREAD])
        if play.robot.joint_names:
            legend.append(["thin line: way of the hand", STATE_COLORS.get("moving", UNCHECKED)])
    legend += bare_legend(play.robot)
    legend += drawing.obstacles.legend()
    if len(record.seen):
        legend += estimated_legend()
    if drawing.obstacles.moving(record.world.scene.at(play.begin)):
        legend.append(["where it was just now", f"color-mix(in srgb, {MOVING_COLOR} 40%, white)"])
    cards: list[Document] = []
    median = float(np.median(planning.tick_ms[np.isfinite(planning.tick_ms)])) if len(planning.tick_ms) else 0.0
    for t in moments.tolist():
        code = int(codes[np.searchsorted(record.control.time, t + 1e-9, side="right") - 1])
        rows = [["time", f"{t:.1f} s"], ["fastest point", f"{np.interp(t, times, speed):.2f} m/s"]]
        row = planning.row_at(t)
        if row >= 0:
            if strips and planning.statuses[planning.status[row]]:  # what is driven is certified by itself, to its stop
                rows.append(["strip", "certified" if planning.certified[row] else "not certified"])
            if np.isfinite(planning.clearance[row]):
                rows.append(["clearance at the nodes", f"{planning.clearance[row]:.3f} m"])
            if np.isfinite(planning.tick_ms[row]):
                rows.append(["tick", f"{planning.tick_ms[row]:.1f} ms, median {median:.1f} ms"])  # one at rest is short
        chip = [record.states[code], _color(record, code)]
        cards.append({"chip": chip, "rows": rows, "note": _note(record, t, row)})
    at = (moments - play.begin) / play.speed
    common: Document = {"title": drawing.title, "legend": legend}
    return [commands.hud({**common, **cards[0]}), commands.captions(at, cards, common)]


def _note(record: Record, t: float, row: int) -> str:
    """The last event if it is recent, else the planner's reason."""
    fresh = [e for e in record.events if t - _EVENT_TIME < e.time <= t]
    if fresh and fresh[-1].kind == "refused" and row >= 0:  # until something is accepted
        over = record.planning.certified[row] and record.planning.time[row] > fresh[-1].time + _NEXT_TICK
        fresh = [] if over else fresh
    if fresh:
        return f"{fresh[-1].kind}: {fresh[-1].reason}" if fresh[-1].reason else fresh[-1].kind
    return record.planning.reasons[record.planning.reason[row]] if row >= 0 else ""


def _color(record: Record, code: int) -> str:
    return STATE_COLORS.get(record.states[code], UNCHECKED)
