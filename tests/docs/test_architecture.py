"""The page about the architecture names what is there, and what it says of imports holds."""

from __future__ import annotations

import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest
from cases import each

import elastic_strips

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
ROOMS = sorted(path.parent.name for path in (ROOT / "src" / "elastic_strips").glob("*/__init__.py"))
NAMES = sorted(set(re.findall(rf"`((?:{'|'.join(ROOMS)})(?:\.\w+)+)`", PAGE)))


def resolve(name: str) -> object:
    """What a dotted name below elastic_strips stands for."""
    value: object = elastic_strips
    path = "elastic_strips"
    for part in name.split("."):
        path = f"{path}.{part}"
        if not hasattr(value, part):
            importlib.import_module(path)
        value = getattr(value, part)
    return value


def test_there_are_names_to_look_for():
    assert len(NAMES) > 30


@each("name", NAMES)
def test_a_name_on_the_page_is_there(name):
    resolve(name)


def test_a_wrong_name_is_noticed():
    with pytest.raises((AttributeError, ImportError)):
        resolve("strip.Deformer.no_such_step")


def test_every_room_is_on_the_page():
    assert [room for room in ROOMS if f"`{room}`" not in PAGE] == []


def test_control_loads_no_module_of_sim():
    program = (
        "import sys, elastic_strips.control; print([m for m in sys.modules if m.startswith('elastic_strips.sim')])"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_picture_is_there():
    assert (ROOT / "docs" / "images" / "architecture.svg").is_file()
