"""Methods room: obstacle avoidance of a mobile base by the methods that the paper builds on or compares with."""

from __future__ import annotations

from .base_controller import BaseController
from .base_method import BaseCommand, BaseLimits, BaseMethod
from .certainty_grid import CV_MAX, BayesGrid, CertaintyGrid, GridParams, HistogramGrid, make_grid
from .elastic_band import ElasticBand, ElasticBandParams, Planner, SensedWay
from .force_field import ForceField, ForceFieldParams
from .helm import GoalParams
from .histogram import HistogramParams, VectorFieldHistogram
from .potential_field import PotentialField, PotentialFieldParams
from .registry import BASE_METHODS, make_base_method
from .simulation import RawReadings, base_simulation

__all__ = [
    "BaseController",
    "RawReadings",
    "base_simulation",
    "BASE_METHODS",
    "make_base_method",
    "BaseMethod",
    "BaseCommand",
    "BaseLimits",
    "GoalParams",
    "CertaintyGrid",
    "HistogramGrid",
    "BayesGrid",
    "GridParams",
    "make_grid",
    "CV_MAX",
    "PotentialField",
    "PotentialFieldParams",
    "ForceField",
    "ForceFieldParams",
    "VectorFieldHistogram",
    "HistogramParams",
    "ElasticBand",
    "ElasticBandParams",
    "Planner",
    "SensedWay",
]
