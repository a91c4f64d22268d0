"""Baselines: obstacle avoidance of a mobile base, without strips, by the methods that the paper builds on or compares
with."""

from __future__ import annotations

from .base_controller import (
    BASE_METHODS,
    SCENE_METHODS,
    BaseController,
    base_simulation,
    make_base_method,
    make_scene_method,
)
from .base_method import BaseCommand, BaseLimits, BaseMethod, GoalParams
from .certainty_grid import GridParams
from .driving import DRIVE_METHODS, drive_by, make_base_simulation
from .dynamic_window import DynamicWindow, DynamicWindowParams
from .elastic_band import ElasticBand, ElasticBandParams
from .force_fields import PotentialField, PotentialFieldParams, VirtualForceField, VirtualForceFieldParams
from .histogram import HistogramParams, VectorFieldHistogram
from .reciprocal import ReciprocalAvoidance, ReciprocalParams
from .scene_method import SceneFromAbove, SceneMethod

__all__ = [
    "BaseController",
    "BASE_METHODS",
    "SCENE_METHODS",
    "make_base_method",
    "make_scene_method",
    "base_simulation",
    "DRIVE_METHODS",
    "drive_by",
    "make_base_simulation",
    "BaseMethod",
    "BaseCommand",
    "BaseLimits",
    "GoalParams",
    "GridParams",
    "PotentialField",
    "PotentialFieldParams",
    "VirtualForceField",
    "VirtualForceFieldParams",
    "VectorFieldHistogram",
    "HistogramParams",
    "ElasticBand",
    "ElasticBandParams",
    "SceneMethod",
    "SceneFromAbove",
    "DynamicWindow",
    "DynamicWindowParams",
    "ReciprocalAvoidance",
    "ReciprocalParams",
]
