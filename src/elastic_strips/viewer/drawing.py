"""Drawing: turns a snapshot (scene, strip, report) into commands, and sends only what changed since the last one."""

from __future__ import annotations

import itertools
import re
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from elastic_strips.robot import RobotModel
from elastic_strips.scene import Scene
from elastic_strips.viewer import commands, geometry, meshes
from elastic_strips.viewer.bodies import Body, ghost_bodies, robot_bodies
from elastic_strips.viewer.commands import Command
from elastic_strips.viewer.geometry import Doubles, Poses
from elastic_strips.viewer.meshes import linear
from elastic_strips.viewer.obstacles import Obstacles
from elastic_strips.viewer.trouble import trouble_spot

CERTIFIED, REFUSED, UNCHECKED = "#2f9e68", "#d64541", "#7f8fa3"
TROUBLE = "#b5002b"
FORCE, GHOST, HULL, BASE_THREAD, HAND_THREAD = "#c2257a", "#3f7fb5", "#58a6c9", "#1f5f8b", "#f0902b"
_BAD = ("BROKEN", "BLOCKED")
_CHIP = {"SETTLED": CERTIFIED, "DEFORMING": "#b7791f", "BROKEN": REFUSED, "BLOCKED": REFUSED}
_MAX_HULLS = 600
_PIN, _SPOT, _HEAD, _POLE = 1.9, 0.16, 0.09, 0.02  # height of the pin, radii [m]
_MOST = 400  # characters of a reason
STILL = ("/ghosts", "/strip", "/forces", "/trouble")
"""What a picture shows and what plays may have to hide."""


@dataclass(frozen=True, slots=True)
class Snapshot:
    """What is to be drawn: a scene and a strip, with the report about it where there is one.

    The robot stands at ``q`` (nq,), or at the first node where that is None; ``frame`` turns the camera to the strip.
    ``live`` is one of many pictures a second: what takes long to measure is left out.
    """

    robot: RobotModel
    scene: Scene
    strip: Any
    report: Any = None
    frame: bool = False
    q: Any = None
    live: bool = False


def hexcolor(color: str) -> tuple[float, float, float]:
    """Turn ``"#rrggbb"`` into linear RGB."""
    return linear(int(color[1:], 16))


