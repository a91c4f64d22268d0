"""Playback: a recorded animation of a robot that drives along a strip, while obstacles move and the strip gives way."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from elastic_strips.errors import InputError, RobotError, SceneError
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Scene
from elastic_strips.viewer import commands, geometry
from elastic_strips.viewer.commands import Command
from elastic_strips.viewer.drawing import STILL, Drawing, Snapshot, segment_colors
from elastic_strips.viewer.geometry import Doubles, Floats

from ..validation import check_number, check_type, shown

_FPS, _MAX_FRAMES, _MAX_STRIPS = 30.0, 900, 24


@dataclass(frozen=True, slots=True)
class Path:
    """Bare configurations (N, nq) where a strip is expected."""

    q: Doubles


@dataclass(frozen=True, slots=True)
class Playback:
    """What is to be played.

    Attributes:
        robot: Who drives.
        scene: The scene at the beginning; obstacles with a motion move.
        strips: Strips (or paths), evenly spread over the duration; one that does not change is enough.
        reports: A report or None for each of them.
        duration: How long it takes [s].
    """

    robot: RobotModel
    scene: Scene
    strips: tuple[Any, ...]
    reports: tuple[Any, ...]
    duration: float


def playback(robot: RobotModel, scene: Scene, subject: Any, duration: float) -> Playback:
    """Check what the caller wants to see and put it in order.

    Raises:
        InputError: Nothing to play, a duration that is not positive, or nodes of the wrong size.
    """
    check_type("robot", robot, RobotModel, RobotError)
    check_type("scene", scene, Scene, SceneError)
    check_number("duration", duration, above=0.0, high=3600.0, unit="s")
    if isinstance(subject, np.ndarray) or hasattr(subject, "q") or hasattr(subject, "strip"):
        subject = [subject]
    if not isinstance(subject, Iterable) or isinstance(subject, (str, bytes)):
        raise InputError(f"a strip, a report, a path (N, nq) or a sequence of them is played, not {shown(subject)}")
    strips, reports = [], []
    for item in subject:
        report = item if hasattr(item, "strip") else None
        strip = item.strip if report is not None else item
        strip = strip if hasattr(strip, "q") else _path(strip)
        if strip.q.ndim != 2 or not len(strip.q) or strip.q.shape[1] != robot.nq:
            raise InputError(f"a path has shape {strip.q.shape}; {robot.name!r} wants (N, {robot.nq}) with N >= 1")
        strips.append(strip)
        reports.append(report)
    if not strips:
        raise InputError("there is no strip to play; give a strip, a report, a path (N, nq) or a sequence of them")
    return Playback(robot, scene, tuple(strips), tuple(reports), float(duration))


def _path(nodes: Any) -> Path:
    try:
        return Path(np.asarray(nodes, dtype=float))
    except (TypeError, ValueError):
        raise InputError(f"this is neither a strip nor a report nor configurations (N, nq): {shown(nodes)}") from None


def draw(drawing: Drawing, play: Playback, *, frame: bool = True) -> list[Command]:
    """Return the commands that show the first moment and play the rest."""
    space = play.robot.space
    out = drawing.draw(Snapshot(play.robot, play.scene, play.strips[0], play.reports[0], frame))
    poses, _ = drawing.prepare(play.robot)
    drawing.playing = True
    frames = int(np.clip(round(play.duration * _FPS), 2, _MAX_FRAMES))
    fps = frames / play.duration
    share = np.linspace(0.0, 1.0, frames + 1)
    times = np.arange(frames + 1)

    charts = [space.to_chart(np.asarray(strip.q)) for strip in play.strips]
    chart = _driven(poses, space, charts, share)
    poses.update(chart)
    matrices = poses.matrices(drawing.joints)
    tracks: list[Mapping[str, Any]] = []
    for b, path in enumerate(drawing.body_paths):
        tracks += motion(path, times, matrices[:, b])
    for obstacle in drawing.obstacles.moving(play.scene):
        there = [obstacle.at(play.scene.time + s * play.duration).pose for s in share]
        tracks += motion(drawing.obstacles.path(obstacle), times, commands.columns(np.array(there)))
    if len(charts) > 1:
        out += [commands.visible(path, False) for path in STILL]
        out += _strips(drawing, play, charts, tracks, frames)
    if frame:
        out.append(drawing.camera(np.concatenate(charts), play.scene))
    out.append(commands.animation(tracks, fps))
    return out


def _driven(poses: geometry.Poses, space: Any, charts: Sequence[Doubles], share: Doubles) -> Doubles:
    """Where the robot is in each frame: chart rows (F, nv).

    It drives along the strip; if the strips of a sequence begin where the robot is, it is there.
    """
    places, starts = [], []
    for chart in charts:
        poses.update(chart)
        places.append(geometry.arc_length(poses.points()))
        starts.append(chart[0])
    follows = len(charts) > 1 and float(np.abs(np.diff(starts, axis=0)).max()) > 1e-4
    place = share * (len(charts) - 1)
    index = np.minimum(place.astype(int), max(len(charts) - 2, 0))
    eased = share * share * (3.0 - 2.0 * share)

    def at(which: int, s: float) -> Doubles:
        if follows:
            return charts[which][0]
        where = np.array([s * places[which][-1]])
        return geometry.interpolated(space, charts[which], places[which], where)[0]

    if len(charts) == 1:
        return geometry.interpolated(space, charts[0], places[0], eased * places[0][-1])
    before = np.array([at(int(i), float(s)) for i, s in zip(index, eased, strict=True)])
    after = np.array([at(int(i) + 1, float(s)) for i, s in zip(index, eased, strict=True)])
    return space.interpolate(before, after, place - index)


def _strips(
    drawing: Drawing, play: Playback, charts: Sequence[Doubles], tracks: list[Mapping[str, Any]], frames: int
) -> list[Command]:
    """Draw some of the strips and let each be seen in its turn."""
    poses, _ = drawing.prepare(play.robot)
    count = min(len(charts), _MAX_STRIPS)
    chosen = np.unique(np.linspace(0, len(charts) - 1, count).round().astype(int))
    begins = np.round(chosen / (len(charts) - 1) * frames).astype(int)
    out: list[Command] = []
    for k, which in enumerate(chosen):
        path = f"/playback/{k}"
        poses.update(charts[which])
        colors = segment_colors(play.reports[which], len(charts[which]))
        out += drawing.strip(path[1:], charts[which], poses.points(), colors)
        out.append(commands.visible(path, k == 0))
        end = begins[k + 1] if k + 1 < len(chosen) else frames + 1
        times = np.arange(frames + 1)
        tracks.append(seen(path, (times >= begins[k]) & (times < end)))
    return out


def seen(path: str, there: NDArray[np.bool_]) -> Mapping[str, Any]:
    """The track that shows an object in the frames (F,) in which it is ``there``, and hides it in the others.

    It is as long as the others that have F frames, because each repeats by itself.
    """
    times = np.union1d(np.flatnonzero(np.diff(there)) + 1, [0, len(there) - 1])
    return {"path": path, "property": "visible", "type": "bool", "times": times, "values": there[times]}


def counted(path: str, count: NDArray[np.intp]) -> Mapping[str, Any]:
    """The track that draws the first ``count`` (F,) instances of an object in each frame."""
    times = np.arange(len(count))
    return {"path": path + "/<object>", "property": "count", "type": "number", "times": times, "values": count}


def motion(path: str, times: ArrayLike, matrices: Floats) -> list[Mapping[str, Any]]:
    """Tracks of position and orientation through (F, 16) column-major matrices."""
    from scipy.spatial.transform import Rotation  # late: slow to import

    T = np.swapaxes(matrices.reshape(-1, 4, 4), -1, -2)
    quaternion = Rotation.from_matrix(T[:, :3, :3]).as_quat()
    flips = np.cumprod(np.where(np.einsum("ij,ij->i", quaternion[1:], quaternion[:-1]) < 0.0, -1.0, 1.0))
    quaternion[1:] *= flips[:, None]
    same = {"path": path, "times": times}
    return [
        {**same, "property": "position", "type": "vector3", "values": T[:, :3, 3]},
        {**same, "property": "quaternion", "type": "quaternion", "values": quaternion},
    ]
