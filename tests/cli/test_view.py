"""``elastic-strips view`` of a recorded drive: what is shown, and what is said where there is nothing to show."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from cases import each
from command_line import interrupted
from synthetic_run import moving_world, straight_run

from elastic_strips.cli import main
from elastic_strips.control import Record
from elastic_strips.io import read_record, write_record
from elastic_strips.robot import RobotModel
from elastic_strips.viewer import Viewer, animation, viewer
from elastic_strips.viewer.server import ServerError


def call(*arguments: object) -> int:
    """Exit code of a command line in this process."""
    with pytest.raises(SystemExit) as ended:
        main([str(a) for a in arguments])
    assert isinstance(ended.value.code, int)
    return ended.value.code


@pytest.fixture
def file(silvermate: RobotModel, tmp_path: Path) -> Path:
    return write_record(straight_run(silvermate, moving_world(), length=1.0), tmp_path / "run.npz")


def changed(file: Path, name: str, **values: object) -> Path:
    """A copy of a record with other metadata."""
    with np.load(file) as loaded:
        arrays = {key: loaded[key] for key in loaded.files}
    arrays["metadata"] = np.array(json.dumps(json.loads(str(arrays["metadata"])) | values))
    target = file.with_name(name)
    np.savez_compressed(target, **arrays)
    return target


@pytest.mark.parametrize(
    "options, play",
    [
        ((), {"speed": 1.0, "begin": None, "end": None}),
        (("--speed", "2", "--begin", "0.5", "--end", "1.5"), {"speed": 2.0, "begin": 0.5, "end": 1.5}),
        (("--robot", "silvermate", "--end", "1"), {"speed": 1.0, "begin": None, "end": 1.0}),
    ],
)
def test_a_record_is_replayed(
    silvermate: RobotModel, file: Path, options: tuple[str, ...], play: dict[str, float | None],
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    played, show = [], Viewer.replay

    def spy(self: Viewer, robot: RobotModel, record: Record, **how: float | None) -> Viewer:
        played.append((robot.joint_names, len(record.control), how))
        return show(self, robot, record, **how)  # type: ignore[arg-type]

    monkeypatch.setattr(Viewer, "replay", spy)
    page = file.with_name("page.html")
    assert call("view", file, *options, "--html", page) == 0
    assert capsys.readouterr().out == f"page    {page}\n"
    assert played == [(silvermate.joint_names, len(read_record(file).control), play)]
    text = page.read_text(encoding="utf-8")
    assert "<title>straight on</title>" in text
    assert len(text) > 500_000


@each("options, moment", [([], math.inf), (["--begin", 0.1], None)])
def test_a_picture_of_a_record_is_of_its_end(
    file: Path, options: list[object], moment: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As the picture of its drive is, or of where the replay is to begin."""
    asked = []
    monkeypatch.setattr(Viewer, "save_png", lambda self, name, time=None: asked.append(time) or name)
    assert call("view", file, *options, "--png", file.with_name("p.png")) == 0
    assert asked == [moment]


def test_a_robot_that_has_moved_is_named_by_an_option(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = file.with_name("page.html")
    moved = changed(file, "moved.npz", robot="mine", urdf="/no/longer/here.urdf")
    assert call("view", moved, "--html", page) == 2
    message = capsys.readouterr().err
    assert "moved.npz: /no/longer/here.urdf" in message
    assert "--robot FILE.urdf" in message
    assert call("view", moved, "--robot", "silvermate", "--html", page) == 0


def test_what_cannot_be_replayed_is_one_message(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, page = file.parent, file.with_name("page.html")
    (folder / "cut.npz").write_bytes(file.read_bytes()[:5000])
    (folder / "words.npz").write_text("no record")
    (folder / "rows.csv").write_text("time,state\n0.0,moving\n")
    (folder / "folder.npz").mkdir()
    (folder / "drive.json").write_text('{"format": "elastic-strips-drive", "version": 1}')
    changed(file, "next.npz", version=2)
    for arguments, message in (
        (["cut.npz"], "cut.npz: is damaged or cut off"),
        (["words.npz"], "words.npz: is"),
        (["rows.csv"], "elastic-strips certify"),
        (["my.urdf"], "elastic-strips robot"),
        (["gone.npz"], "gone.npz: cannot read the record: No such file"),
        (["folder.npz"], "folder.npz: is a folder, not a record"),
        (["next.npz"], "next.npz: has format version 2"),
        (["drive.json"], "--record"),
        (["run.npz", "--robot", "tiago"], "the record is of 'silvermate'"),
        (["run.npz", "--robot", "nobody"], "'nobody'"),
        (["run.npz", "--begin", "50"], "nothing to play from 50 to"),
        (["run.npz", "--speed", "nan"], "nan"),
        (["run.npz", "--speed", "0"], "--speed"),
        (["run.npz", "--seed", "1"], "--seed is not for a record"),
        (["run.npz", "--base", "omni"], "--base is not for a record"),
        (["case-1", "--end", "3"], "--end is not for a scenario"),
        (["drive.json", "--speed", "2"], "--speed is not for a result"),
    ):
        what = folder / arguments[0] if "." in arguments[0] else arguments[0]
        assert call("view", what, *arguments[1:], "--html", page) == 2, arguments
        errors = capsys.readouterr().err
        assert message in errors
        assert "Traceback" not in errors
        assert not page.exists()


def test_a_record_is_not_overwritten_by_its_page(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = file.read_bytes()
    assert call("view", file, "--html", file) == 2
    assert "named twice" in capsys.readouterr().err
    assert file.read_bytes() == before


def test_ctrl_c_closes_a_replay(file: Path) -> None:
    ended = interrupted(["view", "run.npz", "--no-browser"], file.parent, printed="127.0.0.1", after=0.3)
    assert ended.returncode in (0, 130), ended
    assert ended.stderr.strip() in ("", "interrupted")


def test_a_viewer_that_does_not_start_is_said(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(**_: object) -> None:
        raise ServerError("no socket is free")

    monkeypatch.setattr(viewer, "ServerProcess", refuse)
    assert call("view", "case-1") == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert "the viewer's server does not start" in printed.err


def test_a_picture_that_cannot_be_drawn_is_no_success(
    file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(*_: object) -> None:
        raise RuntimeError("no picture")

    monkeypatch.setattr(animation, "draw_run", fail)
    assert call("view", file, "--html", file.with_name("page.html")) == 2
    assert "could not be drawn" in capsys.readouterr().err