class Drawing:
    """The state of one picture: what the browsers already have; used by one thread."""

    def __init__(self, *, title: str, ghosts: int) -> None:
        """Start with an empty picture.

        Args:
            title: Headline of the card in the corner.
            ghosts: Largest number of translucent robots along the strip.
        """
        self.title = title
        self.ghosts = ghosts
        self.robot: RobotModel | None = None
        self.bodies: tuple[Body, ...] = ()
        self.poses: Poses | None = None
        self.obstacles = Obstacles()
        self.playing = False
        self._made: set[str] = set()
        self._pinned = False

    def draw(self, snapshot: Snapshot) -> list[Command]:
        """Return the commands that turn the picture into this snapshot."""
        poses, out = self.prepare(snapshot.robot)
        out += self.stop()
        out += self.obstacles.draw(snapshot.scene)
        chart = snapshot.robot.space.to_chart(np.asarray(snapshot.strip.q))
        poses.update(chart)
        points = poses.points()
        out += self._ghosts(poses, points)
        out += self.strip("strip", chart, points, segment_colors(snapshot.report, len(chart)))
        out += self.markers(chart)
        out += self._forces(snapshot.report)
        out += self._tunnel(snapshot.report, points)
        out += self._trouble(snapshot.report, chart)
        if snapshot.q is not None:
            poses.update(snapshot.robot.space.to_chart(np.asarray(snapshot.q))[None])
        out.append(self.robot_at(poses.matrices(self.joints, [0])[0]))
        out.append(self.card(snapshot))
        if snapshot.frame or "camera" not in self._made:
            self._made.add("camera")
            out.append(self.camera(chart, snapshot.scene))
        return out

    @property
    def joints(self) -> list[int]:
        """The joints that carry the bodies."""
        return [body.joint for body in self.bodies]

    @property
    def body_paths(self) -> list[str]:
        """Where the bodies of the robot are in the tree."""
        return [f"/robot/{body.joint}" for body in self.bodies]

    def prepare(self, robot: RobotModel) -> tuple[Poses, list[Command]]:
        """Send the robot's bodies, once per robot."""
        if self.poses is not None and robot is self.robot:
            return self.poses, []
        self.robot, self.poses, self.bodies = robot, Poses(robot), robot_bodies(robot)
        out = [commands.delete("/robot"), commands.delete("/ghosts")]
        look = commands.material(roughness=0.55)
        out += [commands.mesh(p, b.mesh, look) for p, b in zip(self.body_paths, self.bodies, strict=True)]
        look = commands.material(hexcolor(GHOST), opacity=0.27, roughness=0.9)
        for body in ghost_bodies(self.bodies):
            out.append(
                commands.mesh(f"/ghosts/{body.joint}", body.mesh, look, instances=self.ghosts, cast=False, veiled=True)
            )
        return self.poses, out

    def stop(self) -> list[Command]:
        """End what plays and bring back what it hid."""
        if not self.playing:
            return []
        self.playing = False
        shown = [commands.visible(path, True) for path in STILL]
        self._made -= {path for path in self._made if path.startswith("/playback")}
        return [commands.no_animation(), commands.captions([], [], {}), commands.delete("/playback"), *shown]

    def robot_at(self, matrices: geometry.Floats) -> Command:
        """Move the solid robot: (B, 16) matrices."""
        return commands.transforms("/robot", self.body_paths, matrices)

    def strip(self, path: str, chart: Doubles, points: Doubles, colors: Doubles) -> list[Command]:
        """Draw the way of the control points and of the base."""
        out: list[Command] = []
        threads = f"/{path}/threads"
        if threads not in self._made:
            self._made.add(threads)
            look = commands.material(roughness=0.8)
            out.append(commands.mesh(threads, meshes.rod(), look, instances=points.shape[1], cast=False))
        matrices = geometry.threads(points, 0.0055)
        share = np.linspace(0.0, 1.0, points.shape[1])[:, None]
        shade = (1.0 - share) * np.array(hexcolor(BASE_THREAD)) + share * np.array(hexcolor(HAND_THREAD))
        out.append(commands.instances(threads, matrices, np.repeat(shade, len(points) - 1, axis=0)))
        assert self.robot is not None
        band = geometry.ribbon(self.robot.space, chart, colors)
        if band is not None:
            band.vertices[:, 2] = 0.004
            out.append(commands.mesh(f"/{path}/base", band, commands.material(lit=False), cast=False))
        return out

    def camera(self, chart: Doubles, scene: Scene, *, height: float = 0.62) -> Command:
        """Look at the strip from the side, from a little behind its start, and from above, the more the higher."""
        assert self.poses is not None
        chosen = np.unique(np.linspace(0, len(chart) - 1, 24).round().astype(int))
        self.poses.update(chart[chosen])
        inside = []
        for b, T in enumerate(np.swapaxes(self.poses.matrices(self.joints), 0, 1).reshape(len(self.bodies), -1, 4, 4)):
            vertices = self.bodies[b].mesh.vertices
            low, high = vertices.min(axis=0), vertices.max(axis=0)
            corners = np.array(list(itertools.product(*zip(low, high, strict=True))))
            inside.append((corners @ T[:, :3, :3] + T[:, 3:, :3]).reshape(-1, 3))
        points = np.concatenate(inside)
        low, high = points.min(axis=0), points.max(axis=0)
        for obstacle in scene:  # what stands next to the strip belongs in the picture as well
            at = obstacle.pose[:3, 3]
            if np.all(np.abs(at - (low + high) / 2) < (high - low) / 2 + 0.8):
                r = min(obstacle.reach, 0.6)
                points = np.vstack((points, np.maximum(at - r, [-np.inf, -np.inf, 0.0]), at + r))
        along = chart[-1, :2] - chart[0, :2] if self.poses.space.planar else np.zeros(2)
        length = float(np.linalg.norm(along))
        along = along / length if length > 0.3 else np.array([1.0, 0.0])
        view = np.array([along[1], -along[0]]) - 0.42 * along
        return commands.camera(points, [view[0], view[1], height])

    def card(self, snapshot: Snapshot) -> Command:
        """Fill the card in the corner."""
        report, rows, chip = snapshot.report, [], None
        nodes = len(snapshot.strip.q)
        if report is not None:
            status = re.sub(r"^.*\.", "", str(getattr(report.status, "name", report.status))).upper()
            chip = [status.lower(), _CHIP.get(status, UNCHECKED)]
            clearance = report.node_clearance if snapshot.live else report.clearance
            if np.isfinite(clearance):
                rows.append(["clearance of the nodes" if snapshot.live else "clearance", f"{clearance:.3f} m"])
            segments = checked(report, nodes)
            if segments is not None:
                rows.append(["certified", f"{int(segments.sum())} of {len(segments)} segments"])
            legend = [["certified", CERTIFIED], ["not certified", REFUSED]]
            if self._pinned:
                legend.append([f"where it is {status.lower()}" if status in _BAD else "not clear here", TROUBLE])
            if getattr(report, "forces", None) is not None and len(report.forces.points):
                legend.append(["forces", FORCE])
        else:
            rows.append(["nodes", str(nodes)])
            legend = [["base, not checked", UNCHECKED]]
        if snapshot.scene.time:
            rows.append(["time", f"{snapshot.scene.time:.2f} s"])
        legend.append(["threads, base to hand", f"linear-gradient(90deg, {BASE_THREAD}, {HAND_THREAD})"])
        bad = report is not None and chip is not None and chip[0].upper() in _BAD
        note = {"note": str(getattr(report, "reason", ""))[:_MOST]} if bad else {}
        return commands.hud({"title": self.title, "chip": chip, "rows": rows, "legend": legend, **note})

    def _ghosts(self, poses: Poses, points: Doubles) -> list[Command]:
        matrices = poses.matrices(self.joints, geometry.spaced(points, self.ghosts))
        return [commands.instances(f"/ghosts/{body.joint}", matrices[:, b]) for b, body in enumerate(self.bodies)]

    def markers(self, chart: Doubles) -> list[Command]:
        """Lay rings where the first and the last of chart rows (N, nv) have their base."""
        assert self.robot is not None
        if not self.robot.space.planar:
            return []
        out: list[Command] = []
        if "markers" not in self._made:
            self._made.add("markers")
            for name, color in (("start", BASE_THREAD), ("goal", HAND_THREAD)):
                look = commands.material(hexcolor(color), opacity=0.85, lit=False)
                out.append(commands.mesh(f"/markers/{name}", meshes.ring(0.44, 0.5), look, cast=False))
        poses = np.tile(np.eye(4), (2, 1, 1))
        for T, (x, y, yaw) in zip(poses, chart[[0, -1], :3], strict=True):
            c, s = np.cos(yaw), np.sin(yaw)
            T[:2, :2], T[:3, 3] = [[c, -s], [s, c]], (x, y, 0.006)
        out.append(commands.transforms("/markers", ["/markers/start", "/markers/goal"], commands.columns(poses)))
        return out

    def _forces(self, report: Any) -> list[Command]:
        forces = getattr(report, "forces", None)
        if forces is None and "forces" not in self._made:
            return []
        out: list[Command] = []
        if "forces" not in self._made:
            self._made.add("forces")
            out.append(
                commands.mesh("/forces", meshes.arrow(), commands.material(hexcolor(FORCE)), instances=64, cast=False)
            )
        none = np.zeros((0, 16), dtype=np.float32)
        out.append(
            commands.instances("/forces", none if forces is None else geometry.arrows(forces.points, forces.vectors))
        )
        return out

    def _tunnel(self, report: Any, points: Doubles) -> list[Command]:
        found = hulls(report, points)
        if found is None and "tunnel" not in self._made:
            return []
        out: list[Command] = []
        if "tunnel" not in self._made:
            self._made.add("tunnel")
            look = commands.material(hexcolor(HULL), opacity=0.07, depthWrite=False)
            out.append(commands.mesh("/tunnel", meshes.sphere(16), look, instances=64, cast=False))
            out.append(commands.visible("/tunnel", False))  # many: the viewer's controls show them on demand
        if found is None:
            return [*out, commands.instances("/tunnel", np.zeros((0, 16)))]
        points, radii = found
        every = max(1, -(-radii.size // _MAX_HULLS))
        centers, radii = points[::every].reshape(-1, 3), radii[::every].reshape(-1)
        keep = np.isfinite(radii) & (radii > 0.0)
        return [*out, commands.instances("/tunnel", geometry.spheres(centers[keep], radii[keep]))]

    def _trouble(self, report: Any, chart: Doubles) -> list[Command]:
        """Put a pin where the strip is broken or blocked: a ball about the place, and a pole that is seen from afar."""
        assert self.robot is not None
        assert self.poses is not None
        spot = trouble_spot(self.robot, report, chart, self.poses)
        self._pinned = spot is not None
        if spot is None and "trouble" not in self._made:
            return []
        out: list[Command] = []
        if "trouble" not in self._made:
            self._made.add("trouble")
            clear, solid = (commands.material(hexcolor(TROUBLE), opacity=o, lit=False) for o in (0.45, 0.95))
            out.append(commands.mesh("/trouble/spot", meshes.sphere(), clear, instances=1, cast=False))
            out.append(commands.mesh("/trouble/head", meshes.sphere(), solid, instances=1, cast=False))
            out.append(commands.mesh("/trouble/pole", meshes.rod(), solid, instances=1, cast=False))
        spots = np.zeros((0, 3)) if spot is None else spot[None]
        heads = spots * [1.0, 1.0, 0.0] + [0.0, 0.0, _PIN]
        feet = spots * [1.0, 1.0, 0.0]
        out.append(commands.instances("/trouble/spot", geometry.spheres(spots, np.full(len(spots), _SPOT))))
        out.append(commands.instances("/trouble/head", geometry.spheres(heads, np.full(len(spots), _HEAD))))
        out.append(commands.instances("/trouble/pole", geometry.between(feet, heads, _POLE)))
        return out


def checked(report: Any, nodes: int) -> NDArray[np.bool_] | None:
    """Which of the segments are certified, (N - 1,); None if nobody looked."""
    certificate = getattr(report, "certificate", None)
    segments = None if certificate is None else np.asarray(certificate.segments, dtype=bool)
    return segments if segments is not None and len(segments) == nodes - 1 else None


def hulls(report: Any, points: Doubles) -> tuple[Doubles, Doubles] | None:
    """Centres (N, C, 3) and radii (N, C) [m] of a report's protective hulls; None where it has none."""
    tunnel = getattr(report, "tunnel", None)
    if tunnel is not None:
        return np.asarray(tunnel.points, dtype=float), np.asarray(tunnel.radius, dtype=float)
    radii = getattr(report, "hull_radius", None)
    return None if radii is None else (points, np.asarray(radii, dtype=float))


def segment_colors(report: Any, nodes: int) -> Doubles:
    """Colours (N - 1, 3) of the segments: certified, not certified, or not checked at all."""
    segments = checked(report, nodes)
    if segments is None:
        return np.tile(np.array(hexcolor(UNCHECKED)), (max(nodes - 1, 0), 1))
    return np.where(segments[:, None], np.array(hexcolor(CERTIFIED)), np.array(hexcolor(REFUSED)))
