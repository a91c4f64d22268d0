"""Trials over ROS 2: how one is judged, from what the robot has seen, what was said, and what is left."""

from __future__ import annotations

from dataclasses import dataclass, field

import pytest
from cases import each

from workshop.bench.ros_loopback import own_domain
from workshop.bench.ros_robot import FAULTS, TimedFault
from workshop.bench.ros_trials import KINDS, Judged, judged

SEEN = {
    "seed": 3,
    "at": [6.0, 0.4, 0.0],
    "at_by_odometry": [6.0, 0.1, 0.0],
    "moved_from_s": 1.0,
    "moved_until_s": 9.0,
    "fast_from_s": 2.0,
    "stood_from_s": 4.0,
    "began_monotonic_s": 100.0,
    "at_rest": True,
    "last_command_was_rest": True,
    "contacts_at_speed": 0,
    "fault_at_s": None,
    "way": [[0.0, 0.0, 0.0], [6.0, 0.0, 0.0]],
}


@dataclass
class Trialled:
    """A trial, as it should have been unless something is changed."""

    kind: str = "drive"
    seen: dict[str, object] = field(default_factory=lambda: dict(SEEN))
    said: list[tuple[float, str]] = field(default_factory=list)
    code: int = 0
    acted: float | None = None
    end: float = 6.0
    log: str = ""
    trouble: str = ""
    left: list[str] = field(default_factory=list)

    def judge(self) -> Judged:
        return judged(
            self.kind, self.seen, self.said, code=self.code, acted=self.acted, end=self.end, log=self.log,
            trouble=self.trouble, left=self.left,
        )  # fmt: skip


def test_what_the_robot_can_do_wrong_is_what_the_trials_are_about():
    assert {trial.fault for trial in KINDS.values() if trial.fault} <= set(FAULTS)
    assert TimedFault.of("scan_late:1.5:2").lasts == 2.0


@each(
    "changed",
    [
        {"seen": {**SEEN, "contacts_at_speed": 1}},
        {"seen": {**SEEN, "at_by_odometry": [5.8, 0.0, 0.0]}},
        {"kind": "path"},
        {"code": 3},
        {"log": "Traceback (most recent call last):"},
        {"trouble": "it took too long"},
        {"left": ["fastdds_port7400"]},
    ],
)
def test_a_drive_is_as_it_should_be_only_if_all_of_it_is(changed: dict[str, object]):
    assert Trialled().judge().fine
    assert not Trialled(**changed).judge().fine  # type: ignore[arg-type]


def test_a_fault_has_to_be_named_after_it_began_and_not_before():
    seen = {**SEEN, "fault_at_s": 3.0, "moved_until_s": 3.6}
    about = "stale scene: nothing has arrived from 'scan' since 2.9 s"

    def named(*said: tuple[float, str]) -> Judged:
        return Trialled("scan_lost", seen, list(said), code=130).judge()

    assert named((103.5, about)).fine
    assert not named((103.5, "moving")).fine
    assert not named((102.0, about), (103.5, about)).fine, "it was said without the fault"
    found = named((103.5, about))
    assert found.named
    assert found.to_rest == pytest.approx(0.6)


def test_a_trial_before_whose_fault_the_robot_was_not_run_says_nothing():
    about = "stale scene: nothing has arrived from 'scan' since 2.9 s"
    said = [(102.0, about), (103.5, about)]
    seen = {**SEEN, "fault_at_s": 3.0, "moved_until_s": 3.6}
    early, late = {"not_run_s": [[1.6, 1.93]]}, {"not_run_s": [[3.2, 3.53]]}
    assert Trialled("scan_lost", {**seen, **early}, said, code=130).judge().disturbed
    assert not Trialled("scan_lost", seen, said, code=130).judge().disturbed
    assert not Trialled("scan_lost", {**seen, **late}, said, code=130).judge().disturbed
    assert not Trialled("scan_lost", {**seen, **early}, said[1:], code=130).judge().disturbed, "it is as it should be"
    for wrong in ({"contacts_at_speed": 1}, {"at_rest": False}):
        found = Trialled("scan_lost", {**seen, **early, **wrong}, said, code=130).judge()
        assert not found.fine
        assert not found.disturbed
    assert not Trialled("scan_lost", {**seen, **early}, said, code=130, left=["fastdds_port7400"]).judge().disturbed
    assert not Trialled("drive", {**SEEN, **early}, code=3).judge().disturbed, "drives have to bear that"


def test_who_is_killed_need_not_say_farewell():
    seen = {**SEEN, "last_command_was_rest": False}
    for kind, code, fine in (("executor_killed", 3, True), ("ctrl_c", 130, False), ("executor_killed", 0, False)):
        assert Trialled(kind, seen, code=code, acted=108.5).judge().fine is fine
    assert Trialled("robot_killed", {}, [(101.0, "from 'odom' and 'joint_states'")], code=130, acted=100.0).judge().fine
    assert not Trialled("node_killed", {}, code=-9, acted=100.0).judge().fine, "the robot has said nothing"


def test_who_asks_at_the_same_time_gets_another_domain():
    """Two in one domain hear each other's robots."""
    with own_domain() as one, own_domain() as two:
        assert one != two
        assert {one, two} <= set(range(1, 233))
    with own_domain() as again:
        assert again == one
