"""Late loading: names of a package whose modules are imported when one of them is used."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module


def late_names(package: str, modules: Mapping[str, Sequence[str]]) -> Callable[[str], object]:
    """The ``__getattr__`` of a package: it imports a module when it, or one of its names, is first used.

    Args:
        package: ``__name__`` of the package.
        modules: name of a module in it → names that the package has of it.
    """
    where = {name: module for module, names in modules.items() for name in names}

    def load(name: str) -> object:
        if name in where:
            return getattr(import_module(f".{where[name]}", package), name)
        if name in modules:
            return import_module(f".{name}", package)
        said = f"module {package!r} has no attribute {name!r}"
        raise AttributeError(said, name=name, obj=sys.modules.get(package))  # by which Python finds what was meant

    return load
