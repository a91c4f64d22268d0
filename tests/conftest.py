"""What all tests share: one of each robot per session, their marks, and that no test leaves anything set."""

from __future__ import annotations

import gc
import os
import pickle
import random
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import settings

from elastic_strips.robot import RobotModel, load_robot

sys.path.insert(0, str(Path(__file__).parent / "oracle"))
sys.path.append(str(Path(__file__).parents[1]))  # the workshop, which is no part of the package

import marks
import process_state

os.environ.pop("FORCE_COLOR", None)  # what is printed is compared as plain text

# The same examples everywhere, and no limit on the time of one: what is green here is green on a busy machine, too.
settings.register_profile("elastic_strips", deadline=None, derandomize=True)
settings.load_profile("elastic_strips")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--shuffle", type=int, metavar="SEED", help="files, and the tests in each, in an order of this seed"
    )
    parser.addoption("--brief", action="store_true", help="leave out what tests/thorough.txt lists")
    parser.addoption("--write-slow", action="store_true", help="measure which tests are slow, for tests/slow.txt")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    listed = marks.slow()
    for item in items:
        marks.mark(item, listed)
    marks.check_kept(items)
    if config.getoption("brief"):
        left_out = [item for item in items if item.get_closest_marker("thorough")]
        config.hook.pytest_deselected(items=left_out)
        items[:] = [item for item in items if not item.get_closest_marker("thorough")]
    seed = config.getoption("shuffle")
    if seed is not None:  # by files, so that what the tests of one share is still made once
        order, files = random.Random(seed), {}
        for item in items:
            files.setdefault(item.path, []).append(item)
        rows = list(files.values())
        order.shuffle(rows)
        for row in rows:
            order.shuffle(row)
        items[:] = [item for row in rows for item in row]


def pytest_collection_finish() -> None:
    gc.freeze()  # thousands of tests and all modules need not be looked through again and again


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    with marks.guarded(item):
        return (yield)


_took: dict[str, float] = {}  # [s] of a processor, with the processes that it waited for


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    began = sum(os.times()[:4])
    try:
        return (yield)
    finally:
        item.user_properties.append(("cpu", sum(os.times()[:4]) - began))


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    if report.when == "call":
        name = marks.name_of(report.nodeid)
        _took[name] = _took.get(name, 0.0) + float(dict(report.user_properties).get("cpu", 0.0))


def pytest_sessionfinish(session: pytest.Session) -> None:
    if session.config.getoption("write_slow") and not hasattr(session.config, "workerinput"):
        marks.measured(_took)


@pytest.fixture(scope="session")
def brief(request: pytest.FixtureRequest) -> bool:
    """Whether a test takes fewer samples, as many as show the same: ``scripts/test`` without ``--all``."""
    return bool(request.config.getoption("brief"))


@pytest.fixture(autouse=True)
def nothing_is_left_set() -> Iterator[None]:
    """Whatever a test leaves set is an error of that test: else another fails for it, in some orders of the tests."""
    before = process_state.settings()
    yield
    changed = process_state.changed(before)
    assert not changed, "this test leaves " + "; ".join(changed)


