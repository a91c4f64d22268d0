"""Strict carving, compared with the truth: what the map of images calls free, on surfaces that are known otherwise.

A voxel that holds a point of a true surface must never be free. The points are made here, on the triangles of the
pieces' hulls; of the map nothing is asked but what it says of a point. Recorded clouds know no truth but themselves:
a part of their pixels is shown to the map, and the others tell what it must not have called free.
"""

from __future__ import annotations

import gc
import json
import math
import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from time import thread_time

import numpy as np
import pinocchio as pin
from scipy import spatial

from elastic_strips.arrays import Array, Image, Mask
from elastic_strips.errors import ParameterError
from elastic_strips.io import read_point_cloud
from elastic_strips.perception import BodyMask, DepthImage, SceneEstimator, VolumeMap, VolumeMapParams
from elastic_strips.robot import RobotModel
from elastic_strips.scene import Scene, Voxels, World
from elastic_strips.sim.sensors import DepthParams, SensorConfig, SensorSuite
from elastic_strips.sim.sensors.devices import noisy_image
from workshop.datasets import house_scene, load_house

from .measure import Figures, Note, head, percentiles, resident, silent

_FINEST = 0.5 * VolumeMapParams().cell  # [m] edge of the smallest voxels that the map frees
_DENSITY = 4e4  # points on a square metre of a surface: 25 for each of these that it crosses
_PANS, _TILTS = (-1.1, -0.55, 0.0, 0.55, 1.1), (-0.3, -0.75)  # [rad] of the head; the first look is between them
_REACHING = ("arm_4_link", "arm_5_link", "arm_tool_link", "hand_tool_link")  # TIAGo's frames that take up its reach
_FRAME = "xtion_depth_optical_frame"
_LOW = 0.1  # [m] below which the reach does not count
_RATE = 15.0  # [Hz] of images in a long run
_TURN = 150  # images of a turn at one place
_BANDS = (0.0, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0)  # [m] distances that held-out points are counted by

_KEYS = np.array([1.0, 1e4, 1e8])  # one number of the three of a voxel

SIZES = ((160, 120), (320, 240))
NOISES = ("exact", "default", "worst")
"""Without noise and lost pixels; as a camera's noise is assumed to be, with its whole bias, which makes everything
further; as the map assumes it at most, the whole bias again."""


def surface_voxels(pieces: Iterable[Array], cell: float) -> Array:
    """Middles (n, 3) [m] of the voxels in which a point of the surface of a convex piece lies, of all of them.

    Args:
        pieces: (V, 3) vertices of each in the world [m].
        cell: edge of a voxel [m].
    """
    rng, found = np.random.default_rng(0), [np.zeros((0, 3))]
    for vertices in pieces:
        a, b, c = (vertices[corner] for corner in spatial.ConvexHull(vertices).simplices.T)
        area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
        of = np.repeat(np.arange(len(a)), np.ceil(area * _DENSITY).astype(int))
        u, v = rng.random((2, len(of), 1))
        u, v = np.where(u + v > 1.0, 1.0 - u, u), np.where(u + v > 1.0, 1.0 - v, v)
        found.append(_each_once(np.floor((a[of] + u * (b - a)[of] + v * (c - a)[of]) / cell)))
    return (_each_once(np.concatenate(found)) + 0.5) * cell


def _each_once(cells: Array) -> Array:
    """Voxels (n, 3) without repetitions."""
    return cells[np.unique(cells @ _KEYS, return_index=True)[1]]


