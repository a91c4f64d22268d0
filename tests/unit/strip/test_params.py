"""Parameters are validated where they are made; messages name the value, its bound and what would be valid."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from refusals import taken

from elastic_strips.errors import ParameterError
from elastic_strips.strip import PRESETS, Deformer, DeformParams

NUMBERS = [f.name for f in dataclasses.fields(DeformParams) if f.name not in ("preset", "mobile_only")]


def test_no_parameter_takes_what_is_no_sound_number():
    values = (-1, -1e-9, np.nan, np.inf, -np.inf, "1", None, True, [1.0], 1j)
    assert taken(DeformParams, [{name: value} for name in NUMBERS for value in values]) == []


def test_some_must_be_positive():
    for name in ("influence", "k_c", "damping", "max_step", "max_spacing", "max_nodes"):
        with pytest.raises(ParameterError, match=rf"{name}=0 must be a .*number (>|≥)"):
            DeformParams(**{name: 0})


@pytest.mark.parametrize(
    "given, message",
    [
        ({"clearance": 0.3}, r"clearance=0.3 must be below influence=0.3"),
        ({"clearance": 0.5, "influence": 0.2}, r"clearance=0.5 must be below influence=0.2"),
        ({"min_spacing": 0.3}, r"min_spacing=0.3 must not exceed max_spacing=0.2"),
        ({"max_nodes": 2}, r"max_nodes=2 must be at least 4"),
        ({"preset": "papre"}, r"preset='papre' is unknown; did you mean 'paper'\? Valid: default, paper"),
    ],
)
def test_contradictions_are_refused(given, message):
    with pytest.raises(ParameterError, match=message):
        DeformParams(**given)


def test_presets():
    assert PRESETS == ("default", "paper")
    assert DeformParams.for_preset("default") == DeformParams()
    paper = DeformParams.for_preset("paper", k_c=0.4)
    assert (paper.preset, paper.influence, paper.k_r, paper.k_c) == ("paper", 1.5, 0.3, 0.4)
    with pytest.raises(ParameterError, match=r"unknown parameter 'influense'; did you mean 'influence'"):
        DeformParams.for_preset("default", influense=1.0)
    with pytest.raises(ParameterError, match="preset='other'"):
        DeformParams.for_preset("other")
    with pytest.raises(ParameterError, match="clearance"):
        DeformParams.for_preset("default", clearance=-1.0)


def test_values_do_not_change():
    params = DeformParams()
    with pytest.raises(dataclasses.FrozenInstanceError):
        params.influence = 1.0
    other = params.replaced(influence=0.5)
    assert (params.influence, other.influence) == (0.3, 0.5)
    with pytest.raises(ParameterError, match="did you mean"):
        params.replaced(influenc=0.5)
    with pytest.raises(ParameterError, match="must be below influence"):
        params.replaced(influence=0.001)
    assert DeformParams(**params.as_dict()) == params


def test_parameters_go_by_keyword():
    with pytest.raises(TypeError):
        DeformParams("paper")


def test_numpy_numbers_are_numbers():
    assert DeformParams(influence=np.float64(0.4), max_nodes=np.int64(50)).max_nodes == 50


def test_a_deformer_takes_parameters_or_a_preset(silvermate):
    assert Deformer(silvermate).params == DeformParams()
    assert Deformer(silvermate, "paper").params.preset == "paper"
    with pytest.raises(ParameterError, match="preset='fast'"):
        Deformer(silvermate, "fast")
    with pytest.raises(ParameterError, match="neither DeformParams nor the name of a preset"):
        Deformer(silvermate, {"influence": 0.3})
