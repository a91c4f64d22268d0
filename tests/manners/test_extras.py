"""What is not installed is said in one way, with the command that installs it; what is expected to fail is no wrong
input."""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path

import pytest
from cases import each

import elastic_strips as es
from elastic_strips.cli import main
from elastic_strips.errors import InputError, MissingExtraError, install_command
from elastic_strips.sim import PerceptionError
from elastic_strips.sim.scenarios import get_scenario
from elastic_strips.trajectory import RetimingError

if sys.version_info >= (3, 11):
    import tomllib
else:
    tomllib = pytest.importorskip("tomli")

PROJECT = Path(__file__).parents[2] / "pyproject.toml"


def _hide(monkeypatch: pytest.MonkeyPatch, package: str) -> None:
    for name in [m for m in sys.modules if m == package or m.startswith(package + ".")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, package, None)


def _mujoco(robot: es.RobotModel) -> object:
    from elastic_strips.sim.scenarios import make_simulation

    return make_simulation(get_scenario("case-1"), robot=robot, plant="mujoco")


def _tree(robot: es.RobotModel) -> object:
    from elastic_strips.control.tasks import SequencingLayer

    sys.modules.pop("elastic_strips.control.tasks.tree", None)
    return SequencingLayer(["drive"])


def _study(robot: es.RobotModel) -> object:
    from workshop.study import paper_study

    return paper_study("nowhere")


def _film(robot: es.RobotModel) -> object:
    return es.Viewer(server=False).save_film("film.gif")


def _parquet(robot: es.RobotModel) -> object:
    from elastic_strips.sim.sweep import Sweep, SweepStore

    return SweepStore(Sweep(Path("s.yaml"), "plan", ("case-1",)), "nowhere.parquet")


def _cluster(robot: es.RobotModel) -> object:
    from elastic_strips.sim.jobs import run_jobs

    return list(run_jobs(len, [""], scheduler="tcp://127.0.0.1:9"))


def _bag(robot: es.RobotModel) -> object:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "b.bag"
        file.write_bytes(b"#ROSBAG V2.0\n")
        return es.io.BagReader(file)


def _xacro(robot: es.RobotModel) -> object:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "r.urdf.xacro"
        file.write_text("<robot/>")
        return es.load_robot(file)


def _mcap(robot: es.RobotModel) -> object:
    trajectory = es.retime(es.Strip(robot, [robot.home(), robot.home(0.5)]))
    with tempfile.TemporaryDirectory() as folder:
        return es.io.write_trajectory(Path(folder) / "t.mcap", trajectory)


def _png(robot: es.RobotModel) -> object:
    with tempfile.TemporaryDirectory() as folder:
        text = (
            "image: map.png\nresolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.2\n"
        )
        (Path(folder) / "map.yaml").write_text(text)
        (Path(folder) / "map.png").write_bytes(b"\x89PNG")
        return es.io.load_nav2_map(Path(folder) / "map.yaml")


def _ros2(robot: es.RobotModel) -> object:
    from elastic_strips.ros2 import run_node

    return run_node()


@each(
    ("package", "extra", "use"),
    [
        ("mujoco", "sim", _mujoco),
        ("py_trees", "control", _tree),
        ("matplotlib", "study", _study),
        ("imageio", "film", _film),
        ("pyarrow", "sweep", _parquet),
        ("distributed", "sweep", _cluster),
        ("rosbags", "ros", _bag),
        ("rosbags", "ros", _mcap),
        ("xacro", None, _xacro),  # alone it is there in seconds
        ("pillow", "ros", _png),
        ("rclpy", "ros2", _ros2),
    ],
)
def test_a_missing_extra_is_said_with_the_command_that_installs_it(monkeypatch, silvermate, package, extra, use):
    _hide(monkeypatch, {"pillow": "PIL"}.get(package, package))
    with pytest.raises(MissingExtraError) as caught:
        use(silvermate)
    command = f"pip install {package}" if extra is None else install_command(extra)
    assert f"{package}, which is not installed: {command}" in str(caught.value)
    assert isinstance(caught.value, ImportError)