@dataclass(frozen=True, slots=True)
class Setting:
    """One way in which the camera is."""

    columns: int
    rows: int
    noise: str

    @property
    def name(self) -> str:
        return f"{self.columns}x{self.rows} {self.noise}"

    @property
    def params(self) -> DepthParams:
        """The camera as it errs."""
        camera = DepthParams(frame=_FRAME, columns=self.columns, rows=self.rows, latency=0.0)
        if self.noise == "default":
            return camera
        if self.noise == "exact":
            camera = replace(camera, dropout=0.0, edge_dropout=0.0, max_incidence=0.5 * math.pi)
            return replace(camera, noise=0.0, noise_growth=0.0, bias=0.0, bias_ratio=0.0)
        most = VolumeMapParams()
        return replace(camera, noise=most.noise, noise_growth=most.noise_growth, bias=most.bias, bias_ratio=0.0)

    @property
    def clean(self) -> DepthParams:
        """The same without errors, but for what comes back."""
        quiet = replace(self.params, noise=0.0, noise_growth=0.0, bias=0.0, bias_ratio=0.0)
        return replace(quiet, dropout=0.0, edge_dropout=0.0)


class _Eye:
    """Workspace: a head camera in a world, without noise, and the noise that is put on its images."""

    def __init__(self, robot: RobotModel, world: World, setting: Setting) -> None:
        self.robot, self.params = robot, setting.params
        self._suite, self._clock = SensorSuite(robot.seeing, world, SensorConfig(sensors=(setting.clean,))), 0.0

    def clean(self, base: Array, head: tuple[float, float]) -> DepthImage:
        """What it would see without errors, from a pose (x, y, yaw) of the base with pan and tilt [rad] of the head."""
        home = self.robot.space.to_coordinates(self.robot.home(*base.tolist()))
        self._clock += 1.0
        (image,) = self._suite.observe(self._clock, self.robot.seeing_row(home, np.array(head)))
        assert isinstance(image, DepthImage)
        return image

    def noisy(self, image: DepthImage, rng: np.random.Generator) -> DepthImage:
        """It with errors, the bias always at its largest: everything is further."""
        stretch = np.linalg.norm(image.directions(), axis=-1)
        depth = image.depth.astype(float)
        return replace(image, depth=noisy_image(depth, depth * stretch, self.params, 1.0, rng))


def bench_carve(
    root: str | os.PathLike[str], robot: RobotModel, step: Note = silent, *, poses: int = 12, seed: int = 0
) -> Figures:
    """Look about in the furnished house from several places, with six cameras, and ask for surfaces that are free.

    Args:
        root: folder with ``house.json``.
        robot: TIAGo, its head as joints that look.
        step: called after each place with a note, for a progress bar.
        poses: places, those of the starts of the house's problems.
        seed: of the first place, and of the noise.
    """
    scene, _ = house_scene(root)
    # of the file itself: nothing that the package has made of them
    told = json.loads((Path(root) / "house.json").read_text(encoding="utf-8"))["obstacles"]
    pieces = [np.array(each["vertices"], dtype=float) for each in told]
    starts = [load_house(root, robot, seed + k).start for k in range(poses)]
    places = np.array([[at.x, at.y, at.yaw] for at in starts])
    surface = surface_voxels(pieces, _FINEST)
    settings = [Setting(*size, noise) for size in SIZES for noise in NOISES]
    return {
        **head("carve", robot=robot.name, poses=poses, images=poses * (1 + len(_PANS) * len(_TILTS))),
        "settings": {each.name: measure_setting(robot, scene, surface, places, each, seed, step) for each in settings},
        "memory_mb": resident(),
    }