GANTRY = """<robot name="gantry">
  <link name="rail"><collision><origin xyz="0 0 0.05"/><geometry><box size="0.6 0.3 0.1"/></geometry></collision></link>
  <link name="carriage">
    <collision><origin xyz="0.02 0 0.03" rpy="0.2 0 0"/><geometry><box size="0.12 0.1 0.2"/></geometry></collision>
  </link>
  <link name="spindle">
    <collision><origin xyz="0 0 0.1" rpy="0.3 -0.4 0.1"/>
      <geometry><cylinder radius="0.04" length="0.2"/></geometry></collision>
  </link>
  <link name="finger">
    <collision><origin xyz="0.1 0 0" rpy="0 1.5708 0"/>
      <geometry><cylinder radius="0.03" length="0.2"/></geometry></collision>
    <collision><origin xyz="0.2 0 0"/><geometry><sphere radius="0.05"/></geometry></collision>
  </link>
  <link name="camera"><collision><geometry><sphere radius="0.06"/></geometry></collision></link>
  <link name="tip"/>
  <joint name="slide" type="prismatic"><parent link="rail"/><child link="carriage"/>
    <origin xyz="0.05 0.02 0.3" rpy="0.1 -0.3 0.4"/><axis xyz="0.3 -0.4 0.866"/>
    <limit lower="-0.2" upper="0.35" velocity="1" effort="10"/></joint>
  <joint name="spin" type="continuous"><parent link="carriage"/><child link="spindle"/>
    <origin xyz="0.01 0.1 0.15" rpy="-0.2 0.5 0"/><axis xyz="1 0 0"/></joint>
  <joint name="bend" type="revolute"><parent link="spindle"/><child link="finger"/>
    <origin xyz="0 0.05 0.25" rpy="0 0.2 1"/><axis xyz="0 0 -1"/>
    <limit lower="-1.5" upper="2.5" velocity="1" effort="10"/></joint>
  <joint name="nod" type="revolute"><parent link="carriage"/><child link="camera"/>
    <origin xyz="-0.25 -0.1 0.3" rpy="0.7 0 0"/><axis xyz="0 1 0"/>
    <limit lower="0.1" upper="0.9" velocity="1" effort="10"/></joint>
  <joint name="tip_joint" type="fixed"><parent link="finger"/><child link="tip"/><origin xyz="0.25 0.01 0"/></joint>
</robot>
"""
"""A branched robot with every planned kind of joint: prismatic, continuous (nq = 2), revolute; about oblique axes."""

COLUMN = """<robot name="column">
  <link name="foot"><collision><origin xyz="0 0 0.1"/><geometry><box size="0.5 0.4 0.2"/></geometry></collision></link>
  <link name="stage"><collision><geometry><box size="0.12 0.12 0.3"/></geometry></collision></link>
  <link name="top"><collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>
  <link name="weight"><collision><geometry><sphere radius="0.15"/></geometry></collision></link>
  <link name="upper"><collision><origin xyz="0.15 0 0"/><geometry><box size="0.3 0.05 0.06"/></geometry></collision>
  </link>
  <link name="fore"><collision><origin xyz="0.12 0 0" rpy="0.1 1.5708 0"/>
    <geometry><cylinder radius="0.03" length="0.22"/></geometry></collision></link>
  <link name="hand"><collision><origin xyz="0.06 0.03 0"/><geometry><box size="0.1 0.04 0.03"/></geometry></collision>
  </link>
  <link name="gear"><collision><origin xyz="0 0.04 0"/><geometry><sphere radius="0.02"/></geometry></collision></link>
  <link name="pinion"><collision><origin xyz="0.03 0 0"/><geometry><sphere radius="0.02"/></geometry></collision></link>
  <joint name="a_stage" type="prismatic"><parent link="foot"/><child link="stage"/>
    <origin xyz="0.1 0.02 0.5" rpy="0.05 -0.1 0.4"/><axis xyz="0.6 0 0.8"/>
    <limit lower="0" upper="0.3" velocity="0.1" effort="10"/>
    <mimic joint="lift" multiplier="0.5" offset="0.01"/></joint>
  <joint name="lift" type="prismatic"><parent link="stage"/><child link="top"/>
    <origin xyz="0 0 0.35"/><axis xyz="0 0 1"/>
    <limit lower="0" upper="0.4" velocity="0.3" effort="10"/></joint>
  <joint name="balance" type="prismatic"><parent link="foot"/><child link="weight"/><origin xyz="-0.3 0 0.3"/>
    <axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="1" effort="10"/>
    <mimic joint="a_stage" multiplier="-1.5" offset="0.35"/></joint>
  <joint name="shoulder" type="revolute"><parent link="top"/><child link="upper"/>
    <origin xyz="0.08 0 0.05" rpy="0.1 0 0.2"/><axis xyz="0.2 -0.9 0.1"/>
    <limit lower="-2.2" upper="2.2" velocity="1" effort="10"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="fore"/><origin xyz="0.32 0.05 0"/>
    <axis xyz="0 1 0"/><limit lower="-3.1" upper="3.1" velocity="1" effort="10"/>
    <mimic joint="shoulder" multiplier="1.4" offset="-0.2"/></joint>
  <joint name="roll" type="continuous"><parent link="fore"/><child link="hand"/>
    <origin xyz="0.26 0 0" rpy="0 0.2 0.1"/><axis xyz="0.9 0.1 0.3"/>
    <limit velocity="2" effort="10"/></joint>
  <joint name="cog" type="continuous"><parent link="hand"/><child link="gear"/><origin xyz="0.15 0.05 0"/>
    <axis xyz="0.1 0.3 0.9"/><mimic joint="roll" multiplier="-2" offset="0.3"/></joint>
  <joint name="tooth" type="continuous"><parent link="gear"/><child link="pinion"/><origin xyz="0.05 0.05 0.03"/>
    <axis xyz="0 0 1"/><mimic joint="cog" multiplier="-1"/></joint>
</robot>
"""
"""Joints that follow others: before their leader on the way and after it, in another branch, along chains, around."""


