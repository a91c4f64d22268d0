"""Drawing: turns a snapshot (scene, strip, report) into commands, and sends only what changed since the last one."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from elastic_strips.arrays import Array, ArrayLike, Document
from elastic_strips.collision import Verdict
from elastic_strips.collision.contact_place import contact_place
from elastic_strips.errors import listed, plural
from elastic_strips.hulls import convex_hull
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Scene
from elastic_strips.strip.report import DeformReport, DeformStatus
from elastic_strips.summary import shortened

from . import commands, geometry, seen_replay
from .commands import Command
from .drawing_obstacles import NONE, ObstacleDrawing
from .geometry import Body, Floats, MeshData, RobotPoses, linear
from .path_report import PathReport
from .sensed import Seen, SeenDrawing

CERTIFIED, REFUSED, UNCHECKED = "#2f9e68", "#d64541", "#7f8fa3"
BASE_THREAD, HAND_THREAD = "#1f5f8b", "#f0902b"
THREADS = ["threads: paths of the arm, base to hand", f"linear-gradient(90deg, {BASE_THREAD}, {HAND_THREAD})"]
_MOTION, _UNCHECKED = ("certified motion", CERTIFIED), ("base's path, not checked", UNCHECKED)
_HATCHED = f"repeating-linear-gradient(135deg, {geometry.BARE} 0 3px, #a9b0b8 3px 6px)"
STATIC = ("/ghosts", "/strip", "/forces", "/trouble", "/predictions")
"""Parts of a still picture that an animation may hide."""
_TROUBLE, _FORCE, _GHOST, _HULL = "#b5002b", "#c2257a", "#3f7fb5", "#58a6c9"
_CHIP = {
    **{"settled": CERTIFIED, "deforming": "#b7791f", "broken": REFUSED, "blocked": REFUSED},
    **{"certified": CERTIFIED, "refuted": REFUSED, "unknown": "#b7791f"},  # a path
}
_MAX_HULLS = 600
_NOTEBOOK_FACES, _REPEATED_FACES = 14_000, 20_000  # faces of a robot in a notebook, and of one that is drawn many times
_MAX_NODES, _LIGHT_NODES = 100, 24  # of a strip between which threads are drawn; one that is stuck can have 500
_PIN_HEIGHT, _PIN_HEAD_RADIUS, _POLE_RADIUS = 1.9, 0.09, 0.02  # [m] of a tall robot's pin where its strip is broken
_SPOT_RADIUS, _PIN_ABOVE_SPOT = 0.16, 0.4  # [m] of the ball there, and from it to the pin's head at least
_LABEL_SHARE = 1.15  # of a pin's height, up to where its label may reach
_TALL, _LEAST_PIN_SCALE = 1.2, 0.3  # [m] up to where a tall robot's strip reaches; pins of lower ones are smaller
_BALL_RADIUS = 0.07  # [m] of the ball by which the hand is dragged
_MOST_LINKS = 3  # that are named together
_LONGEST_CARD_REASON, _LONGEST_PLACE_REASON = 400, 90  # characters of a reason, in the card and at the place

Report: TypeAlias = DeformReport | PathReport


@dataclass(frozen=True, slots=True)
class Snapshot:
    """A scene and a strip's nodes (N, nq) to draw, with the report about the strip if there is one.

    The robot stands at ``q`` (nq,), or at the first node where that is None, and its goal is ``goal`` (nq,), or the
    last node; the nodes are those of a certified ``motion``, or not; ``frame`` turns the camera to the strip.
    ``live`` is one of many pictures a second: slow measurements are left out. ``tick`` is the time of one tick
    [s]; ``notes`` are further rows of the card; ``seen`` is what sensors see.
    """

    robot: RobotModel
    scene: Scene
    nodes: Array
    report: Report | None = None
    frame: bool = False
    q: ArrayLike | None = None
    goal: ArrayLike | None = None
    motion: bool = False
    live: bool = False
    tick: float | None = None
    notes: tuple[tuple[str, str], ...] = ()
    seen: Seen | None = None


class Drawing:
    """The state of one picture that the browsers already have; used by one thread."""

    def __init__(self, *, title: str, ghosts: int) -> None:
        """Start with an empty picture.

        Args:
            title: Headline of the card in the corner.
            ghosts: Largest number of translucent robots along the strip.
        """
        self.title = title
        self.ghosts = ghosts
        self.hand = False  # whether there is a ball at the goal's, to be dragged
        self.robot: RobotModel | None = None
        self.bodies: tuple[Body, ...] = ()
        self.joints: list[int] = []  # that carry the bodies
        self.body_paths: list[str] = []  # where these are in the tree
        self.poses: RobotPoses | None = None
        self.obstacles: ObstacleDrawing = ObstacleDrawing()
        self.seen: SeenDrawing | None = None  # none before sensors see something
        self.playing: bool = False
        self.hidden: tuple[str, ...] = ()  # what is hidden by what plays
        self._made: set[str] = set()
        self._pin: Array | None = None  # where (3,) [m] its head is

    def draw(self, snapshot: Snapshot) -> list[Command]:
        """Return the commands that turn the picture into this snapshot."""
        poses, out = self.prepare(snapshot.robot)
        out += self.stop()
        out += self.obstacles.draw(snapshot.scene)
        out += self.obstacles.predictions(snapshot.scene)
        if snapshot.seen is not None and self.seen is None:
            self.seen = SeenDrawing()
        if self.seen is not None:
            out += self.seen.draw(snapshot.seen)
        coordinates = snapshot.robot.space.to_coordinates(snapshot.nodes)
        poses.update(coordinates)
        points = poses.points()
        matrices = poses.matrices(self.joints, geometry.spaced(points, self.ghosts))
        out += [commands.instances(f"/ghosts/{body.joint}", matrices[:, b]) for b, body in enumerate(self.bodies)]
        out += self.strip("/strip", coordinates, points, _colors(snapshot))
        out += self._ends(snapshot, coordinates, points)
        out += self._forces(snapshot.report)
        out += self._hulls(snapshot.report)
        out += self._trouble(snapshot.report, coordinates, snapshot.scene, float(points[..., 2].max(initial=0.0)))
        q = snapshot.nodes[0] if snapshot.q is None else np.asarray(snapshot.q)
        poses.update(snapshot.robot.space.to_coordinates(q)[None])
        out.append(commands.transforms("/robot", self.body_paths, poses.matrices(self.joints, [0])[0]))
        out.append(self.card(snapshot))
        if self._first("camera") or snapshot.frame:
            out.append(self.camera(coordinates, snapshot.scene))
        return out

    def prepare(self, robot: RobotModel) -> tuple[RobotPoses, list[Command]]:
        """Send the robot's bodies, once per robot."""
        if self.poses is not None and robot is self.robot:
            return self.poses, []
        self.robot, self.poses, self.bodies = robot, RobotPoses(robot), geometry.drawn_bodies(robot)
        self.joints = [body.joint for body in self.bodies]
        self.body_paths = [f"/robot/{joint}" for joint in self.joints]
        out = [commands.delete("/robot"), commands.delete("/ghosts")]
        out += self.robot_meshes()
        out.append(commands.names("/robot", self.body_paths, [_links_on(robot, joint) for joint in self.joints]))
        return self.poses, out

    def robot_meshes(self, *, coarse: bool = False) -> list[Command]:
        """The robot's bodies and its ghosts'; ``coarse`` ones are small enough for a notebook."""
        if self.robot is None:
            return []
        bodies = geometry.drawn_bodies(self.robot, faces=_NOTEBOOK_FACES) if coarse else self.bodies
        steps, look = 4095 if coarse else 65535, commands.material(roughness=0.55)
        out = [commands.mesh(p, b.mesh, look, steps=steps) for p, b in zip(self.body_paths, bodies, strict=True)]
        look = commands.material(linear(_GHOST), opacity=0.27, roughness=0.9)
        for body in geometry.drawn_bodies(
            self.robot, faces=_NOTEBOOK_FACES // 2 if coarse else _REPEATED_FACES, plain=True
        ):
            path = f"/ghosts/{body.joint}"
            ghosts = commands.mesh(path, body.mesh, look, instances=self.ghosts, cast=False, veiled=True, steps=steps)
            out.append(ghosts)
        return out

    def hide(self) -> list[Command]:
        """Hide the still picture while something plays."""
        self.hidden = STATIC
        return [commands.visible(path, False) for path in STATIC]

    def stop(self) -> list[Command]:
        """End playing and bring back what it hid."""
        if not self.playing:
            return []
        self.playing, self.hidden = False, ()
        shown = [commands.visible(path, True) for path in STATIC]
        self._made -= {path for path in self._made if path.startswith("/playback")}
        played = [commands.delete(path) for path in ("/playback", seen_replay.PATH)]
        return [commands.no_animation(), commands.captions([], [], {}), *played, *shown]

    def strip(
        self, path: str, coordinates: Array, points: Array, colors: Array, *, light: bool = False
    ) -> list[Command]:
        """Draw the paths of the control points and of the base below ``path``, the base's in ``colors`` (N - 1, 3).

        A ``light`` one is one of many in a page: less is sent of it, namely every other thread, between fewer nodes.
        """
        assert self.robot is not None
        if light:
            points = points[:, np.arange(points.shape[1] - 1, -1, -2)[::-1]]  # the hand's among them
        most = min(_LIGHT_NODES if light else _MAX_NODES, len(points))
        points = points[np.unique(np.linspace(0, len(points) - 1, most).round().astype(int))]
        out: list[Command] = []
        threads = f"{path}/threads"
        if self._first(threads):
            look = commands.material(roughness=0.8)
            out.append(commands.mesh(threads, geometry.rod(), look, instances=points.shape[1], cast=False))
        share = np.linspace(0.0, 1.0, points.shape[1])[:, None]
        shade = (1.0 - share) * np.array(linear(BASE_THREAD)) + share * np.array(linear(HAND_THREAD))
        out.append(commands.rods(threads, points, shade, 0.0055))
        band = geometry.ribbon(self.robot.space, coordinates, colors, height=0.004, steps=1 if light else 4)
        if band is not None:
            out.append(commands.mesh(f"{path}/base", band, commands.material(lit=False), cast=False))
        return out

    def camera(self, coordinates: Array, scene: Scene, *, height: float = 0.62) -> Command:
        """Look at the strip from the side, from a little behind its start, and from above, the more the higher."""
        assert self.poses is not None
        chosen = np.unique(np.linspace(0, len(coordinates) - 1, 24).round().astype(int))
        self.poses.update(coordinates[chosen])
        inside = []
        for b, T in enumerate(np.swapaxes(self.poses.matrices(self.joints), 0, 1).reshape(len(self.bodies), -1, 4, 4)):
            vertices = self.bodies[b].mesh.vertices
            low, high = vertices.min(axis=0), vertices.max(axis=0)
            corners = np.array(list(itertools.product(*zip(low, high, strict=True))))
            inside.append((corners @ T[:, :3, :3] + T[:, 3:, :3]).reshape(-1, 3))
        points = _outermost(np.concatenate(inside))
        low, high = points.min(axis=0), points.max(axis=0)
        for obstacle in scene:  # what stands next to the strip belongs in the picture as well
            at = obstacle.pose[:3, 3]
            if np.all(np.abs(at - (low + high) / 2) < (high - low) / 2 + 0.8):
                r = min(obstacle.reach, 0.6)
                points = np.vstack((points, np.maximum(at - r, [-np.inf, -np.inf, 0.0]), at + r))
        along = coordinates[-1, :2] - coordinates[0, :2] if self.poses.space.planar else np.zeros(2)
        if self._pin is not None:  # and its label above it
            points = np.vstack((points, self._pin, self._pin * [1.0, 1.0, _LABEL_SHARE]))
        length = float(np.linalg.norm(along))
        along = along / length if length > 0.3 else np.array([1.0, 0.0])
        view = np.array([along[1], -along[0]]) - 0.42 * along
        return commands.camera(points, [view[0], view[1], height])

    def card(self, snapshot: Snapshot) -> Command:
        """Fill the card in the corner."""
        report = snapshot.report
        moves = report is not None or len(snapshot.nodes) > 1
        head: Document = {"chip": None}
        rows: list[list[str]] = []
        legend: list[list[str]] = []
        if report is not None:
            head, legend = _chip(report, snapshot.live), self._colours(report)
            rows = _measured(report, snapshot.scene, snapshot.live)
        elif moves:
            rows, legend = [["nodes", str(len(snapshot.nodes))]], [list(_MOTION if snapshot.motion else _UNCHECKED)]
        if snapshot.tick is not None:
            rows.append(["tick", f"{1e3 * snapshot.tick:.1f} ms"])
        rows += [list(note) for note in snapshot.notes]
        if snapshot.scene.time:
            rows.append(["time", f"{snapshot.scene.time:.2f} s"])
        legend += [*([THREADS] if moves else []), *self._things(snapshot)]
        return commands.hud({"title": self.title, **head, "rows": rows, "legend": legend})

    def _colours(self, report: Report) -> list[list[str]]:
        """The legend of what is in a picture because of a report."""
        legend = [["certified", CERTIFIED], ["not certified", REFUSED]]
        if self._pin is not None:
            there = f"where the {_kind(report)} is {report.status.value}" if _bad(report) else "not certified here"
            legend.append([there, _TROUBLE])
        if report.forces is not None and len(report.forces.points):
            legend.append(["forces", _FORCE])
        if report.hulls is not None:
            legend.append(["protective hulls", _HULL])
        return legend

    def _things(self, snapshot: Snapshot) -> list[list[str]]:
        """The legend of what is in a picture besides the strip."""
        things = [[f"robot along the {_kind(snapshot.report)}", _GHOST]] if len(snapshot.nodes) > 1 else []
        things += bare_legend(snapshot.robot)
        if snapshot.robot.space.planar and len(snapshot.nodes) > 1:
            things += [["start", BASE_THREAD], ["goal", HAND_THREAD]]
        return things + self.obstacles.legend() + ([] if self.seen is None else self.seen.legend())

    def markers(self, coordinates: Array) -> list[Command]:
        """Lay rings where the first and the last of coordinate rows (N, nv) have their base."""
        assert self.robot is not None
        if not self.robot.space.planar:
            return []
        out: list[Command] = []
        if self._first("markers"):
            for name, color in (("start", BASE_THREAD), ("goal", HAND_THREAD)):
                look = commands.material(linear(color), opacity=0.85, lit=False)
                out.append(commands.mesh(f"/markers/{name}", geometry.ring(0.44, 0.5), look, cast=False))
            out.append(commands.names("/markers", ["/markers/start", "/markers/goal"], ["start", "goal"]))
        poses = np.tile(np.eye(4), (2, 1, 1))
        for T, (x, y, yaw) in zip(poses, coordinates[[0, -1], :3], strict=True):
            c, s = np.cos(yaw), np.sin(yaw)
            T[:2, :2], T[:3, 3] = [[c, -s], [s, c]], (x, y, 0.006)
        out.append(commands.transforms("/markers", ["/markers/start", "/markers/goal"], commands.columns(poses)))
        return out

    def _ends(self, snapshot: Snapshot, coordinates: Array, points: Array) -> list[Command]:
        """Mark where the strip begins, and the goal, which is where it ends or somewhere else."""
        ends, hand = coordinates[[0, -1]], points[-1]
        if snapshot.goal is not None and self.poses is not None:
            ends[1] = snapshot.robot.space.to_coordinates(np.asarray(snapshot.goal))
            self.poses.update(ends[1:])
            hand = self.poses.points()[0]
        return self.markers(ends) + (self.hand_ball(hand) if self.hand else [])

    def hand_ball(self, points: Array) -> list[Command]:
        """A ball about the last of places (C, 3) at the goal, where the hand is to be; none without places."""
        if not len(points):
            return []
        out, path = [], "/markers/hand"
        if self._first("hand"):
            look = commands.material(linear(HAND_THREAD), opacity=0.55, hides=False)
            out.append(commands.mesh(path, geometry.sphere().scaled(np.full(3, _BALL_RADIUS)), look, cast=False))
            out.append(commands.names(path, [path], ["hand at the goal"]))
        T = np.eye(4)
        T[:3, 3] = points[-1]
        return [*out, commands.transforms(path, [path], commands.columns(T[None]))]

    def _forces(self, report: Report | None) -> list[Command]:
        forces = None if report is None else report.forces
        arrows = None if forces is None else geometry.arrows(forces.points, forces.vectors)
        return self._many("/forces", geometry.arrow(), commands.material(linear(_FORCE)), arrows)

    def _hulls(self, report: Report | None) -> list[Command]:
        """Draw the protective hulls; they are many, so the page hides them until they are asked for."""
        matrices = None
        if report is not None and report.hulls is not None:
            every = max(1, -(-report.hulls.radius.size // _MAX_HULLS))
            radii = report.hulls.radius[::every].reshape(-1)
            keep = np.isfinite(radii) & (radii > 0.0)
            matrices = geometry.spheres(report.hulls.points[::every].reshape(-1, 3)[keep], radii[keep])
        look = commands.material(linear(_HULL), opacity=0.07, hides=False)
        return self._many("/hulls", geometry.sphere(16), look, matrices)

    def _trouble(self, report: Report | None, coordinates: Array, scene: Scene, tall: float) -> list[Command]:
        """Put a pin where the strip is broken or blocked: a ball about the place, and a pole that is seen from afar.

        ``tall`` is how high [m] the strip's points reach.
        """
        assert self.robot is not None
        assert self.poses is not None
        spot = None if report is None else _trouble_spot(self.robot, report, coordinates, self.poses, scene)
        self._pin = ball = head = pole = None
        label = np.zeros((0, 3))
        if spot is not None:
            scale = float(np.clip(tall / _TALL, _LEAST_PIN_SCALE, 1.0))
            foot = spot * [1.0, 1.0, 0.0]
            self._pin = top = np.array([*spot[:2], max(scale * _PIN_HEIGHT, spot[2] + scale * _PIN_ABOVE_SPOT)])
            ball, head = geometry.spheres(spot, scale * _SPOT_RADIUS), geometry.spheres(top, scale * _PIN_HEAD_RADIUS)
            pole = geometry.between(foot[None], top[None], scale * _POLE_RADIUS)
            label = np.array([[*top[:2], top[2] + scale * _PIN_HEAD_RADIUS]])
        clear, solid = (
            commands.material(linear(_TROUBLE), opacity=opacity, lit=False, hidden=False) for opacity in (0.45, 0.95)
        )  # it stands inside what is touched
        reason = "" if report is None else report.reason or "not certified here"
        return [
            commands.labels("/trouble", [shortened(reason, _LONGEST_PLACE_REASON)] * len(label), label),
            *self._many("/trouble/spot", geometry.sphere(), clear, ball, room=1),
            *self._many("/trouble/head", geometry.sphere(), solid, head, room=1),
            *self._many("/trouble/pole", geometry.rod(), solid, pole, room=1),
        ]

    def _many(
        self, path: str, mesh: MeshData, look: Document, matrices: Floats | None, *, room: int = 64
    ) -> list[Command]:
        """Draw a mesh at (K, 16) matrices, nowhere where that is None; it is sent when it is first needed."""
        if matrices is None and path not in self._made:
            return []
        out = [commands.mesh(path, mesh, look, instances=room, cast=False)] if self._first(path) else []
        return [*out, commands.instances(path, NONE if matrices is None else matrices)]

    def _first(self, name: str) -> bool:
        """Whether this is the first time that something is drawn."""
        first = name not in self._made
        self._made.add(name)
        return first


def _outermost(points: Array) -> Array:
    """The corners of the convex hull of points (K, 3), which are in a picture where they are; all, of a flat one."""
    from scipy.spatial import QhullError  # late: slow to import

    try:
        return points[convex_hull(points).vertices]
    except QhullError:
        return points


def _links_on(robot: RobotModel, joint: int) -> str:
    """The links that a joint carries, or the first few of them."""
    links = list(dict.fromkeys(link for piece in robot.geometries if piece.joint == joint for link in piece.links))
    return listed(links, _MOST_LINKS) or robot.name


def _bad(report: Report) -> bool:
    return report.status in (DeformStatus.BROKEN, DeformStatus.BLOCKED, Verdict.REFUTED, Verdict.UNKNOWN)


def _chip(report: Report, live: bool) -> Document:
    """The state in a word and a colour, and a note that says why where it is not as it is to be."""
    status, note = report.status.value, shortened(report.reason, _LONGEST_CARD_REASON)
    if not live:
        chip = [status, _CHIP[status]]
        return {"chip": chip, "note": note} if _bad(report) else {"chip": chip}
    if report.certificate.certified:  # this is what one looks for; a note that is not always there moves the rows
        return {"chip": ["certified", CERTIFIED], "note": note if _bad(report) else ""}
    return {"chip": ["not certified", REFUSED], "note": note}


def _measured(report: Report, scene: Scene, live: bool) -> list[list[str]]:
    """The rows of a card about a report."""
    segments, clearance = report.certificate.segments, report.node_clearance if live else report.clearance
    rows = [["state", report.status.value]] if live else []
    if np.isfinite(clearance):
        of_what = " to obstacles" if getattr(report.certificate.broken, "kind", "") == "self" else ""
        rows.append([f"clearance{' at the nodes' * live}{of_what}", f"{clearance:.3f} m"])
    done, of = report.segments if isinstance(report, PathReport) else (int(segments.sum()), len(segments))
    rows.append(["certified", f"{done} of {plural(of, 'segment')}"])
    return [*rows, ["what moves", f"as at {scene.time:g} s"]] if report.as_it_stands else rows


def bare_legend(robot: RobotModel) -> list[list[str]]:
    """The legend of hatched links, about which nothing is proven."""
    return [["no collision shape: nothing is proven", _HATCHED]] if robot.bare_links else []


def _colors(snapshot: Snapshot) -> Array:
    """Colours (N - 1, 3) of the segments between a snapshot's nodes."""
    count = len(snapshot.nodes) - 1
    return np.tile(linear(CERTIFIED), (count, 1)) if snapshot.motion else segment_colors(snapshot.report, count)


def segment_colors(report: Report | None, count: int) -> Array:
    """Colours (count, 3) of the segments: certified, not certified, or not checked at all.

    A report may have the certificate of the strip before its own, while a motion alone is planned again.
    """
    if report is None or len(report.certificate.segments) != count:
        return np.tile(linear(UNCHECKED), (count, 1))
    return np.where(report.certificate.segments[:, None], linear(CERTIFIED), linear(REFUSED))


def _kind(report: Report | None) -> str:
    """What a report is about."""
    return "path" if isinstance(report, PathReport) else "strip"


def _trouble_spot(
    robot: RobotModel, report: Report, coordinates: Array, poses: RobotPoses, scene: Scene
) -> Array | None:
    """Where (3,) [m] the worst segment is: between the hulls that do not connect, or where the link is not clear.

    None where nothing is known to be wrong. Leaves ``poses`` there, or in the middle of the segment.
    """
    hulls, broken = report.hulls, report.certificate.broken
    if hulls is not None and report.connectivity_counts and not hulls.connected.all():
        j, c = np.unravel_index(int(np.argmin(hulls.overlap)), hulls.overlap.shape)
        return 0.5 * (hulls.points[j, c] + hulls.points[j + 1, c])
    if broken is None or not 0 <= broken.segment < len(coordinates) - 1:
        return None
    ends = coordinates[broken.segment : broken.segment + 2]
    place = report.place if isinstance(report, PathReport) else None
    there = robot.space.interpolate(ends[:1], ends[1:], np.array([0.5 if place is None else place]))
    poses.update(there)
    if (touched := contact_place(robot, robot.space.from_coordinates(there)[0], broken, scene)) is not None:
        return touched
    piece = next((piece for piece in robot.geometries if piece.name == broken.link), None)
    if piece is None:
        return poses.points()[0, 0]
    middle = np.eye(4)
    middle[:3, 3] = 0.5 * (piece.capsule.a + piece.capsule.b)
    pose = poses.matrices([piece.joint])[0, 0].reshape(4, 4).T @ robot.tree.to_aligned(piece.joint, middle)
    return np.asarray(pose[:3, 3], dtype=float)
