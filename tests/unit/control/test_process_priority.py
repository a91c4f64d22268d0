"""Raising the priority says what it did, whatever is permitted here."""

from __future__ import annotations

import gc
import subprocess
import sys

import pytest

from elastic_strips.control.process.priority import undisturbed

_RAISES = """
import gc, os
from elastic_strips.control.process.priority import raise_priority
said = raise_priority()
fifo = os.sched_getscheduler(0) == os.SCHED_FIFO
print(said, gc.isenabled(), fifo, os.getpriority(os.PRIO_PROCESS, 0), sep="|")
"""


def test_it_says_what_it_could_do():
    out = subprocess.run([sys.executable, "-c", _RAISES], capture_output=True, text=True, check=True).stdout.strip()
    said, collects, real_time, nice = out.split("|")
    assert collects == "False"
    assert (real_time == "True") == said.startswith("SCHED_FIFO")
    assert (nice == "-15") == said.startswith("nice")
    assert said in ("SCHED_FIFO 10", "nice -15", "ordinary priority")


_KEEPS = """
import ompl.geometric as og, ompl.base as ob
from elastic_strips.control.process.priority import keep_memory
setup = og.SimpleSetup(ob.RealVectorStateSpace(2))
keep_memory()
"""


def test_what_is_kept_is_let_go_at_the_end():
    assert subprocess.run([sys.executable, "-c", _KEEPS], capture_output=True, text=True, check=True).stderr == ""


def test_during_a_tick_nothing_is_collected_and_threads_give_way_soon():
    before = sys.getswitchinterval()
    assert gc.isenabled()
    with undisturbed():
        assert not gc.isenabled()
        assert sys.getswitchinterval() < 0.1 * before
    assert gc.isenabled()
    assert sys.getswitchinterval() == pytest.approx(before)


def test_ticks_of_two_threads_leave_it_as_it_was():
    before, one, other = sys.getswitchinterval(), undisturbed(), undisturbed()
    one.__enter__()
    other.__enter__()
    one.__exit__(None, None, None)
    assert sys.getswitchinterval() < 0.1 * before
    other.__exit__(None, None, None)
    assert sys.getswitchinterval() == pytest.approx(before)
    gc.enable()


def test_who_lets_them_give_way_sooner_still_is_not_slowed_down():
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    try:
        with undisturbed():
            assert sys.getswitchinterval() == pytest.approx(1e-5)
    finally:
        sys.setswitchinterval(before)
