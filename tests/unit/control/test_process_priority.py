"""Raising the priority says what it did, whatever is permitted here."""

from __future__ import annotations

import subprocess
import sys

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
