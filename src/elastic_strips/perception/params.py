"""Parameters of scenes from readings: noise, sizes, tracks, map; validated where they are made."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Literal

from elastic_strips.errors import ParameterError
from elastic_strips.validation import Bound, Count, NonNegative, Positive, check_fields


@dataclass(frozen=True, slots=True, kw_only=True)
class SceneEstimatorParams:
    """How readings become obstacles; lengths in [m], times in [s], angles in [rad].

    A planar scan says nothing about height: whatever it meets is assumed to reach from the floor to ``height``.
    Things that lie wholly above or below the scan's plane are not seen at all; see
    :func:`~elastic_strips.sim.evaluation.seen_obstacles`.

    Attributes:
        height: height of all sensed obstacles, from the floor (z = 0) up; at least that of the robot with its arm
            stretched. Where images say what is higher, and what they did not see is blocked, that of a scan's plane
            will do.
        mover_height: height of what moves, where ``height`` is less: images leave it out of the map.
        range_noise: standard deviation of a range.
        pose_noise: standard deviation of the base's position estimate from scan to scan.
        padding: length by which everything sensed is grown to each side, for the noise; at most a cell of the map.
        break_angle: neighbouring points belong together where their line meets the ray at more than this angle.
        min_points: clusters of fewer points are not tracked (they are in the map all the same).
        max_round_radius: round things with a larger radius do not become cylinders.
        max_mover_size: things that are seen to be larger do not move.
        unseen_depth: straight things are this deep behind their visible side, or as deep as they are long.
        wall_thickness: the same for things longer than ``max_mover_size``.
        gate: squared Mahalanobis distance up to which a cluster may be a track's (two degrees of freedom).
        mover_acceleration: standard deviation of movers' acceleration [m/s²].
        max_speed: largest speed of movers [m/s].
        min_speed: things that are slower stand [m/s].
        significance: a mover's speed is at least this many of its standard deviations.
        history: to be a mover, a thing must be where a scan this long ago saw nothing, or the other way round.
        confirm_hits: scans with a cluster until a track is confirmed.
        lost_misses: number of scans in a row that see through a track until it is lost.
        coast_time: how long the motion of a hidden track is predicted.
        doubt_time: for how long after that the way on of a mover is in doubt.
        stray_width: how far to each side a mover strays at most from its way while it is hidden. It is in the scene as
            much larger as ``mover_acceleration`` lets it stray in that time.
        rest_time: a mover that has not moved significantly for this long goes back into the map. What scans contradict
            twice that it stands is possibly moving for as long after that.
        recent_motion_time: how long after that it may set off again: until then the scene has it as a thing of
            unknown motion as well.
        recent_motion_speed: its largest speed meanwhile, until it is seen to move [m/s].
        stood_time: what stands where something has moved, and was not seen for this long, may have gone: it is among
            what was not seen [s].
        motion_onset_time: a thing that is where nothing was, or no longer where it was, is in the scene as a thing of
            unknown motion too, before its velocity is known, and for this long after that was last seen.
        motion_onset_speed: its largest speed meanwhile, and of what does not go where it is expected [m/s].
        shape_change: a mover keeps its shape until its radius has changed by more than this.
        cell: edge of the map's cells.
        tile: edge of the tiles that the map's obstacles consist of.
        hit, miss: log-odds that a scan adds to cells that it hits, and subtracts from those that it sees through.
        floor, top: bounds of the log-odds (the floor is −floor).
        occupied: cells above it
            become obstacles, until they are below −floor / 2.
        settle_delay: a tile in which cells became free, or cells next to its obstacle's own became occupied, but
            nothing else happened, keeps its obstacle for this much longer.
        carve_range: beyond this range free space is not noted.
        unseen: state of cells that have never been seen: ``"free"`` or ``"blocked"``.
        unseen_radius: radius of a disc about the base; with ``"blocked"``, unseen cells in it become obstacles.
        robot_radius: cells this close to the base count as seen and free: the robot stands there.
        body_radius: cells that a disc of this radius about the base touches are free, whatever was seen there: the disc
            is full of the robot. A thing that came near and went away unseen would keep the robot from moving for ever.
        sonar_range: range up to which sonars are believed; beyond it their arcs are too wide.
    """

    height: Positive = 1.5
    mover_height: Positive = 2.0
    range_noise: Positive = 0.01
    pose_noise: NonNegative = 0.01
    padding: NonNegative = 0.02
    break_angle: Annotated[float, Bound(above=0.0, below=0.5 * math.pi, unit="rad")] = 0.2
    min_points: Count = 3
    max_round_radius: Positive = 0.5
    max_mover_size: Positive = 1.2
    unseen_depth: Positive = 0.3
    wall_thickness: Positive = 0.1
    gate: Positive = 13.8
    mover_acceleration: Positive = 0.4
    max_speed: Positive = 3.0
    min_speed: Positive = 0.12
    significance: Positive = 3.0
    history: Positive = 0.8
    confirm_hits: Count = 3
    lost_misses: Count = 4
    coast_time: Positive = 2.0
    doubt_time: NonNegative = 3.0
    stray_width: NonNegative = 0.3
    rest_time: Positive = 2.0
    recent_motion_time: NonNegative = 10.0
    recent_motion_speed: Positive = 0.2
    stood_time: NonNegative = 3.0
    motion_onset_time: NonNegative = 0.2
    motion_onset_speed: Positive = 1.0
    shape_change: Positive = 0.04
    cell: Positive = 0.05
    tile: Positive = 1.0
    hit: Positive = 0.85
    miss: Positive = 0.4
    floor: Positive = 0.8
    top: Positive = 3.4
    occupied: Positive = 0.5
    settle_delay: NonNegative = 0.5
    carve_range: Positive = 8.0
    unseen: Literal["free", "blocked"] = "free"
    unseen_radius: Positive = 3.0
    robot_radius: NonNegative = 0.4
    body_radius: NonNegative = 0.0
    sonar_range: NonNegative = 1.0

    def __post_init__(self) -> None:
        check_fields(self)
        cells = self.tile / self.cell
        if not (abs(cells - round(cells)) < 1e-6 and 1 <= round(cells) <= 1000):
            raise ParameterError(f"SceneEstimatorParams.tile={self.tile!r} must be 1 to 1000 times cell={self.cell!r}")
        if self.padding > self.cell:
            raise ParameterError(f"SceneEstimatorParams.padding={self.padding!r} must be at most cell={self.cell!r}")
        if not self.occupied < min(self.hit, self.top):
            raise ParameterError(
                f"SceneEstimatorParams.occupied={self.occupied!r} must be below hit={self.hit!r} and top={self.top!r}: "
                "what is hit once is an obstacle"
            )

    @property
    def tallest(self) -> float:
        """Height [m] of what moves."""
        return max(self.height, self.mover_height)

    @property
    def tile_cells(self) -> int:
        """Cells along a tile's edge."""
        return round(self.tile / self.cell)

    @property
    def carve_margin(self) -> float:
        """Rays free nothing within this distance [m] of their ends: noise, padding and a cell."""
        return 2.0 * self.range_noise + self.padding + 1.5 * self.cell