def test_an_extra_is_installed_from_where_the_library_came(monkeypatch, tmp_path):
    class Installed:
        record: str | None = None

        def read_text(self, _name):
            return self.record

    monkeypatch.setattr("importlib.metadata.distribution", lambda _name: Installed())
    there, gone = tmp_path.as_uri(), (tmp_path / "gone").as_uri()
    for record, command in [
        (None, "pip install 'elastic-strips[ros]'"),
        ("{not JSON", "pip install 'elastic-strips[ros]'"),
        (json.dumps({"url": gone, "dir_info": {}}), "pip install 'elastic-strips[ros]'"),
        (json.dumps({"url": there, "dir_info": {}}), f"pip install '{tmp_path}[ros]'"),
        (json.dumps({"url": there, "dir_info": {"editable": True}}), f"pip install -e '{tmp_path}[ros]'"),
        (
            json.dumps({"url": there, "vcs_info": {"vcs": "git", "commit_id": "0"}}),
            f"pip install 'elastic-strips[ros] @ git+{there}'",
        ),
        (
            json.dumps({"url": gone, "archive_info": {}}),
            f"pip install 'elastic-strips[ros] @ {gone}'",
        ),
    ]:
        Installed.record = record
        assert install_command("ros") == command


def test_a_drive_without_mujoco_ends_with_the_command_and_no_traceback(monkeypatch, capsys):
    _hide(monkeypatch, "mujoco")
    with pytest.raises(SystemExit) as ended:
        main(["drive", "case-1", "--plant", "mujoco"])
    told = capsys.readouterr().err.strip()
    assert ended.value.code == 2
    assert told.startswith("error: ")
    assert told.endswith(install_command("sim"))
    assert "\n" not in told


@each(
    ("package", "words"),
    [
        ("", "run case-7 --png a.png"),
        ("", "drive case-7 --film a.gif"),
        ("imageio", "drive case-7 --film a.gif"),
        ("imageio_ffmpeg", "run case-7 --film a.mp4"),
        ("rosbags", "run case-7 --trajectory a.mcap"),
        ("mujoco", "sweep sweep.yaml"),
        ("pyarrow", "sweep sweep.yaml --out a.parquet"),
        ("matplotlib", "sweep sweep.yaml --plot a.png"),
    ],
)
def test_what_is_missing_is_found_before_the_work(monkeypatch, capsys, tmp_path, package, words):
    """... and not after it; without a package it is Chromium that is missing."""
    monkeypatch.chdir(tmp_path)
    Path("sweep.yaml").write_text("kind: drive\nscenarios: [case-7]\nseeds: [0]\nfixed: {plant: mujoco}\n")
    browser = tmp_path / "chromium"
    browser.write_text("#!/bin/sh\n")
    browser.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path) if package else "/nowhere")
    monkeypatch.delenv("CHROMIUM", raising=False)
    if package:
        _hide(monkeypatch, package)
    for work in ("run_scenario", "make_simulation"):
        monkeypatch.setattr(f"elastic_strips.sim.scenarios.{work}", lambda *_, **__: pytest.fail("it has begun"))
    monkeypatch.setattr("elastic_strips.cli.sweep_command.run_sweep", lambda *_, **__: pytest.fail("it has begun"))
    with pytest.raises(SystemExit) as ended:
        main(words.split())
    told = capsys.readouterr().err.strip()
    assert ended.value.code == 2
    assert told.startswith("error: ")
    assert {"": "Chromium", "imageio_ffmpeg": "imageio-ffmpeg"}.get(package, package) in told
    assert {path.name for path in tmp_path.iterdir()} == {"sweep.yaml", "chromium"}


def test_what_the_notebooks_need_is_in_their_extra():
    extras = tomllib.loads(PROJECT.read_text())["project"]["optional-dependencies"]
    names = {line.split(">")[0] for line in extras["notebooks"]}
    assert {"ipywidgets", "matplotlib", "py_trees"} <= names


@each("error", [RetimingError, PerceptionError, MissingExtraError])
def test_an_expected_failure_is_no_wrong_input(error):
    assert issubclass(error, es.ElasticStripsError)
    assert not issubclass(error, InputError | ValueError)