@pytest.fixture(scope="session")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., RobotModel]:
    """Robots that take seconds to load: the first worker of several that needs one leaves it to the others, pickled."""
    several = "PYTEST_XDIST_WORKER" in os.environ
    folder = tmp_path_factory.getbasetemp().parent if several else tmp_path_factory.mktemp("robots")

    def load(label: str, name: str, **options: Any) -> RobotModel:
        file = folder / f"{label}.robot"
        if not file.exists():
            mine = file.with_suffix(f".{os.getpid()}")
            mine.write_bytes(pickle.dumps(load_robot(name, **options)))
            mine.replace(file)
        return pickle.loads(file.read_bytes())

    return load


@pytest.fixture(scope="session")
def silvermate() -> RobotModel:
    return load_robot("silvermate")


@pytest.fixture(scope="session")
def tiago(shared: Callable[..., RobotModel]) -> RobotModel:
    return shared("tiago", "tiago")


@pytest.fixture(scope="session")
def tiago_omni(shared: Callable[..., RobotModel]) -> RobotModel:
    """Its arm lies tucked at its body."""
    return shared("tiago_omni", "tiago", base="omni")


@pytest.fixture(scope="session")
def looking_tiago(shared: Callable[..., RobotModel]) -> RobotModel:
    """Its head looks."""
    return shared("looking_tiago", "tiago", looking=["head_1_joint", "head_2_joint"])


@pytest.fixture(scope="session")
def jackal_box() -> RobotModel:
    """A robot without an arm: no joint is planned."""
    return load_robot("jackal-box")


@pytest.fixture(scope="session")
def bridge_arm() -> RobotModel:
    return load_robot("bridge-arm")


@pytest.fixture(scope="session")
def gantry_urdf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("urdf") / "gantry.urdf"
    path.write_text(GANTRY)
    return path


@pytest.fixture(scope="session")
def gantry(gantry_urdf: Path) -> RobotModel:
    """The gantry on a fixed base."""
    return load_robot(gantry_urdf, base="fixed")


@pytest.fixture(scope="session")
def rover(gantry_urdf: Path) -> RobotModel:
    """The gantry on an omnidirectional base."""
    return load_robot(gantry_urdf, base="omni")


@pytest.fixture(scope="session")
def column_urdf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("urdf") / "column.urdf"
    path.write_text(COLUMN)
    return path


@pytest.fixture(scope="session")
def column(column_urdf: Path) -> RobotModel:
    """A robot of which three joints are planned and five follow, on an omnidirectional base."""
    return load_robot(column_urdf, base="omni", joints=["lift", "shoulder", "roll"])


@pytest.fixture(params=["silvermate", "tiago", "gantry", "rover", "column"])
def robot(request: pytest.FixtureRequest) -> RobotModel:
    """Each robot in turn."""
    return request.getfixturevalue(request.param)


@pytest.fixture(scope="session")
def chromium() -> str:
    """Path of a Chromium; who draws with one is skipped where there is none."""
    from elastic_strips.viewer.browser import find_browser

    path = find_browser()
    if path is None:
        pytest.skip("no chromium")
    return path


@pytest.fixture
def own_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Time limits of planning count the time of the thread that plans: how busy the machine is decides nothing."""
    from elastic_strips.planning import problem

    monkeypatch.setattr(problem, "perf_counter", time.thread_time)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20240607)