def measure_setting(
    robot: RobotModel,
    scene: Scene,
    surface: Array,
    places: Array,
    setting: Setting,
    seed: int,
    step: Note = silent,
) -> Figures:
    """What a camera's map says of voxels (n, 3) of the surfaces of a scene, from places (k, 3): x, y and yaw."""
    volume, mask, reach = VolumeMap(), BodyMask(robot.seeing), reach_voxels(robot, VolumeMapParams().cell)
    wrong, free = np.zeros(len(surface), dtype=bool), 0
    eye, rng = _Eye(robot, World(scene), setting), np.random.default_rng(seed)
    seconds: dict[str, list[float]] = {"body": [], "map": [], "obstacles": []}
    seen: dict[str, list[float]] = {"one view": [], "all views": []}
    for base in places:
        T = _pose(base)
        inside = reach @ T[:3, :3].T + T[:3, 3]
        for k, looks in enumerate([(0.0, float(np.mean(_TILTS))), *((pan, tilt) for tilt in _TILTS for pan in _PANS)]):
            image = eye.noisy(eye.clean(base, looks), rng)
            began = thread_time()
            image = mask.without(image)
            masked = thread_time()
            volume.center(float(base[0]), float(base[1]))
            volume.add(image, T)
            added = thread_time()
            volume.obstacles()
            for name, spent in zip(seconds, (masked - began, added - masked, thread_time() - added), strict=True):
                seconds[name].append(spent)
            wrong |= volume.known(surface) == 0
            if k == 0:
                seen["one view"].append(float((volume.known(inside) >= 0).mean()))
        free += int((volume.known(inside) == 0).sum())
        seen["all views"].append(float((volume.known(inside) >= 0).mean()))
        step(f"{setting.name}: {int(wrong.sum())} wrong")
    frame = np.sum(list(seconds.values()), axis=0)
    return {
        "surface_voxels": len(surface),
        "looked_at": int((volume.known(surface) >= 0).sum()),
        "called_free": int(wrong.sum()),
        "where": surface[wrong][:20].tolist(),
        "reach_voxels": len(reach),
        "reach_free": free,
        "reach_seen": {name: float(np.mean(shares)) for name, shares in seen.items()},
        "frame_ms": percentiles(frame, scale=1e3),
        "parts_ms": {name: percentiles(np.array(spent), scale=1e3) for name, spent in seconds.items()},
        "obstacle_voxels": volume.counts[0],
    }


def reach_voxels(robot: RobotModel, cell: float, draws: int = 20_000) -> Array:
    """Middles (n, 3) [m], in the base's frame, of the voxels that the forearm and the hand come to, by random
    configurations."""
    space, data, rng = robot.space, robot.model.createData(), np.random.default_rng(0)
    frames = [robot.model.getFrameId(name) for name in _REACHING]
    low, high = space.lower[space.base_nv :], space.upper[space.base_nv :]
    found = np.empty((draws, len(frames), 3))
    for k in range(draws):
        row = np.concatenate((np.zeros(space.base_nv), rng.uniform(low, high)))
        pin.framesForwardKinematics(robot.model, data, space.from_coordinates(row))
        found[k] = [data.oMf[frame].translation for frame in frames]
    points = found.reshape(-1, 3)
    return (np.unique(np.floor(points[points[:, 2] > _LOW] / cell), axis=0) + 0.5) * cell


