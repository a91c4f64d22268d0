"""Reading XML robot descriptions safely: size bound, no entities, no network, one clear error."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

from lxml import etree

from ..errors import RobotError
from ..input_file import read_input

MAX_BYTES = 8_000_000
MAX_TEXT = 500  # characters of an attribute


def read_xml(path: Path, *, root: str, kind: str) -> Any:
    """Parse a file and return its root element (``lxml``).

    Args:
        path: the file.
        root: the tag that the root element must have.
        kind: what to call the file in messages ("URDF", "SRDF").

    Raises:
        RobotError: missing, unreadable, too large, with a document type or entities, malformed, or another root.
    """
    text = read_input(path, f"{kind} file", MAX_BYTES, RobotError)
    if not text.strip():
        raise RobotError(f"{path}: the {kind} file is empty")
    if b"<!DOCTYPE" in text or b"<!ENTITY" in text:
        raise RobotError(f"{path}: the {kind} file has a document type or entities, which are not accepted")
    parser = etree.XMLParser(resolve_entities=False, no_network=True, huge_tree=False, remove_comments=True)
    try:
        element = etree.fromstring(text, parser)
    except (etree.XMLSyntaxError, ValueError) as error:
        said = " ".join(str(error).split())
        raise RobotError(f"{path}: the {kind} file is not well-formed XML: {said}") from None
    docinfo = element.getroottree().docinfo
    if docinfo.doctype or docinfo.internalDTD is not None:  # another encoding hides it from the search above
        raise RobotError(f"{path}: the {kind} file has a document type, which is not accepted")
    if b"\0" in text or not _is_utf8(text):  # Pinocchio reads nothing else
        raise RobotError(f"{path}: the {kind} file is not UTF-8 text")
    if element.tag != root:
        raise RobotError(f"{path}:{element.sourceline}: root element is <{element.tag}>; a {kind} file has <{root}>")
    for each in element.iter():  # so that every message that quotes a name stays readable
        for key, value in each.attrib.items():
            if len(value) > MAX_TEXT:
                where = f"{path}:{each.sourceline}: <{each.tag!s:.60}>"
                raise RobotError(f"{where}: attribute {key!s:.60} has {len(value)} characters; at most {MAX_TEXT}")
    return element


def _is_utf8(text: bytes) -> bool:
    try:
        text.decode("utf-8")
    except UnicodeDecodeError:
        return False
    return True


_NUMBER = re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?|[-+]?(nan|inf|infinity)", re.IGNORECASE)


def shown(text: str) -> str:
    """An attribute's text as it is shown in messages: quoted, and not too long."""
    return repr(text if len(text) <= 80 else text[:77] + "...")


def floats(
    element: Any, key: str, count: int, source: Path, what: str, default: str | None = None, *, bound: float = math.inf
) -> list[float]:
    """The numbers of an attribute.

    Args:
        element: the XML element.
        key: the attribute's name.
        count: how many numbers it has to hold.
        source: the file; what: the link or joint that it belongs to, for messages.
        default: text where the attribute is missing; it is needed where None.
        bound: largest magnitude.

    Raises:
        RobotError: missing, not ``count`` finite numbers, or beyond ``bound``.
    """
    text = element.get(key, default)
    where = f"{source}:{element.sourceline}: {what}"
    if text is None:
        raise RobotError(f"{where}: <{element.tag}> has no attribute {key!r}")
    try:
        words = text.split()
        if not all(_NUMBER.fullmatch(word) for word in words):  # float() reads more than a URDF may hold
            raise ValueError
        values = [float(word) for word in words]
    except ValueError:
        raise RobotError(f"{where}: <{element.tag} {key}={shown(text)}> is not {count} number(s)") from None
    if len(values) != count or not all(math.isfinite(v) for v in values):
        raise RobotError(f"{where}: <{element.tag} {key}={shown(text)}> is not {count} finite number(s)")
    if any(abs(v) > bound for v in values):
        raise RobotError(f"{where}: <{element.tag} {key}={shown(text)}> is beyond ±{bound:g}")
    return values
