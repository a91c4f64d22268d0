"""Parameters of range sensors: what is out of bounds is refused with name, value and bound."""

from __future__ import annotations

import math
import pickle
from dataclasses import replace

import numpy as np
from cases import each, refused
from refusals import taken

from elastic_strips.errors import ParameterError
from elastic_strips.sim.sensors import InfraredParams, LaserParams, SensorConfig, SonarParams

ALL = (LaserParams, SonarParams, InfraredParams)


@each("make", ALL)
def test_values_out_of_bounds(make):
    wrong = [
        ("range_min", -0.1),
        ("range_max", math.nan),
        ("range_max", 0.01),
        ("rate", 0.0),
        ("rate", 2000.0),
        ("latency", -1e-3),
        ("latency", math.inf),
        ("noise", -1.0),
        ("noise_ratio", 1.1),
        ("dropout", 1.5),
        ("dropout", "0.5"),
        ("dropout", True),
        ("rays", 0),
        ("rays", 3.0),
        ("name", ""),
        ("near_reads_min", 1),
    ]
    assert taken(make, [{key: value} for key, value in wrong]) == []


def test_rings_out_of_bounds():
    wrong = [
        ("kind", "radar"),
        ("frames", ()),
        ("frames", "sonar_0_frame"),
        ("frames", ("a", "a")),
        ("half_angle", 1.6),
        ("max_incidence", -0.1),
        ("crosstalk", 1.01),
        ("groups", 0),
        ("groups", 13),
    ]
    assert taken(SonarParams, [{key: value} for key, value in wrong]) == []


def test_lasers_out_of_bounds():
    assert taken(LaserParams, [{"field_of_view": 6.3}, {"field_of_view": -1.0}, {"frame": ""}]) == []


def test_messages_name_value_and_bound():
    with refused(ParameterError, "SonarParams", "('sonar')", "dropout=1.5"):
        SonarParams(dropout=1.5)
    with refused(ParameterError, "'sonar'"):
        SonarParams(kind="sonars")  # type: ignore[arg-type]


def test_names_are_unique():
    with refused(ParameterError, "'laser'"):
        SensorConfig(sensors=(LaserParams(), LaserParams(frame="other")))
    with refused(ParameterError, "'laser'"):
        SensorConfig(sensors=("laser",))  # type: ignore[arg-type]
    with refused(ParameterError, "self_padding"):
        SensorConfig(self_padding=-0.01)


def test_values_of_parameters():
    config = SensorConfig(sensors=[SonarParams(frames=["a", "b"], groups=1)])  # type: ignore[arg-type]
    assert config.names == ("sonar",)
    assert config.sensors[0].frames == ("a", "b")  # type: ignore[union-attr]
    assert pickle.loads(pickle.dumps(SensorConfig())) == SensorConfig()
    assert replace(LaserParams(), noise=np.float64(0.1)).noise == 0.1
