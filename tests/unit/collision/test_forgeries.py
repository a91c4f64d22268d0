"""Proofs that are forged are refused, for what is forged; and what they are like, and is true, is taken."""

from __future__ import annotations

import sys
from pathlib import Path

import forgeries
import more_forgeries
import numpy as np
import pytest
from cases import each
from forgeries import FORGERIES, Claim, archives, true_claims, verdict

from elastic_strips import proof_checker as checker

FALSE = {**FORGERIES, **{f"more: {k}": v for k, v in (more_forgeries.GEOMETRY | more_forgeries.STATEMENTS).items()}}


def test_what_is_true_is_taken(tmp_path):
    for claims in (true_claims(), more_forgeries.true_claims()):
        assert [name for name, made in claims.items() if verdict(made.save(tmp_path / "proof.npz"))[0] != 0] == []


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize(("kind", "name"), [(kind, name) for kind in FALSE for name in FALSE[kind]])
def test_forgeries_are_refused(kind, name, tmp_path):
    made = FALSE[kind][name]()
    code, said = verdict(made.save(tmp_path / "proof.npz"))
    assert code in (2, 3)
    assert said.startswith("REFUSED")
    if FALSE[kind] in more_forgeries.GEOMETRY.values():
        assert more_forgeries.touches(made), "it is true, by a walk that has nothing of the checker"


def test_what_is_said_to_be_free_is_free():
    for name, made in more_forgeries.true_claims().items():
        assert not more_forgeries.touches(made, samples=31), name


def test_a_forgery_is_no_work(tmp_path, monkeypatch):
    """What is refused for its size is so before it is looked at: no gap is asked for, no table is made."""

    def looked(*_: object) -> None:
        raise AssertionError("looked at")

    names = ("joints", "lists", "digits", "deep")
    made = {name: more_forgeries.CROWDS[name]() for name in names}
    monkeypatch.setattr(checker.Path, "gaps", looked)
    monkeypatch.setattr(checker.np, "indices", looked)
    for name in names:
        code, said = verdict(made[name].save(tmp_path / "proof.npz"))
        assert code in (2, 3), name
        assert "looked at" not in said, name


def test_more_work_than_it_takes_is_refused_and_what_it_takes_is_bounded(tmp_path, monkeypatch):
    """Of many shapes, joints or points: the same statement is refused where less work is allowed."""
    for name, change in (("joints", {"joints": 40}), ("points", {"points": 300}), ("bodies", {"bodies": 60})):
        made = more_forgeries._crowd(**{"bodies": 1, "obstacles": 1, "segments": 500, **change})
        few = more_forgeries._crowd(1, 1, segments=500)
        monkeypatch.setattr(checker, "MOST_WORK", 2000.0)
        assert "short" in verdict(few.save(tmp_path / "proof.npz"))[1]
        assert "too much" in verdict(made.save(tmp_path / "proof.npz"))[1], name


@pytest.mark.filterwarnings("ignore:Duplicate name")
@pytest.mark.skipif(sys.platform == "win32", reason="resource")
def test_archives_that_are_none_are_refused_in_little_memory(tmp_path):
    import resource

    files = archives(tmp_path, bomb_megabytes=201) | more_forgeries.archives(tmp_path)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for name, file in files.items():
        assert verdict(file)[0] in (2, 3), name
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 150_000  # [kB]; the bomb holds more


@each("name", ["second root", "body of the world", "two followers"])
def test_a_checker_that_trusts_takes_them(name, tmp_path, monkeypatch):
    """What refuses these is what they are about: where all bodies are said to move with the first joint, they pass."""

    class Trusting(checker.World):
        def __init__(self, robot: checker.Part, scene: list[checker.Part]) -> None:
            super().__init__(robot, scene)
            self.carries[:] = True

    made: Claim = FORGERIES["who moves"][name]()
    assert verdict(made.save(tmp_path / "proof.npz"))[0] == 3
    monkeypatch.setattr(checker, "World", Trusting)
    assert verdict(made.save(tmp_path / "proof.npz"))[0] == 0


@each("seed", range(8))
def test_no_cover_of_what_touches_is_taken(seed, tmp_path):
    """Intervals and directions of all sorts, of a robot that touches."""
    rng = np.random.default_rng(seed)
    made = forgeries.claim(forgeries.rail(), forgeries.beside(1.0), [[0.0], [2.0]], pieces=int(rng.integers(1, 40)))
    count = len(made.parts["span"])
    for _ in range(20):
        cuts = np.sort(rng.uniform(0.0, 1.0, count - 1))
        made.parts["span"] = np.column_stack((np.r_[0.0, cuts], np.r_[cuts, 1.0]))
        made.parts["normal"] = rng.normal(size=(count, 2, 3)) * 10.0 ** rng.uniform(-2, 3)
        made.parts["normal"][rng.random(count) < 0.5] = (1.0, 0.0, 0.0)
        assert verdict(made.save(tmp_path / "proof.npz"))[0] == 3


def test_of_two_followers_each_joint_counts(tmp_path):
    """A column that carries two bodies towards each other: what is proven is what is so, at every distance."""
    for apart in (0.5, 1.9, 2.1, 2.5):
        joints = [
            forgeries.joint(-1, 0, forgeries.ALONG_X, slides=True),
            forgeries.joint(-1, 0, forgeries.ALONG_X, slides=True, multiplier=-1.0, constant=apart),
        ]
        bodies = [forgeries.ball((0, 0, 0), joint=0), forgeries.ball((0, 0, 0), joint=1)]
        robot = forgeries.Robot(joints, bodies, 1, pairs=[[0, 1]])
        made = forgeries.claim(robot, [], [[0.0], [0.9]], pieces=64)
        free = apart - 2.0 * 0.9 > 0.2
        assert (verdict(made.save(Path(tmp_path) / "proof.npz"))[0] == 0) == free
