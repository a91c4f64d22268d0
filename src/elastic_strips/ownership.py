"""Ownership: an object with buffers of its own is for one thread at a time.

Threads may hand a workspace on between two calls. Two that are inside at once would see each other's nodes and
distances half changed, and a proof of one of them would hold for neither.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from threading import get_ident
from typing import Concatenate, ParamSpec, TypeVar

from elastic_strips.errors import ThreadError

P = ParamSpec("P")
R = TypeVar("R")
W = TypeVar("W", bound="OneThread")


class OneThread:
    """Base of workspaces: a thread that calls a method marked :func:`exclusive` while another is in one gets an error.

    A method may call others, of the same workspace too. A copy by ``pickle`` or ``copy`` is a workspace of its own.
    """

    _inside: dict[None, int]  # who is; a dictionary's `setdefault` is one step, and takes a tenth of a lock's time

    def __new__(cls: type[W], *_args: object, **_kwargs: object) -> W:
        self = object.__new__(cls)
        self._inside = {}
        return self

    def share_with(self, part: OneThread) -> None:
        """Make a part of this workspace one with it: a thread inside either of them is inside both."""
        part._inside = self._inside

    def __getstate__(self) -> dict[str, object]:
        return {name: value for name, value in self.__dict__.items() if name != "_inside"}


def exclusive(method: Callable[Concatenate[W, P], R]) -> Callable[Concatenate[W, P], R]:
    """A method that raises `ThreadError`, and touches nothing, while another thread is inside the same workspace."""

    @wraps(method)
    def alone(self: W, /, *args: P.args, **kwargs: P.kwargs) -> R:
        inside, this = self._inside, get_ident()
        if inside.get(None) == this:
            return method(self, *args, **kwargs)
        if inside.setdefault(None, this) != this:
            kind = type(self).__name__
            raise ThreadError(
                f"{kind}.{method.__name__}: another thread is inside this {kind}, which has buffers of its own; "
                "give each thread its own, or wait until the other is done"
            )
        try:
            return method(self, *args, **kwargs)
        finally:
            inside.clear()

    return alone
