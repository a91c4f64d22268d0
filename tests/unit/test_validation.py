"""Checks of annotated fields: each kind of rule by itself, then every parameter class of the library."""

from __future__ import annotations

import dataclasses
import importlib
import math
import pickle
import re
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, get_args, get_type_hints

import numpy as np
import pytest
from cases import each, refused
from refusals import taken

import elastic_strips
from elastic_strips.control.tasks import DriveAndReach, DriveTo, ReachHand
from elastic_strips.errors import ParameterError
from elastic_strips.planning import BasePose, HandPose
from elastic_strips.sim import Fault
from elastic_strips.strip import AxisConstraint, LookAt, OrientationConstraint
from elastic_strips.trajectory import MotionLimits
from elastic_strips.validation import Bound, Count, Finite, Fraction, NonNegative, Positive, Whole, check_fields


@dataclasses.dataclass(frozen=True, slots=True, kw_only=True)
class Inner:
    size: Positive = 1.0

    def __post_init__(self) -> None:
        check_fields(self)


@dataclasses.dataclass(frozen=True, slots=True, kw_only=True)
class Sample(Inner):
    any: ClassVar[float] = math.nan
    finite: Finite = -1.0
    zero: NonNegative = 0.0
    part: Fraction = 0.5
    count: Count = 1
    whole: Whole = 0
    few: Annotated[int, Bound(low=2, high=4)] = 3
    length: Annotated[float, Bound(low=1.0, below=2.0, unit="m")] = 1.0
    period: Annotated[float, Bound(above=0.0, infinite=True)] = math.inf
    kind: Literal["left", "right"] = "left"
    name: str = "a"
    on: bool = True
    inner: Inner = dataclasses.field(default_factory=Inner)
    other: Inner | None = None
    limit: Positive | None = None
    side: Literal["up", "down"] | None = None
    speeds: tuple[Fraction, ...] = (1.0, 0.5)
    free: tuple[float, float] = (0.0, -1.0)


@each(
    "name, wrong, message",
    [
        ("size", 0.0, r"Sample\.size=0\.0 must be a finite number > 0"),
        ("finite", math.inf, r"Sample\.finite=inf must be a finite number"),
        ("finite", "1", r"Sample\.finite='1' must be a finite number"),
        ("finite", True, r"Sample\.finite=True must be a finite number"),
        ("zero", -1e-9, r"Sample\.zero=-1e-09 must be a finite number ≥ 0"),
        ("part", 1.1, r"Sample\.part=1\.1 must be a finite number ≥ 0 and ≤ 1"),
        ("count", 0, r"Sample\.count=0 must be a whole number ≥ 1"),
        ("count", 1.0, r"Sample\.count=1\.0 must be a whole number ≥ 1"),
        ("whole", -1, r"Sample\.whole=-1 must be a whole number ≥ 0"),
        ("few", 1, r"Sample\.few=1 must be a whole number ≥ 2 and ≤ 4"),
        ("few", 5, r"Sample\.few=5 must be a whole number ≥ 2 and ≤ 4"),
        ("length", 2.0, r"Sample\.length=2\.0 must be a finite number of m ≥ 1 and < 2"),
        ("period", 0.0, r"Sample\.period=0\.0 must be a finite number > 0 or inf"),
        ("period", -math.inf, r"Sample\.period=-inf must be a finite number > 0 or inf"),
        ("period", math.nan, r"Sample\.period=nan must be a finite number > 0 or inf"),
        ("kind", "lef", r"Sample\.kind='lef' is unknown; did you mean 'left'\? Valid: left, right"),
        ("kind", None, r"Sample\.kind=None is unknown"),
        ("speeds", (), r"Sample\.speeds=\(\) must be a tuple of one entry at least"),
        ("speeds", [1.0], r"Sample\.speeds=\[1\.0\] must be a tuple of one entry at least"),
        ("speeds", (1.0, math.nan), r"Sample\.speeds\[1\]=nan must be a finite number ≥ 0 and ≤ 1"),
        ("name", 3, r"Sample\.name=3 must be a text that is not blank"),
        ("name", " ", r"Sample\.name=' ' must be a text that is not blank"),
        ("on", 1, r"Sample\.on=1 must be True or False"),
        ("inner", None, r"Sample\.inner must be an Inner, not None"),
        ("other", "x", r"Sample\.other must be an Inner or None, not str: 'x'"),
        ("limit", 0.0, r"Sample\.limit=0\.0 must be a finite number > 0"),
        ("side", "upp", r"Sample\.side='upp' is unknown; did you mean 'up'"),
    ],
)
def test_every_kind_of_rule_can_fail(name, wrong, message):
    Sample()
    with pytest.raises(ParameterError, match=message):
        Sample(**{name: wrong})
    with pytest.raises(ParameterError, match=message):
        dataclasses.replace(Sample(), **{name: wrong})


