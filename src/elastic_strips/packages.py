"""ROS packages, found by the names in their ``package.xml``."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from lxml import etree

from elastic_strips.errors import RobotError
from elastic_strips.files import read_input

_MOST_ENTRIES = 2000  # of a folder that is searched for packages
_MAX_PACKAGE_BYTES = 200_000


def package_of(name: str, folders: Iterable[Path]) -> Path | None:
    """The folder of a ROS package: one of these or a folder in one, with a ``package.xml`` that gives this name.

    Only this file tells if a checkout has another name than its package.
    """
    for folder in folders:
        if _package_name(folder) == name:
            return folder
        try:
            with os.scandir(folder) as entries:
                inner = [Path(e.path) for e, _ in zip(entries, range(_MOST_ENTRIES), strict=False) if e.is_dir()]
        except OSError:
            continue
        found = next((each for each in sorted(inner) if _package_name(each) == name), None)
        if found is not None:
            return found
    return None


def _package_name(folder: Path) -> str | None:
    file = folder / "package.xml"
    if not os.path.isfile(file):
        return None
    try:
        text = read_input(file, "package.xml", _MAX_PACKAGE_BYTES, RobotError)
        root = etree.fromstring(text, etree.XMLParser(resolve_entities=False, no_network=True))
    except (RobotError, etree.XMLSyntaxError, ValueError):  # somebody else's file: it names no package
        return None
    return (root.findtext("name") or "").strip() or None
