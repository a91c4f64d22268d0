"""Image watch: whether the images of a camera or a 3-D lidar can be as they say, and what is wrong where they cannot.

An image is compared with the floor, with what the same sensor saw a moment ago, with what a laser sees now, and with
the robot's own body. What no image of this kind can show (glass; without a laser, an error that was there from
the start and shifts nothing) is not found.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from elastic_strips.arrays import Array, Mask

from .displacement import (
    MOST_SHIFTED,
    PIXELS,
    UNKNOWN,
    Displacement,
    Surfaces,
    find_surfaces,
    fit_displacement,
    fit_floor,
)
from .image_lag import ImageLag
from .image_movers import measured
from .readings import NO_ANSWER, DepthImage, RangeImage, ScanRays
from .volume_map import VolumeMapParams

_SAME = 1  # times that the same image may come again
_LEAST_MOVED = 0.005  # [m, rad] from which on a sensor has moved
_SAME_PLACE = 1e-4  # [m, rad] up to which it stands
_LIVING = 0.5  # of the pixels differ between two images of a sensor that stands: it has noise

_MOST_UNANSWERED, _BLIND = 0.6, 0.95  # of the pixels that are not of the robot
_UNANSWERED_FOR = 1.0  # [s] in a row: beside a wall, or too near to it, a camera that looks about sees as little
_MOST_ALONE = 0.05  # of those that met something
_ALONE = (0.1, 0.1)  # [m], and part of the range, by which a pixel is nearer than those about it

_MOST_THROUGH = 0.3  # of the pixels in which the robot's body has to be that see through it
_LEAST_BODY = 40  # pixels
_BODY_DEPTH = 0.1  # [m] by which a pixel has to see further than the body's surface

_KEPT_FOR = 0.7  # [s] what was seen is compared with later images
_FAR_OFF = 0.4  # [m] from which on a point is another thing's
_BEFORE = (0.3, 0.3, 0.3, 0.15, 0.15, 0.02)  # [rad, m] standard deviations of a displacement, a priori
_PLANE_BEFORE = (1e-6, 1e-6, 0.3, 0.15, 0.15, 1e-6)  # the same of what a level laser tells
_LEAST_IN_PLANE = 20  # points of a laser that are compared
_IN_A_ROW = 3  # images that are off what a laser sees
_SCAN_AGE = 0.2  # [s] between image and scan, at most
_SCAN_SIGMA = 0.02  # [m] standard deviation of a scan's points
_BESIDE_PLANE = 0.1  # [m] by which what is compared with a scan may be higher or lower than its plane
_STEEP = 0.3  # most of a steep surface's normal that is vertical
_TRUSTED_AGAIN = 3  # images in a row that agree with what was seen before
_GIVEN_UP = 3.0  # [s] for which nothing can be compared, after which what was seen then is forgotten


@dataclass(frozen=True, slots=True)
class ImageReport:
    """How an image fits to what is known.

    Attributes:
        sensor, time: of the image.
        reason: why it is not believed; empty where it is.
        repeated: how often the same image has come before, one after the other.
        unanswered: part of its pixels that say nothing, without those of the robot's body.
        alone: part of the pixels that met something by which something nearer is met than by those about them.
        through: part of the pixels in which the robot's body has to be that see through it; NaN where there are few.
        compared: how many of its points were compared with the floor and with what was seen before.
        tilted: angle [rad] by which the floor is.
        turned, shifted: angle [rad] and distance [m] by which what was seen before is displaced all together.
        turned_by_laser, shifted_by_laser: the same of what a laser sees.
        late_by_laser: how much older [s] the images of late are than they say, by what a laser sees.
    """

    sensor: str
    time: float
    reason: str = ""
    repeated: int = 0
    unanswered: float = 0.0
    alone: float = 0.0
    through: float = math.nan
    compared: int = 0
    tilted: float = 0.0
    turned: float = 0.0
    shifted: float = 0.0
    turned_by_laser: float = 0.0
    shifted_by_laser: float = 0.0
    late_by_laser: float = 0.0


MayMove = Callable[[Array, float], Mask]
"""Which places (n, 2) of the floor may be of things that have moved within some time [s]."""


class ImageWatch:
    """Workspace: the images of one sensor so far, compared with the newest one.

    Args:
        params: how exact ranges are.
    """

    def __init__(self, params: VolumeMapParams) -> None:
        self.params: VolumeMapParams = params
        self._last: DepthImage | RangeImage | None = None
        self._last_pose = self._first_pose = np.eye(4)
        self._repeated, self._noisy = 0, False
        self._kept: Surfaces | None = None
        self._kept_since = self._compared_at = -math.inf
        self._off_laser = 0  # images in a row
        self._lags: dict[str, ImageLag] = {}  # by laser
        self._doubt, self._good = "", 0
        self._misremembered = 0  # images in a row
        self._sees = math.inf  # [s] when an image last said enough; the first one, where none did

    def look(
        self,
        image: DepthImage | RangeImage,
        kept: DepthImage | RangeImage,
        T_world_sensor: Array,
        own: Array,
        moving: Mask,
        places: MayMove,
        scans: Mapping[str, ScanRays],
    ) -> ImageReport:
        """Whether an image is to be believed.

        One that follows on images that were not is believed only when some in a row agree with what was seen before, or
        when the floor and a laser say of some that it is not they that are displaced, but what is remembered.

        Args:
            image: the image as it came.
            kept: the same without the robot.
            T_world_sensor: (4, 4) pose of the sensor when it was taken.
            own: (H, W) distances along the rays at which they meet the robot's own body [m]; infinite beside it.
            moving: (H, W) pixels that may be of something that moves.
            places: tells where things may have moved.
            scans: laser → what it saw last.
        """
        repeated = self._repeats(image, T_world_sensor)
        unanswered, alone = _unanswered(image, own), _alone(kept)
        through = self._through(image, own)
        still = _without(kept, moving)
        now = find_surfaces(still, T_world_sensor, self.params)
        on_floor = now.floor(T_world_sensor)
        slope = fit_floor(now.some(on_floor), T_world_sensor, self.params.bias)
        found = self._displacement(still, T_world_sensor, places)
        beside = {name: self._off_scan(now, image.time, T_world_sensor, places, name, scans[name]) for name in scans}
        laser = max(beside, key=lambda name: (beside[name].large, beside[name].judges), default="")
        worst = beside.get(laser, UNKNOWN)
        self._off_laser = self._off_laser + 1 if worst.large else 0
        if unanswered <= _MOST_UNANSWERED or self._sees == math.inf:
            self._sees = image.time
        self._misremembered = self._misremembered + 1 if _contradicted(found, slope, worst) else 0
        if self._misremembered >= _TRUSTED_AGAIN:
            self._kept, found = None, UNKNOWN
        reason = self._reason(image, repeated, unanswered, alone, through, slope, found)
        if not reason and self._off_laser >= _IN_A_ROW:
            reason = (
                f"{image.sensor!r} is not where or when it says: what {laser!r} sees is turned by "
                f"{math.degrees(worst.turned):.1f}° and shifted by {worst.shifted:.2f} m in it"
            )
        late = max(self._lags, key=lambda name: (self._lags[name].large, abs(self._lags[name].seconds)), default="")
        lag = self._lags.get(late)
        if not reason and lag is not None and lag.large:
            reason = (
                f"{image.sensor!r} is not of the time that it says: by what {late!r} sees, its images are "
                f"{abs(lag.seconds):.2f} s {'older' if lag.seconds > 0.0 else 'newer'}"
            )
        judged = slope.judges or found.judges or (worst.judges and not worst.large)
        if judged:
            self._compared_at = image.time
        if reason:
            # that it is frozen says more than that it is displaced, which comes of it
            self._doubt = reason if repeated == _SAME + 1 else self._doubt or reason
            self._good = 0
        elif self._doubt:
            self._good += judged or image.time - self._compared_at > _GIVEN_UP
            if self._good >= _TRUSTED_AGAIN:
                self._doubt, self._kept = "", None
        if not self._doubt and (self._kept is None or image.time - self._kept_since >= _KEPT_FOR):
            self._kept, self._kept_since = now.some(~on_floor), image.time
        return ImageReport(
            sensor=image.sensor,
            time=image.time,
            reason=self._doubt,
            repeated=repeated,
            unanswered=unanswered,
            alone=alone,
            through=through,
            compared=slope.compared + found.compared,
            tilted=slope.turned,
            turned=found.turned,
            shifted=found.shifted,
            turned_by_laser=worst.turned,
            shifted_by_laser=worst.shifted,
            late_by_laser=lag.seconds if lag is not None else 0.0,
        )

    def _reason(
        self,
        image: DepthImage | RangeImage,
        repeated: int,
        unanswered: float,
        alone: float,
        through: float,
        slope: Displacement,
        found: Displacement,
    ) -> str:
        name = repr(image.sensor)
        if unanswered > _BLIND or (unanswered > _MOST_UNANSWERED and image.time - self._sees > _UNANSWERED_FOR):
            return f"{name} hardly sees anything: {100 * unanswered:.0f} % of its pixels say nothing"
        if repeated > _SAME and (self._noisy or self._moved()):
            return f"{name} is frozen: the same image comes again and again, from {image.time:.2f} s on"
        if alone > _MOST_ALONE:
            return (
                f"{name} sees what is not there: {100 * alone:.0f} % of its pixels end before all about them, "
                "as in fog, smoke or glare"
            )
        if through > _MOST_THROUGH:
            return f"{name} is not where it should be: {100 * through:.0f} % of the robot's body is not in its picture"
        if slope.tilted:
            return f"{name} is not where it should be: the floor is tilted by {math.degrees(slope.turned):.1f}° in it"
        if found.large:
            return (
                f"{name} is not where or when it says: what it sees is turned by {math.degrees(found.turned):.1f}° and "
                f"shifted by {found.shifted:.2f} m"
            )
        return ""

    # the same image again

    def _repeats(self, image: DepthImage | RangeImage, T: Array) -> int:
        """How often the same image has come before."""
        last, before = self._last, self._last_pose
        self._last, self._last_pose = image, T
        if last is None or last.ranges.shape != image.ranges.shape:
            self._repeated, self._first_pose = 0, T
            return 0
        same = (image.ranges == last.ranges) | (np.isnan(image.ranges) & np.isnan(last.ranges))
        if same.all():
            self._repeated += 1
        else:
            self._repeated, self._first_pose = 0, T
            stands = float(np.abs(T - before).max()) < _SAME_PLACE
            self._noisy = self._noisy or (stands and float(same.mean()) < 1.0 - _LIVING)
        return self._repeated

    def _moved(self) -> bool:
        """Whether the sensor has moved since the image that has come again came first."""
        return float(np.abs(self._last_pose - self._first_pose).max()) > _LEAST_MOVED

    # the robot's own body

    def _through(self, image: DepthImage | RangeImage, own: Array) -> float:
        """Part of the pixels within the robot's outline that see through it."""
        there = np.isfinite(own)
        if int(there.sum()) < _LEAST_BODY:
            return math.nan
        for axis in (0, 1):  # not at its border
            for step in (-1, 1):
                there = there & np.roll(np.isfinite(own), step, axis)
        stretch = np.linalg.norm(image.directions()[there], axis=-1)
        seen, body = image.ranges[there].astype(float) * stretch, own[there]
        answered = ~np.isnan(seen)
        if int(answered.sum()) < _LEAST_BODY:
            return math.nan
        return float((seen > body + _BODY_DEPTH + self.params.error(body))[answered].mean())

    # what is displaced

    def _displacement(self, image: DepthImage | RangeImage, T: Array, places: MayMove) -> Displacement:
        """By how much an image is displaced from what was seen before."""
        kept = self._kept
        if kept is None:
            return UNKNOWN
        kept = kept.some(~places(kept.points[:, :2], max(image.time - self._kept_since, 0.0)))
        if not len(kept.points):
            return UNKNOWN
        local = (kept.points - T[:3, 3]) @ T[:3, :3]
        distance, range_ = measured(image, local)
        with np.errstate(invalid="ignore"):
            there = distance > 0.0
            ends = kept.points + (range_ / np.where(there, distance, 1.0) - 1.0)[:, None] * (local @ T[:3, :3].T)
            apart = np.einsum("ij,ij->i", kept.normals, ends - kept.points)
            ok = there & np.isfinite(range_) & (np.abs(apart) < _FAR_OFF)
        sigma = np.hypot(kept.sigma[ok], self.params.sigma(range_[ok]))
        return fit_displacement(ends[ok] - T[:3, 3], kept.normals[ok], apart[ok], sigma, _BEFORE)

    def _off_scan(
        self, now: Surfaces, time: float, T: Array, places: MayMove, laser: str, scan: ScanRays
    ) -> Displacement:
        """By how much surfaces of an image are displaced from what a level laser sees: those alone that are steep and
        at the height of its plane, for it sees below what a camera sees from above."""
        lag = self._lags.setdefault(laser, ImageLag())
        lag.come(time, T)
        if abs(time - scan.time) > _SCAN_AGE:
            return UNKNOWN
        steep = (np.abs(now.normals[:, 2]) < _STEEP) & (np.abs(now.points[:, 2] - scan.height) < _BESIDE_PLANE)
        now = now.some(steep & ~places(now.points[:, :2], _SCAN_AGE))
        if not len(now.points):
            return UNKNOWN
        _, ray, inside = scan.locate(now.points[:, :2])
        ray = np.rint(ray).astype(np.intp)
        range_ = np.where(inside & scan.hits[ray], scan.ranges[ray], np.nan)
        level = np.full(len(ray), scan.height)  # what leans is elsewhere above and below that
        ends = np.column_stack((scan.origin + range_[:, None] * scan.direction[ray], level))
        apart = np.einsum("ij,ij->i", now.normals, now.points - ends)
        with np.errstate(invalid="ignore"):
            ok = np.abs(apart) < _FAR_OFF
        sigma = np.hypot(now.sigma[ok], _SCAN_SIGMA)
        lag.compare(now.points[ok], now.normals[ok], apart[ok], np.hypot(sigma, PIXELS))
        return fit_displacement(
            now.points[ok] - T[:3, 3], now.normals[ok], apart[ok], sigma, _PLANE_BEFORE, _LEAST_IN_PLANE
        )


