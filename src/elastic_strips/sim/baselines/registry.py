"""The base methods by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

from elastic_strips.errors import ParameterError, nearest_name

from .base_method import BaseLimits, BaseMethod
from .elastic_band import ElasticBand, SensedWay
from .force_field import ForceField
from .histogram import VectorFieldHistogram
from .potential_field import PotentialField


def _band(limits: BaseLimits) -> BaseMethod:
    return ElasticBand(limits, planner=SensedWay(limits.radius))


BASE_METHODS: Mapping[str, Callable[[BaseLimits], BaseMethod]] = MappingProxyType(
    {"apf": PotentialField, "vff": ForceField, "vfh": VectorFieldHistogram, "band": _band}
)
"""Name → factory of the method with its default parameters; the band's planner knows what is sensed, and no more."""


def make_base_method(name: str, limits: BaseLimits) -> BaseMethod:
    """A base method by its name, with its default parameters.

    Raises:
        ParameterError: no such method.
    """
    if name not in BASE_METHODS:
        raise ParameterError(f"base method {name!r} is unknown{nearest_name(name, BASE_METHODS)}")
    return BASE_METHODS[name](limits)
