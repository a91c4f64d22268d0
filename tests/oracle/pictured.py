"""What a page of the viewer is made of, taken from the page that it saves."""

from __future__ import annotations

import base64
import re
import zlib
from typing import Any

import umsgpack

from elastic_strips.viewer import Viewer

Command = dict[str, Any]  # as the page takes it


def pictured(viewer: Viewer) -> dict[tuple[str, str], Command]:
    """The commands of a page, in their order, by path and type; what is of many paths is at the first of them."""
    found = re.search(r'id="es-data"[^>]*>([^<]*)<', viewer.html())
    assert found is not None, "no page"
    commands: list[Command] = umsgpack.unpackb(zlib.decompress(base64.b64decode(found[1])))
    by_place = {(_place(command), command["type"]): command for command in commands}
    assert len(by_place) == len(commands), "two commands of one place"
    return by_place


def _place(command: Command) -> str:
    return command.get("path") or command.get("group") or next(iter(command.get("paths", [])), "")
