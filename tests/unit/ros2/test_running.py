"""The node's end: what ends it, ends it, whenever it comes."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator

import pytest
from cases import each

from elastic_strips.cli import unlost_interrupts
from elastic_strips.ros2.running import interrupted


@pytest.fixture(autouse=True)
def ctrl_c() -> Iterator[None]:
    """Ctrl-C is heard, also where these tests run in the background."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def signalled(number: int) -> None:
    """Wait for a signal that comes at once."""
    with interrupted() as asked:
        os.kill(os.getpid(), number)
        asked.wait(1.0)


ENDS = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]


class Finalized:
    """Signals this process while it is finalized, where Python drops the exception."""

    def __init__(self, number: int) -> None:
        self.number = number

    def __del__(self) -> None:
        os.kill(os.getpid(), self.number)
        sum(range(1000))  # the handler runs in here


@each("number", ENDS)
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_what_python_drops_is_not_lost(number: int):
    before = signal.getsignal(number)
    with interrupted() as asked:
        assert not asked.is_set()
        Finalized(number)
        assert asked.is_set()
    assert signal.getsignal(number) is before


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_what_python_drops_is_not_lost_to_the_command_line_either():
    """It has a handler of its own, for Ctrl-C while something is imported."""
    with unlost_interrupts():
        theirs = signal.getsignal(signal.SIGINT)
        with interrupted() as asked:
            Finalized(signal.SIGINT)
            assert asked.is_set()
        assert signal.getsignal(signal.SIGINT) is theirs
        with pytest.raises(KeyboardInterrupt):
            signalled(signal.SIGINT)


@each("number", ENDS)
def test_it_is_raised_at_once_where_that_can_be(number: int):
    with pytest.raises(KeyboardInterrupt):
        signalled(number)


def test_what_is_ignored_stays_ignored():
    """As of a program in the background."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with interrupted() as asked:
            os.kill(os.getpid(), signal.SIGINT)
            assert not asked.wait(0.05)
    finally:
        signal.signal(signal.SIGINT, before)


def test_threads_have_no_signals():
    found = []

    def enter() -> None:
        with interrupted() as asked:
            found.append(asked.is_set())

    thread = threading.Thread(target=enter)
    thread.start()
    thread.join()
    assert found == [False]
