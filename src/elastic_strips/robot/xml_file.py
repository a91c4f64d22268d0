"""XML files of robots, read with care: every fault is one error that names file and line; small ones are counted."""

from __future__ import annotations

import logging
import math
import re
from pathlib import Path

from lxml import etree

from elastic_strips.errors import RobotError, listed
from elastic_strips.files import read_input
from elastic_strips.validation import MAX_LENGTH
from elastic_strips.xacro_process import MAX_BYTES

_log = logging.getLogger(__name__)
_NAMES_SHOWN = 12


class Mends:
    """Faults of one file, counted by kind."""

    def __init__(self, source: Path) -> None:
        self._source = source
        self._found: dict[str, list[str]] = {}

    def add(self, kind: str, name: object) -> None:
        """Note a fault: its kind, in words that follow a count ("links that the robot does not have"), and where."""
        names = self._found.setdefault(kind, [])
        if repr(name) not in names:
            names.append(repr(name))

    def say(self) -> None:
        """Log one warning for each kind of fault, with the names."""
        for kind, names in self._found.items():
            count = f"{len(names)} " if len(names) > 1 else ""  # kinds are in the plural
            _log.warning("%s: %s%s: %s", self._source, count, kind, listed(names, _NAMES_SHOWN))


_MAX_ATTRIBUTE = 500  # characters of an attribute


def read_xml(path: Path, *, root: str, kind: str) -> etree._Element:
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
    try:
        try:
            element = etree.fromstring(text, _parser())
        except etree.XMLSyntaxError as error:
            if error.code != etree.ErrorTypes.ERR_UNSUPPORTED_ENCODING or (known := _in_utf8(text)) is None:
                raise
            element = etree.fromstring(known, _parser("utf-8"))
    except (etree.XMLSyntaxError, ValueError) as error:
        said = " ".join(str(error).split())
        raise RobotError(f"{path}: the {kind} file is not well-formed XML: {said}") from None
    docinfo = element.getroottree().docinfo
    if docinfo.doctype or docinfo.internalDTD is not None:  # another encoding hides it from the search above
        raise RobotError(f"{path}: the {kind} file has a document type, which is not accepted")
    _check_encoding(text, path, kind)
    if element.tag != root:
        raise RobotError(f"{path}:{element.sourceline}: root element is <{element.tag}>; a {kind} file has <{root}>")
    for each in element.iter():  # so that every message that quotes a name stays readable
        for key, value in each.attrib.items():
            if len(value) > _MAX_ATTRIBUTE:
                where = f"{path}:{each.sourceline}: <{each.tag!s:.60}>"
                raise RobotError(
                    f"{where}: attribute {key!s:.60} has {len(value)} characters; at most {_MAX_ATTRIBUTE}"
                )
    return element


_DECLARED = re.compile(rb"""<\?xml[^>]*?encoding\s*=\s*["']([A-Za-z0-9._-]+)["']""")
_BYTE_ORDER_MARKS = {b"\xef\xbb\xbf": "utf-8", b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}


def _parser(encoding: str | None = None) -> etree.XMLParser:
    return etree.XMLParser(
        encoding=encoding,
        resolve_entities=False,
        no_network=True,
        huge_tree=False,
        remove_comments=True,
        remove_pis=True,
    )


def _in_utf8(text: bytes) -> bytes | None:
    """A file whose declared encoding Python knows and the parser does not (``latin-1``), in UTF-8; else None."""
    found = _DECLARED.search(text[:1000])
    try:
        return None if found is None else text.decode(found[1].decode("ascii")).encode("utf-8")
    except (LookupError, UnicodeError):
        return None


def _check_encoding(text: bytes, path: Path, kind: str) -> None:
    """Check that a file is written as its mark or its first line says, and in UTF-8 where neither says anything.

    The parser is less strict: it guesses, and may guess other names than those that were meant.

    Raises:
        RobotError: it is written differently.
    """
    mark = next((name for start, name in _BYTE_ORDER_MARKS.items() if text.startswith(start)), None)
    found = _DECLARED.search(text[:1000].replace(b"\0", b""))
    declared = None if found is None else found[1].decode("ascii").lower()
    encoding = mark or declared or "utf-8"
    agree = mark is None or declared is None or declared.replace("_", "-").startswith(mark)
    try:
        readable = agree and "\0" not in text.decode(encoding)
    except (LookupError, UnicodeDecodeError):
        readable = False
    if not agree:
        raise RobotError(f"{path}: the {kind} file is {mark} by its mark, and its first line declares {declared}")
    if not readable:
        said = f"{declared} text, which its first line declares" if declared else "UTF-8 text"
        raise RobotError(f"{path}: the {kind} file is not {said}")


NUMBER = re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?|[-+]?(nan|inf|infinity)", re.IGNORECASE)


def fault(source: Path, element: etree._Element, text: str) -> RobotError:
    """The error about an element of a file: the message begins with file and line."""
    return RobotError(f"{source}:{element.sourceline}: {text}")


def floats(
    element: etree._Element,
    key: str,
    count: int,
    source: Path,
    what: str,
    default: str | None = None,
    *,
    bound: float = math.inf,
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
    if text is None:
        raise fault(source, element, f"{what}: <{element.tag}> has no attribute {key!r}")
    quoted = repr(text if len(text) <= 80 else text[:77] + "...")
    where = f"{what}: <{element.tag} {key}={quoted}>"
    words = text.split()
    if not all(NUMBER.fullmatch(word) for word in words):  # float() reads more than a URDF may hold
        raise fault(source, element, f"{where} is not {count} number(s)")
    values = [float(word) for word in words]
    if len(values) != count or not all(math.isfinite(v) for v in values):
        raise fault(source, element, f"{where} is not {count} finite number(s)")
    if any(abs(v) > bound for v in values):
        raise fault(source, element, f"{where} is beyond ±{bound:g}")
    if count == 1 and key in element.attrib:
        element.set(key, words[0])  # urdfdom takes no blanks about a single number
    return values


def check_origins(element: etree._Element, source: Path, what: str) -> None:
    for origin in element.findall("origin"):
        for key in ("xyz", "rpy"):
            floats(origin, key, 3, source, what, "0 0 0", bound=MAX_LENGTH)