def _without(image: DepthImage | RangeImage, moving: Mask) -> DepthImage | RangeImage:
    """An image that says nothing where something moves, and right beside that."""
    if not moving.any():
        return image
    wide = np.pad(moving, 2)
    rows, columns = moving.shape
    near = np.logical_or.reduce([wide[i : i + rows, j : j + columns] for i in range(0, 5, 2) for j in range(0, 5, 2)])
    kept = np.where(near, np.float32(NO_ANSWER), image.ranges)
    return replace(image, depth=kept) if isinstance(image, DepthImage) else replace(image, ranges=kept)


def _contradicted(found: Displacement, slope: Displacement, laser: Displacement) -> bool:
    """Whether the floor and a laser, which see an image in its place, would see that it is as far off as it is from
    what is remembered."""
    in_place = slope.judges and not slope.tilted and laser.judges and not laser.large and found.raised < MOST_SHIFTED
    turned, shifted = found.turned - laser.turned, found.shifted - laser.shifted
    shows = turned > laser.most_turned or shifted > laser.most_shifted
    return in_place and found.large and shows


def _unanswered(image: DepthImage | RangeImage, own: Array) -> float:
    """Part of the pixels beside the robot's body that say nothing."""
    beside = ~np.isfinite(own)
    return float(np.isnan(image.ranges[beside]).mean()) if beside.any() else 0.0


def _alone(image: DepthImage | RangeImage) -> float:
    """Part of the pixels with an end that are nearer than most about them: every second row and column is asked."""
    ranges = np.where(np.isnan(image.ranges), np.inf, image.ranges)
    rows, columns = ranges.shape
    if min(rows, columns) < 3:
        return 0.0
    r, c = np.arange(1, rows - 1, 2)[:, None], np.arange(1, columns - 1, 2)
    here = ranges[r, c]
    steps: list[tuple[int, int]] = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)]
    about = np.partition(np.stack([ranges[r + i, c + j] for i, j in steps]), 1, axis=0)[1]
    hits = np.isfinite(here)
    if not hits.any():
        return 0.0
    with np.errstate(invalid="ignore"):
        return float((here + _ALONE[0] + _ALONE[1] * here < about)[hits].mean())
