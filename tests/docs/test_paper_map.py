"""The paper's map is whole, and leads somewhere: every equation, box, figure and table has names that are there.

A name is whatever stands in backticks in a table's column that is headed *here*; it is dotted, below `elastic_strips`.
Elsewhere on the page a name is what stands in backticks and is dotted; other code, such as a command, is not.
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import numpy as np
import pytest
from cases import each

from elastic_strips.sim.scenarios.paper_cases import TABLE_1, TABLE_2
from elastic_strips.strip.paper import PaperParams

PAGE = Path(__file__).resolve().parents[2] / "docs" / "paper-map.md"
PACKAGE = "elastic_strips"
WORKSHOP = "workshop"
MAPPED = "here"
"""Heading of the columns that hold names."""
CODE = re.compile(r"`([^`]+)`")
DOTTED = re.compile(r"[a-z_]+(\.\w+)+")

EQUATIONS = [f"({number})" for number in range(1, 10)]
LAYERS = [
    "deliberative layer", "its knowledge", "task decision", "command to instructions", "navigation", "manipulation",
    "motion planner", "sequencing layer", "sensor information", "information in sequence", "reactive layer",
    "reaction to obstacles", "change of the environment",
]  # fmt: skip
MODULES = [
    "resources: sensors", "resources: actuators", "obstacle avoidance", "master: obstacle detection",
    "master: local localization", "master: avoidance algorithm", "master: velocity of the mobile",
    "slave: check of joint angles", "slave: mapping of joint torques", "slave: velocity of the manipulator",
]  # fmt: skip
METHODS = ["certainty grid", "APF", "VFF", "VFH", "elastic band", "elastic strip"]
PRINTED = [*(f"Fig. {number}" for number in range(1, 12)), "Table 1", "Table 2"]


class Row(NamedTuple):
    """A row of a table: the section it is in, its cells by their headings, and its first cell."""

    section: str
    cells: dict[str, str]
    first: str

    @property
    def names(self) -> list[str]:
        """What its mapping column names."""
        return CODE.findall(self.cells.get(MAPPED, ""))


def rows() -> Iterator[Row]:
    """Every row of every table."""
    section, heading = "", list[str]()
    for line in PAGE.read_text(encoding="utf-8").splitlines():
        if line.startswith("## "):
            section = line[3:]
        if not line.startswith("|"):
            heading = []
            continue
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
        if not heading:
            heading = cells
        elif set(line) - set("|-: "):
            assert len(cells) == len(heading), f"{PAGE.name}: {line}"
            yield Row(section, dict(zip(heading, cells, strict=True)), cells[0])


ROWS = list(rows())
NAMES = sorted(
    {name for row in ROWS for name in row.names}
    | {code for code in CODE.findall(PAGE.read_text(encoding="utf-8")) if DOTTED.fullmatch(code)}
)


def annotated(owner: object, part: str) -> bool:
    """Whether a class says that its instances have an attribute, such as a dataclass's field without a default."""
    return isinstance(owner, type) and any(part in vars(c).get("__annotations__", {}) for c in owner.__mro__)


def resolve(name: str) -> None:
    """Go from the package to what a dotted name means.

    Raises:
        LookupError: a part of it is not there.
    """
    parts = name.split(".")
    found: object = importlib.import_module(PACKAGE)
    if parts[0] == WORKSHOP:
        found, parts = importlib.import_module(WORKSHOP), parts[1:]
    for k, part in enumerate(parts):
        if hasattr(found, part):
            found = getattr(found, part)
            continue
        if isinstance(found, ModuleType):
            module = f"{found.__name__}.{part}"
            try:
                found = importlib.import_module(module)
            except ModuleNotFoundError as error:
                if error.name == module:
                    raise LookupError(f"{name}: {found.__name__} has no {part!r}") from None
                raise
            continue
        if k == len(parts) - 1 and annotated(found, part):
            return
        raise LookupError(f"{name}: {'.'.join(parts[:k])} has no {part!r}")


