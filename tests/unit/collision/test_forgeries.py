"""Proofs that are forged are refused, for what is forged; and what they are like, and is true, is taken."""

from __future__ import annotations

import sys
from pathlib import Path

import forgeries
import numpy as np
import pytest
from forgeries import FORGERIES, Claim, archives, true_claims, verdict

from elastic_strips import proof_checker as checker


@pytest.mark.parametrize("name", true_claims())
def test_what_is_true_is_taken(name, tmp_path):
    assert verdict(true_claims()[name].save(tmp_path / "proof.npz"))[0] == 0


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize(("kind", "name"), [(kind, name) for kind in FORGERIES for name in FORGERIES[kind]])
def test_forgeries_are_refused(kind, name, tmp_path):
    code, said = verdict(FORGERIES[kind][name]().save(tmp_path / "proof.npz"))
    assert code in (2, 3)
    assert said.startswith("REFUSED")


@pytest.mark.filterwarnings("ignore:Duplicate name")
@pytest.mark.skipif(sys.platform == "win32", reason="resource")
def test_archives_that_are_none_are_refused_in_little_memory(tmp_path):
    import resource

    files = archives(tmp_path, bomb_megabytes=1 + checker.MOST_BYTES // 1_000_000)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for name, file in files.items():
        assert verdict(file)[0] in (2, 3), name
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 150_000  # [kB]; the bomb holds more


@pytest.mark.parametrize("name", ["second root", "body of the world", "two followers"])
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


@pytest.mark.parametrize("seed", range(8))
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
