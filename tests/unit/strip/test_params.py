"""Parameters are validated where they are made; messages name the value, its bound and what would be valid."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from cases import each, refused
from refusals import taken

from elastic_strips.catalogue import PRESETS
from elastic_strips.errors import ParameterError
from elastic_strips.strip import Deformer, DeformParams
from elastic_strips.strip.paper import PaperDeformer, PaperParams

KINDS = [DeformParams, PaperParams]


@pytest.mark.parametrize("kind", KINDS)
def test_no_parameter_takes_what_is_no_sound_number(kind):
    values = (-1, -1e-9, np.nan, np.inf, -np.inf, "1", None, True, [1.0], 1j)
    names = [f.name for f in dataclasses.fields(kind) if f.name != "mobile_only"]
    assert taken(kind, [{name: value} for name in names for value in values]) == []


def test_some_must_be_positive():
    positive = {
        DeformParams: ("influence", "k_c", "damping", "max_step", "max_spacing", "max_nodes", "certificate_depth"),
        PaperParams: ("influence", "k_c", "updates", "max_ticks", "certificate_depth"),
    }
    for kind, names in positive.items():
        for name in names:
            with pytest.raises(ParameterError, match=rf"{name}=0 must be a .*number (>|≥)"):
                kind(**{name: 0})


@each(
    "given, message",
    [
        ({"clearance": 0.3}, r"clearance=0.3 must be below influence=0.3"),
        ({"clearance": 0.5, "influence": 0.2}, r"clearance=0.5 must be below influence=0.2"),
        ({"min_spacing": 0.3}, r"min_spacing=0.3 must not exceed max_spacing=0.2"),
        ({"max_nodes": 2}, r"DeformParams.max_nodes=2 must be a whole number ≥ 4"),
    ],
)
def test_contradictions_are_refused(given, message):
    with pytest.raises(ParameterError, match=message):
        DeformParams(**given)


def test_presets():
    assert [kind.preset for kind in KINDS] == list(PRESETS)
    paper = PaperParams().replaced(k_c=0.4)
    assert (paper.preset, paper.influence, paper.k_r, paper.k_c) == ("paper", 1.5, 0.3, 0.4)
    for kind in KINDS:
        with refused(ParameterError, "'influense'", "'influence'"):
            kind().replaced(influense=1.0)
        with refused(ParameterError, "clearance"):
            kind().replaced(clearance=-1.0)
    with refused(ParameterError, "'alpha'"):
        DeformParams().replaced(alpha=0.3)
    with refused(ParameterError, "PaperParams", "mobile_only=1"):
        PaperParams(mobile_only=1)


def test_values_do_not_change():
    params = DeformParams()
    with pytest.raises(dataclasses.FrozenInstanceError):
        params.influence = 1.0
    other = params.replaced(influence=0.5)
    assert (params.influence, other.influence) == (0.3, 0.5)
    with pytest.raises(ParameterError, match="did you mean"):
        params.replaced(influenc=0.5)
    with refused(ParameterError, "influence"):
        params.replaced(influence=0.001)
    values = params.as_dict()
    assert values.pop("preset") == "default"
    assert DeformParams(**values) == params


def test_parameters_go_by_keyword():
    with pytest.raises(TypeError):
        DeformParams("paper")


def test_numpy_numbers_are_numbers():
    assert DeformParams(influence=np.float64(0.4), max_nodes=np.int64(50)).max_nodes == 50


def test_a_deformer_takes_the_parameters_of_its_preset(silvermate):
    assert Deformer(silvermate).params == DeformParams()
    assert PaperDeformer(silvermate).params == PaperParams()
    for wrong in ("paper", {"influence": 0.3}, PaperParams()):
        with refused(ParameterError, "params"):
            Deformer(silvermate, wrong)
    with refused(ParameterError, "params"):
        PaperDeformer(silvermate, DeformParams())
