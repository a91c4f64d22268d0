"""The native kernel: the inner loops in compiled form, if installed; the NumPy code beside each is its readable twin.

``ELASTIC_STRIPS_NATIVE=0`` turns it off, and a file's path takes that one. Without a compiled part, or with one that
was made for another Coal or of other sources, the twin runs, and a notice is logged once.
"""

from __future__ import annotations

import importlib
import importlib.util
import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import coal

from elastic_strips import constants

if TYPE_CHECKING:  # its types, for all who have a native half
    from elastic_strips import _native as _native

_log = logging.getLogger(__name__)


def _load() -> tuple[ModuleType | None, str]:
    which = os.environ.get("ELASTIC_STRIPS_NATIVE", "1")
    if which == "0":
        return None, "turned off by ELASTIC_STRIPS_NATIVE=0"
    try:
        native = _imported("elastic_strips._native", which if os.sep in which else None)
    except ImportError as error:
        _log.warning("the native kernel is not there (%s): NumPy computes, several times slower", error)
        return None, f"not there ({error})"
    if native.coal_version != coal.__version__:  # its shapes would be laid out in another way
        _log.warning(
            "the native kernel was compiled for Coal %s, and this is %s: NumPy computes, several times slower; "
            "reinstall elastic-strips",
            native.coal_version,
            coal.__version__,
        )
        return None, f"compiled for Coal {native.coal_version}, and this is {coal.__version__}"
    why = _other_sources(native)
    if why:
        _log.warning("the native kernel was %s: NumPy computes, several times slower; reinstall elastic-strips", why)
        return None, why
    return native, ""


def _other_sources(native: ModuleType) -> str:
    """In what the module's sources differ from these; empty where they do not."""
    stubs = Path(__file__).with_name("_native.pyi")
    interface = sha256(stubs.read_bytes()).hexdigest() if stubs.is_file() else None
    if interface is not None and getattr(native, "interface", "") != interface:
        return "compiled from sources that offer other functions"
    theirs = getattr(native, "constants", {})
    for name in sorted(name for name in vars(constants) if name.isupper()):
        value, mine = theirs.get(name), getattr(constants, name)
        if value != mine:
            return f"compiled with {name} = {value}, and here it is {mine}"
    return ""


def _imported(name: str, file: str | None) -> ModuleType:
    """The module where it is installed, or from a file."""
    if file is None:
        return importlib.import_module(name)
    spec = importlib.util.spec_from_file_location(name, file)
    if spec is None or spec.loader is None:
        raise ImportError(f"{file} is no compiled module of this Python")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


_kernel: ModuleType | None
_kernel, ABSENT = _load()
"""Why there is no kernel; empty where there is one."""


def kernel() -> ModuleType | None:
    """The compiled module, or None where the twin computes. Workspaces ask when they are made."""
    return _kernel


@contextmanager
def twin() -> Iterator[None]:
    """Workspaces that are made within this context compute in NumPy."""
    global _kernel
    before, _kernel = _kernel, None
    try:
        yield
    finally:
        _kernel = before