def test_what_is_taken():
    good = Sample(
        size=np.float64(2.0), zero=np.array(1.0), part=1, count=np.int64(3), few=4, period=3.0, kind="right",
        other=Sample(), limit=1e-9, side="up", free=(-1.0, 2.0),
    )  # fmt: skip
    assert pickle.loads(pickle.dumps(good)) == dataclasses.replace(good) == good


def test_a_number_without_a_bound_is_an_error_of_the_class():
    Unsaid = dataclasses.make_dataclass("Unsaid", [("size", float)])
    with refused(TypeError, "Bound"):
        check_fields(Unsaid(1.0))


def test_the_name_in_messages():
    wrong = Inner()
    object.__setattr__(wrong, "size", -1.0)
    with refused(ParameterError, "Inner", "('a')", "size=-1.0"):
        check_fields(wrong, "Inner('a')")


NEEDED: dict[type, dict[str, Any]] = {
    Fault: {"kind": "scene_late", "start": 1.0},
    DriveTo: {"x": 0.0, "y": 0.0, "yaw": 0.0},
    ReachHand: {"position": (0.0, 0.0, 1.0)},
    HandPose: {"frame": "hand_frame", "position": (0.0, 0.0, 1.0)},
    BasePose: {"x": 0.0, "y": 0.0},
    DriveAndReach: {"drive": DriveTo(0.0, 0.0, 0.0), "reach": ReachHand((0.0, 0.0, 1.0))},
    AxisConstraint: {"frame": "hand_frame"},
    OrientationConstraint: {"frame": "hand_frame"},
    LookAt: {"frame": "hand_frame", "at": (1.0, 0.0, 1.0)},
    MotionLimits: {
        "track": 0.4, "wheel_radius": 0.1, "drive_speed": (1.0, 1.0), "drive_acceleration": (1.0, 1.0),
        "joint_speed": (1.0,), "joint_acceleration": (1.0,),
    },
}  # fmt: skip


def parameter_classes() -> list[type]:
    """All classes whose fields are checked, and that can be made."""
    package = Path(elastic_strips.__file__).parent
    found = []
    for path in sorted(package.rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        if re.search("Checked|check_fields|Positive", text) and path.name != "validation.py":
            module = importlib.import_module(".".join(path.relative_to(package.parent).with_suffix("").parts))
            found += [c for c in vars(module).values() if isinstance(c, type) and c.__module__ == module.__name__]
    bases = ("StripParams", "RangeParams", "RingParams", "ImageParams")
    return [c for c in found if hasattr(c, "__post_init__") and c.__name__ not in bases]


CLASSES = parameter_classes()


def numbers(kind: type) -> list[tuple[str, Bound]]:
    hints = get_type_hints(kind, include_extras=True)
    fields = {f.name: get_args(hints[f.name])[1:] for f in dataclasses.fields(kind)}
    return [(name, extra[0]) for name, extra in fields.items() if extra and isinstance(extra[0], Bound)]


def test_all_of_them_are_found():
    assert {"DeformParams", "DriveParams", "MotionLimits", "PlantParams"} <= {kind.__name__ for kind in CLASSES}
    assert len(CLASSES) > 20
    assert sum(len(numbers(kind)) for kind in CLASSES) > 100


@each("kind", CLASSES, ids=lambda kind: kind.__name__)
def test_what_is_no_number_is_refused(kind):
    needed, fields = NEEDED.get(kind, {}), numbers(kind)
    values = (math.nan, -math.inf, "1", None, True, [1.0], 1j)
    given = [{**needed, name: value} for name, _ in fields for value in values]
    given += [{**needed, name: math.inf} for name, bound in fields if not bound.infinite]
    assert taken(kind, given) == []


@each("kind", CLASSES, ids=lambda kind: kind.__name__)
def test_they_are_copied_and_pickled(kind):
    made = kind(**NEEDED.get(kind, {}))
    for copy in (dataclasses.replace(made), pickle.loads(pickle.dumps(made))):
        assert repr(copy) == repr(made)


def test_inf_is_taken_where_it_says_something():
    assert {(kind.__name__, name) for kind in CLASSES for name, bound in numbers(kind) if bound.infinite} == {
        ("DriveParams", "turn_speed"),
        ("OdometryParams", "fix_period"),
        ("PlantParams", "acceleration_margin"),
        ("PlantParams", "speed_margin"),
        ("Tolerance", "joints"),
        ("Tolerance", "position"),
        ("Tolerance", "yaw"),
    }
