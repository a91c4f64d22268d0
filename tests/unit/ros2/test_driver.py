"""The driver: what it waits for before the robot is driven; the rest of it is tried over DDS."""

from __future__ import annotations

from types import SimpleNamespace as Fields

import pytest

from elastic_strips.ros2 import driver
from elastic_strips.ros2.params import Ros2Params


class Waiting(driver.Ros2Driver):
    """All of the robot is there at once, but the emergency stop, which comes when it has listened so often."""

    def __init__(self, comes: int, *, pressed: bool = False, emergency: str | None = "e_stop") -> None:
        self._params = Ros2Params(emergency=emergency)
        self._base = self._arm = self._emergency = None
        self._clock, self._reader = Fields(epoch=0.0), Fields(missing="")
        self._comes, self._says, self.listened = comes, pressed, 0
        self._wait()

    def _listen(self) -> None:
        self.listened += 1
        if self.listened == self._comes:
            self._emergency = self._says


def test_an_emergency_stop_that_comes_late_is_waited_for():
    for pressed in (False, True):
        assert Waiting(20, pressed=pressed).listened == 20
    assert Waiting(20, emergency=None).listened == 1


def test_one_that_never_comes_is_not_waited_for_for_ever(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(driver, "_LONGEST_UNHEARD", 0.05)
    assert Waiting(10**9).listened > 1
