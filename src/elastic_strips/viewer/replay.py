"""Replay: a recorded run, played: the robot, the obstacles with their trails, the strip of the time, what went on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from elastic_strips.control.record import Record
from elastic_strips.errors import InputError
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Obstacle, Scene
from elastic_strips.viewer import commands, geometry, meshes, playback
from elastic_strips.viewer.bodies import obstacle_mesh
from elastic_strips.viewer.commands import Command
from elastic_strips.viewer.drawing import (
    BASE_THREAD,
    CERTIFIED,
    HAND_THREAD,
    REFUSED,
    STILL,
    UNCHECKED,
    Drawing,
    hexcolor,
)
from elastic_strips.viewer.geometry import Doubles
from elastic_strips.viewer.obstacles import MOVING

STATE_COLORS = {
    "moving": "#2b6cb0",
    "slowing": "#d69e2e",
    "stopped": "#d64541",
    "reached": "#2f9e68",
    "failed": "#7b2d8e",
}
_REFERENCE = "#24303c"
_FPS, _MAX_FRAMES = 30.0, 900
_MAX_STRIPS, _MAX_NODES, _MAX_TRACE, _MAX_TRAILS = 48, 32, 400, 48
_TRAIL = ((0.4, 0.3), (0.8, 0.19), (1.2, 0.1))  # how far behind [s], opacity
_CAPTION = 0.1  # [s]
_HEIGHT = 1.0  # of the camera; higher than for a strip, as obstacles hide what goes on behind them
_EVENT = 2.5  # [s]


@dataclass(frozen=True, slots=True)
class Replay:
    """What is to be played: a record from ``begin`` to ``end`` [s], ``speed`` times as fast as it was."""

    robot: RobotModel
    record: Record
    begin: float
    end: float
    speed: float

    @property
    def duration(self) -> float:
        """How long it plays [s]."""
        return (self.end - self.begin) / self.speed


def replay(robot: RobotModel, record: Record, speed: float, begin: float | None, end: float | None) -> Replay:
    """Check what the caller wants to see.

    Raises:
        InputError: another robot than the recorded one, a speed that is not positive, or nothing between begin and end.
    """
    record.check_robot(robot)
    if not (np.isfinite(speed) and 1e-3 <= speed <= 1e3):
        raise InputError(f"speed = {speed} must be between 0.001 and 1000")
    first, last = float(record.control.time[0]), float(record.control.time[-1])
    a, b = max(first, first if begin is None else begin), min(last, last if end is None else end)
    if not b > a:
        raise InputError(
            f"there is nothing to play from {a:g} to {b:g} s; the record goes from {first:g} to {last:g} s"
        )
    return Replay(robot, record, a, b, float(speed))


def draw(drawing: Drawing, play: Replay) -> list[Command]:
    """Return the commands that show the first moment and play the rest."""
    record, robot = play.record, play.robot
    frames = int(np.clip(round(play.duration * _FPS), 2, _MAX_FRAMES))
    times = np.linspace(play.begin, play.end, frames + 1)
    chart = _between(robot, record.control.time, record.control.chart, times)
    state = record.control.state[np.searchsorted(record.control.time, times, side="right") - 1]
    scene = record.world.scene.at(play.begin)
    passing = frozenset({*record.world.appears, *record.world.vanishes})

    poses, out = drawing.prepare(robot)
    out += drawing.stop()
    out += drawing.obstacles.draw(scene, alone=passing)
    poses.update(chart)
    matrices, points = poses.matrices(drawing.joints), poses.points()
    out.append(drawing.robot_at(matrices[0]))
    tracks: list[Mapping[str, Any]] = []
    for b, path in enumerate(drawing.body_paths):
        tracks += playback.motion(path, np.arange(frames + 1), matrices[:, b])
    out += _obstacles(drawing, record, scene, times, tracks)
    out += _traces(robot, record, play, chart, state, points[:, -1], tracks)
    out += _ring(robot, record, chart, state, tracks)
    shown = _strips(drawing, play, times, tracks)
    out += shown
    goal = chart[-1] if record.goal is None else record.goal
    out += drawing.markers(np.stack((record.control.chart[0], goal)))
    out += [commands.visible(path, False) for path in (*STILL, "/tunnel")]
    drawing.playing = True
    out.append(drawing.camera(np.concatenate((chart, goal[None])), scene, height=_HEIGHT))
    out += _captions(drawing, play, times, points, bool(shown))
    out.append(commands.animation(tracks, frames / play.duration))
    return out


def _between(robot: RobotModel, time: Doubles, chart: Doubles, times: Doubles) -> Doubles:
    """Chart rows (F, nv) at ``times`` (F,) of rows (T, nv) at ``time`` (T,)."""
    return geometry.interpolated(robot.space, chart, time, times)


def _obstacles(
    drawing: Drawing, record: Record, scene: Scene, times: Doubles, tracks: list[Mapping[str, Any]]
) -> list[Command]:
    """Let obstacles move, with their trails, and be seen while they exist."""
    world, out = record.world, []
    frame = np.arange(len(times))
    moving = drawing.obstacles.moving(scene)
    trail = _TRAIL[: _MAX_TRAILS // max(len(moving), 1)]
    for obstacle in moving:
        path = drawing.obstacles.path(obstacle)
        tracks += playback.motion(path, frame, _poses(obstacle, times))
        begin = max(world.appears.get(str(obstacle.name), -np.inf), times[0])
        mesh = obstacle_mesh(obstacle)
        if mesh is None:
            continue
        for k, (lag, opacity) in enumerate(trail):
            behind = f"/playback/trails/{k}{path.removeprefix('/obstacles')}"
            look = commands.material(MOVING, opacity=opacity, depthWrite=False)
            out.append(commands.mesh(behind, mesh, look, cast=False))
            tracks += playback.motion(behind, frame, _poses(obstacle, np.maximum(times - lag, begin)))
            there = np.array([world.exists(str(obstacle.name), t) and t - lag > begin for t in times])
            tracks.append(playback.seen(behind, there))
    for name in {*world.appears, *world.vanishes}:
        there = np.array([world.exists(name, t) for t in times])
        tracks.append(playback.seen(drawing.obstacles.path(scene.obstacle(name)), there))
    return out


def _poses(obstacle: Obstacle, times: Doubles) -> geometry.Floats:
    return commands.columns(np.array([obstacle.at(float(t)).pose for t in times]))


def _traces(
    robot: RobotModel,
    record: Record,
    play: Replay,
    chart: Doubles,
    state: NDArray[np.uint8],
    hand: Doubles,
    tracks: list[Mapping[str, Any]],
) -> list[Command]:
    """Draw the reference as a thin line, and where base and hand have been so far, coloured by state."""
    out: list[Command] = []
    rows, base = record.control, np.column_stack((chart[:, :2], np.zeros(len(chart))))
    if robot.space.planar:
        inside = (rows.time >= play.begin) & (rows.time <= play.end) & np.isfinite(rows.reference).all(axis=1)
        nodes = rows.reference[inside]
        nodes = nodes[_spread(nodes[:, :2], _MAX_TRACE)]
        band = geometry.ribbon(robot.space, nodes, np.tile(hexcolor(_REFERENCE), (max(len(nodes) - 1, 0), 1)), 0.014)
        if band is not None:
            band.vertices[:, 2] = 0.02
            out.append(commands.mesh("/playback/trace/reference", band, commands.material(lit=False), cast=False))
    colors = np.array([hexcolor(_color(record, code)) for code in range(len(record.states))])
    for name, points in (("hand", hand), ("base", base)) if robot.space.planar else (("hand", hand),):
        chosen = _spread(points, _MAX_TRACE)
        if len(chosen) < 2:
            continue
        path, look = f"/playback/trace/{name}", commands.material(lit=False)
        rods = geometry.between(points[chosen[:-1]], points[chosen[1:]], 0.007 if name == "hand" else 0.016)
        out.append(commands.mesh(path, meshes.rod(), look, instances=len(rods), cast=False))
        out.append(commands.instances(path, rods, colors[state[chosen[:-1]]]))
        passed = np.searchsorted(chosen[1:], np.arange(len(chart)), side="right")
        tracks.append(playback.counted(path, passed))
    return out


def _spread(points: Doubles, count: int) -> NDArray[np.intp]:
    """At most ``count`` of points (N, d), at least a centimetre apart along their way, first and last among them."""
    along = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))))
    if not along[-1] > 0.005:
        return np.zeros(min(len(points), 1), dtype=np.intp)
    wanted = np.linspace(0.0, along[-1], int(np.clip(along[-1] / 0.01, 1, count - 1)) + 1)
    return np.unique(np.searchsorted(along, wanted - 1e-12))


def _ring(
    robot: RobotModel, record: Record, chart: Doubles, state: NDArray[np.uint8], tracks: list[Mapping[str, Any]]
) -> list[Command]:
    """Lay a ring about the base that shows where it heads, and the state by its colour."""
    place = np.tile(np.eye(4), (len(chart), 1, 1))
    if robot.space.planar:
        place[:, :2, 3] = chart[:, :2]
        c, s = np.cos(chart[:, 2]), np.sin(chart[:, 2])
        place[:, 0, 0], place[:, 0, 1], place[:, 1, 0], place[:, 1, 1] = c, -s, s, c
    place[:, 2, 3] = 0.012
    tracks += playback.motion("/playback/state", np.arange(len(chart)), commands.columns(place))
    out: list[Command] = []
    for code in np.unique(state).tolist():
        path = f"/playback/state/{code}"
        look = commands.material(hexcolor(_color(record, code)), opacity=0.85, lit=False)
        out.append(commands.mesh(path, meshes.ring(0.52, 0.6), look, cast=False))
        tracks.append(playback.seen(path, state == code))
    return out


def _strips(drawing: Drawing, play: Replay, times: Doubles, tracks: list[Mapping[str, Any]]) -> list[Command]:
    """Draw some of the strips, each to be seen until the next one."""
    planning = play.record.planning
    lengths = np.diff(planning.node_offset)
    there = np.flatnonzero((lengths > 1) & (planning.time <= play.end))
    late = np.flatnonzero(planning.time[there] <= play.begin)
    there = there[late[-1] if len(late) else 0 :]
    if not len(there):
        return []
    rows = there[np.unique(np.linspace(0, len(there) - 1, _MAX_STRIPS).round().astype(int))]
    poses, _ = drawing.prepare(play.robot)
    out: list[Command] = []
    for k, row in enumerate(rows.tolist()):
        nodes = planning.strip(row)
        nodes = nodes[np.unique(np.linspace(0, len(nodes) - 1, _MAX_NODES).round().astype(int))]
        poses.update(nodes)
        color = hexcolor(CERTIFIED if planning.certified[row] else REFUSED)
        path = f"/playback/strips/{k}"
        out += drawing.strip(path[1:], nodes, poses.points(), np.tile(color, (len(nodes) - 1, 1)))
        until = planning.time[rows[k + 1]] if k + 1 < len(rows) else np.inf
        tracks.append(playback.seen(path, (times >= planning.time[row]) & (times < until)))
    return out


def _captions(drawing: Drawing, play: Replay, times: Doubles, points: Doubles, strips: bool) -> list[Command]:
    """What the card says at each time."""
    record, planning = play.record, play.record.planning
    speed = np.linalg.norm(np.gradient(points, times, axis=0), axis=-1).max(axis=-1)
    codes = record.control.state
    moments = np.union1d(
        np.arange(play.begin, play.end, max(_CAPTION * play.speed, (play.end - play.begin) / 600)),
        record.control.time[1:][np.diff(codes.astype(int)) != 0],
    )
    moments = moments[(moments >= play.begin) & (moments <= play.end)]
    used = [record.states[code] for code in np.unique(codes).tolist()]
    legend = [[name, STATE_COLORS.get(name, UNCHECKED)] for name in used] + [["reference", _REFERENCE]]
    if strips:
        legend += [["strip certified", CERTIFIED], ["strip not certified", REFUSED]]
        legend.append(["threads, base to hand", f"linear-gradient(90deg, {BASE_THREAD}, {HAND_THREAD})"])
    cards = []
    for t in moments.tolist():
        code = int(codes[np.searchsorted(record.control.time, t + 1e-9, side="right") - 1])
        rows = [["time", f"{t:.1f} s"], ["fastest point", f"{np.interp(t, times, speed):.2f} m/s"]]
        row = planning.row_at(t)
        if row >= 0:
            if np.isfinite(planning.clearance[row]):
                rows.append(["clearance of the nodes", f"{planning.clearance[row]:.3f} m"])
            if np.isfinite(planning.tick_ms[row]):
                rows.append(["tick", f"{planning.tick_ms[row]:.1f} ms"])
        chip = [record.states[code], _color(record, code)]
        cards.append({"chip": chip, "rows": rows, "note": _note(record, t, row)})
    at = (moments - play.begin) / play.speed
    common = {"title": drawing.title, "legend": legend}
    return [commands.hud({**common, **cards[0]}), commands.captions(at, cards, common)]


def _note(record: Record, t: float, row: int) -> str:
    """The last event if it is fresh, else what the planner says."""
    fresh = [e for e in record.events if t - _EVENT < e.time <= t]
    if fresh:
        return f"{fresh[-1].kind}: {fresh[-1].reason}" if fresh[-1].reason else fresh[-1].kind
    return record.planning.reasons[record.planning.reason[row]] if row >= 0 else ""


def _color(record: Record, code: int) -> str:
    return STATE_COLORS.get(record.states[code], UNCHECKED)