def public(name: str) -> bool:
    """Whether a name is for others: no part begins with _, and what a room itself is said to have, it exports."""
    parts = name.split(".")
    if any(part.startswith("_") for part in parts):
        return False
    room, k = importlib.import_module(parts[0] if parts[0] == WORKSHOP else f"{PACKAGE}.{parts[0]}"), 1
    while hasattr(getattr(room, parts[k], None), "__path__"):  # a room below it
        room, k = getattr(room, parts[k]), k + 1
    inside = isinstance(getattr(room, parts[k], None), ModuleType)
    return inside or parts[k] in getattr(room, "__all__", [parts[k]])


def of(section: str) -> dict[str, Row]:
    """A section's rows by their first cells."""
    found = {row.first: row for row in ROWS if row.section == section}
    assert found, f"{PAGE.name} has no table under {section!r}"
    return found


def fault(name: str) -> str:
    """What is wrong with a name; empty where nothing is."""
    if not DOTTED.fullmatch(name):
        return f"{name!r} stands in a column {MAPPED!r} and is no dotted name"
    try:
        resolve(name)
    except LookupError as error:
        return str(error)
    return "" if public(name) else f"{name} is private"


def test_all_names_are_there() -> None:
    assert len(NAMES) > 100
    assert [found for name in NAMES if (found := fault(name))] == []


@each(
    "name",
    ["strip.forces.no_such_force", "no_such_room.Thing", "strip.DeformParams.no_such_field", "strip.Strip.q.shape"],
)
def test_what_is_not_there_is_noticed(name: str) -> None:
    with pytest.raises(LookupError):
        resolve(name)


@pytest.mark.parametrize("name", ["strip.paper.PaperDeformer._check_joint_angles", "workshop.baselines.annotations"])
def test_what_is_private_or_borrowed_is_noticed(name: str) -> None:
    resolve(name)
    assert not public(name)


def test_fields_without_a_default_are_found() -> None:
    resolve("strip.Strip.q")
    resolve("collision.narrowphase.Contacts.distance")
    resolve("strip.DeformParams.influence")


@each(
    "section, wanted",
    [
        ("Equations", EQUATIONS),
        ("Fig. 1, box by box", LAYERS),
        ("Fig. 2, box by box", MODULES),
        ("Figures and tables", PRINTED),
    ],
)
def test_nothing_is_left_out(section: str, wanted: list[str]) -> None:
    found = of(section)
    for first in wanted:
        assert first in found, f"{section}: {first} is not on the page"
        assert found[first].names, f"{section}: {first} names nothing"


@each("method", METHODS)
def test_methods_are_there(method: str) -> None:
    assert any(method in first and row.names for first, row in of("Methods that the paper names").items())


@pytest.mark.parametrize("section", ["Fig. 1, box by box", "Fig. 2, box by box"])
def test_boxes_say_what_the_paper_says(section: str) -> None:
    for first, row in of(section).items():
        assert row.cells["what the paper says of it"], f"{section}: {first}"


def test_result_figures_are_of_their_cases() -> None:
    """Fig. 5 is case 1, and so on; the pictures are called as the study calls them."""
    found = of("Figures and tables")
    for number, case in enumerate(TABLE_2, 5):
        row = found[f"Fig. {number}"]
        assert row.cells["shows"] == case.replace("-", " ")
        assert row.cells["picture"] == f"fig-{number:02d}-{case}.png"
        assert "workshop.study.paper_study" in row.names


def test_printed_tables_are_those_of_the_cases() -> None:
    one, two = of("Table 1"), of("Table 2")
    assert {"initial position", "target position", "direction of the initial robot"} <= set(one)
    assert one["k_c, k_r"].cells["paper"] == f"{TABLE_1['k_c']}, {TABLE_1['k_r']}"
    assert len(two) == len(TABLE_2)
    for case, (tilt, safe, gap) in TABLE_2.items():
        cells = two[case.removeprefix("case-")].cells
        assert cells["transfer tilt [rad]"] == f"π/{np.pi / tilt:.0f}"
        assert cells["safe distance [mm]"] == f"{1e3 * safe:.0f}"
        assert cells["distance between the obstacles [mm]"] == ("–" if gap is None else f"{1e3 * gap:.0f}")


def test_values_are_those_of_the_preset() -> None:
    params = PaperParams().as_dict()
    values = re.findall(r"`strip\.paper\.PaperParams\.(\w+)` = ([\d.]+)", PAGE.read_text(encoding="utf-8"))
    assert len(values) >= 3
    for name, value in values:
        assert params[name] == float(value)
