"""A short study of proofs; the long one is a command (see ``proof_study.py``)."""

from __future__ import annotations

import numpy as np
import proof_study
from proof_study import CAUGHT, JUDGED, run_all


def test_proofs_hold_and_what_is_tampered_with_is_refused():
    found = run_all(45, 45, 2, each=15)
    assert found.wrong == []
    assert found.proofs >= 45
    names = {edit.__name__[1:].replace("_", " ") for edit in (*CAUGHT, *JUDGED)}
    assert {name for name, _ in found.tampered} == names
    for edit in CAUGHT:
        assert found.tampered[edit.__name__[1:].replace("_", " "), "refused"] > 0


def test_the_study_sees_what_a_credulous_checker_takes(monkeypatch):
    monkeypatch.setattr(proof_study.checker, "check", lambda *parts, **named: float(np.inf))
    found = run_all(30, 30, 2, each=30)
    assert found.taken