def bench_long(
    root: str | os.PathLike[str], robot: RobotModel, step: Note = silent, *, hours: float = 1.0, seed: int = 0
) -> Figures:
    """Take in images as they come in so many hours, and watch the process's memory and how many obstacles there are.

    The robot turns at one place after the other, its head to and fro; the images' noise is new each time. They are of
    80 × 60 pixels, for what may grow does not hang on that.
    """
    scene, _ = house_scene(root)
    setting, rng = Setting(80, 60, "default"), np.random.default_rng(seed)
    eye = _Eye(robot, World(scene), setting)
    loop: list[tuple[Array, DepthImage]] = []
    for k in range(6):
        at = load_house(root, robot, seed + k).start
        for part in np.arange(_TURN) / _TURN:
            base = np.array([at.x, at.y, at.yaw + 2.0 * math.pi * part])
            loop.append((base, eye.clean(base, (0.8 * math.sin(4.0 * math.pi * part), -0.5))))
        step(f"place {k + 1} of 6")
    estimator = SceneEstimator(robot=robot.seeing, volume=VolumeMapParams(unseen="blocked"))
    frames = max(round(3600.0 * hours * _RATE), 1)
    rows: list[Figures] = []
    spent: list[float] = []
    believed = 0
    every = max(frames // 60, 1)
    for k in range(frames):
        base, image = loop[k % len(loop)]
        image = replace(eye.noisy(image, rng), time=k / _RATE)
        began = thread_time()
        estimator.update(image, base)
        scene = estimator.scene()
        spent.append(thread_time() - began)
        believed += not estimator.watched[image.sensor].reason
        if (k + 1) % every == 0:
            gc.collect()
            alive = sum(isinstance(each, Voxels) for each in gc.get_objects())
            row = {"frame": k + 1, "memory_mb": resident(), "voxels_alive": alive, "obstacles": len(scene)}
            rows.append(row | {"python_objects": len(gc.get_objects()), "frame_ms": percentiles(spent, scale=1e3)})
            spent.clear()
            step(f"{k + 1} images, {rows[-1]['memory_mb']:.0f} MB, {alive} obstacles")
    warm = rows[max(len(rows) // 10, 1) - 1]
    return {
        **head("carve", robot=robot.name, hours=hours, frames=frames),
        "believed": believed / frames,
        "growth_mb": rows[-1]["memory_mb"] - warm["memory_mb"],
        "growth_objects": rows[-1]["python_objects"] - warm["python_objects"],
        "rows": rows,
    }


def bench_cloud(
    files: Iterable[str | os.PathLike[str]], step: Note = silent, *, focal: float = 525.0, seed: int = 0, draws: int = 8
) -> Figures:
    """Show the map a part of the pixels of recorded depth images, and count the others that lie where it is free.

    Two parts: every second column, and every fourth column of every fourth row.

    Args:
        files: clouds of a camera of 640 × 480 pixels, in its frame (z forward, y down), one image each.
        step: called after each file with a note, for a progress bar.
        focal: focal length [px]; what the points do not fit is refused.
        seed: of the poses that the camera is given, so that the voxels lie otherwise each time.
        draws: poses a file.
    """
    rng = np.random.default_rng(seed)
    totals: dict[str, Array] = {}
    clouds: list[Figures] = []
    for file in files:
        depth, misfit = _image_of(read_point_cloud(file).points, focal)
        clouds.append({"file": os.fspath(file), "pixels": int(np.isfinite(depth).sum()), "misfit_px": misfit})
        for _ in range(draws):
            T = _looking(rng)
            for name, kept, image in _shown(depth, focal, T):
                counts = _held_out(depth, kept, image, focal, T, rng)
                totals[name] = totals.get(name, np.zeros((4, len(_BANDS)))) + counts
        step(os.path.basename(os.fspath(file)))
    bands = [f"{a:g}-{b:g} m" for a, b in pairwise(_BANDS)]
    bands.append(f"over {_BANDS[-1]:g} m")
    return {
        **head("carve", focal=focal, draws=draws),
        "clouds": clouds,
        "held_out": {
            name: {
                band: {"points": int(points), "free": int(strict), "free_by_centre": int(centre), "before": int(before)}
                for band, points, strict, centre, before in zip(bands, *counts, strict=True)
            }
            for name, counts in totals.items()
        },
    }


def _image_of(points: Array, focal: float) -> tuple[Image, float]:
    """The image (480, 640) that points (n, 3) are of, NaN where there are none, and by how much they miss the middles
    of pixels [px]: 95 of 100 by less."""
    points = points[points[:, 2] > 0.0]
    at = focal * points[:, :2] / points[:, 2:] + (319.5, 239.5)
    shift = np.median((at + 0.5) % 1.0 - 0.5, axis=0)  # of the optical axis: whole pixels or half ones
    pixel = np.rint(at - shift).astype(int)
    misfit = float(np.percentile(np.abs(at - shift - pixel).max(axis=1), 95)) if len(at) else 1.0
    inside = ((pixel >= 0) & (pixel < (640, 480))).all(axis=1)
    if misfit > 0.25 or inside.mean() < 0.99:
        raise ParameterError(f"focal={focal!r} px does not fit: the points miss the middles of pixels by {misfit:.2f}")
    depth = np.full((480, 640), np.nan, dtype=np.float32)
    depth[pixel[inside, 1], pixel[inside, 0]] = points[inside, 2]
    return depth, misfit


def _looking(rng: np.random.Generator) -> Array:
    """(4, 4) a camera two metres above the map's bottom, somewhere, that looks anywhere but steeply up or down."""
    yaw, tilt = rng.uniform(-math.pi, math.pi), rng.uniform(-0.3, 0.5)
    T = _pose(np.array([*rng.uniform(-0.5, 0.5, 2), yaw]))
    c, s = math.cos(tilt), math.sin(tilt)
    T[:3, :3] = T[:3, :3] @ [[c, 0, s], [0, 1, 0], [-s, 0, c]] @ [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
    T[2, 3] = 3.0 + rng.uniform(0.0, 0.05)
    return T


def _shown(depth: Image, focal: float, T: Array) -> Iterator[tuple[str, Mask, DepthImage]]:
    """Names, which pixels are shown, and the image of these."""
    for name, down, across in (("every second column", 1, 2), ("every 4th of every 4th row", 4, 4)):
        kept = np.zeros(depth.shape, dtype=bool)
        kept[::down, ::across] = True
        center = 319.5 / across, 239.5 / down
        part = depth[::down, ::across]
        yield name, kept, DepthImage("cloud", 0.0, T, part, (focal / across, focal / down), center, 0.3, 8.0)


def _held_out(depth: Image, kept: Mask, image: DepthImage, focal: float, T: Array, rng: np.random.Generator) -> Array:
    """(4, bands) how many points were held out, how many of them are called free, how many would be by the pixel over
    a voxel's middle alone where none of those shown ends in it, and of as many points before them, each somewhere on
    its ray, how many are free."""
    params = VolumeMapParams(height=6.0)
    volume = VolumeMap(params)
    volume.add(image, np.eye(4))
    rows, columns = np.nonzero(np.isfinite(depth) & ~kept)
    z = depth[rows, columns].astype(float)
    own = np.column_stack(((columns - 319.5) * z / focal, (rows - 239.5) * z / focal, z))
    points = own @ T[:3, :3].T + T[:3, 3]
    strict = volume.known(points) == 0
    middle = ((np.floor(points / params.cell) + 0.5) * params.cell - T[:3, 3]) @ T[:3, :3]
    f, c = np.array(image.focal), np.array(image.center)
    with np.errstate(divide="ignore", invalid="ignore"):
        u, v = np.rint(f * middle[:, :2] / middle[:, 2:] + c).astype(int).T
    there = (u >= 0) & (v >= 0) & (u < image.depth.shape[1]) & (v < image.depth.shape[0]) & (middle[:, 2] > 0.3)
    met = np.full(len(points), np.nan)
    met[there] = image.depth[v[there], u[there]]
    met = np.minimum(met, params.range_max)
    centre = met - params.error(met) > middle[:, 2] + 0.5 * math.sqrt(3.0) * params.cell
    ended = np.unique(np.floor(image.points() / params.cell), axis=0) @ _KEYS
    centre &= ~np.isin(np.floor(points / params.cell) @ _KEYS, ended)
    before = volume.known((rng.random((len(own), 1)) * own) @ T[:3, :3].T + T[:3, 3]) == 0
    band = np.searchsorted(_BANDS, z, side="right") - 1
    counts = [np.bincount(band[some], minlength=len(_BANDS)) for some in (z > 0, strict, centre, before)]
    return np.array(counts, dtype=float)


def _pose(base: Array) -> Array:
    """(4, 4) of a base (x, y, yaw)."""
    T, c, s = np.eye(4), math.cos(base[2]), math.sin(base[2])
    T[:2, :2], T[:2, 3] = [[c, -s], [s, c]], base[:2]
    return T
