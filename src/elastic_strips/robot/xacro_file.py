"""xacro files: expanded by the package ``xacro`` into a URDF file, which is then read as any other."""

from __future__ import annotations

import getpass
import hashlib
import importlib
import io
import logging
import os
import re
import tempfile
import threading
from collections.abc import Callable, Mapping
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import BinaryIO

from lxml import etree

from elastic_strips.errors import InputError, RobotError, missing_extra
from elastic_strips.files import atomic_write, read_input
from elastic_strips.summary import shortened

from .urdf import package_of, resolve_mesh, search_folders

_log = logging.getLogger(__name__)
_LOCK = threading.Lock()  # xacro keeps what it is at in its module
_MAX_BYTES = 8_000_000


def expand_xacro(
    path: str | Path, mappings: Mapping[str, str] | None = None, package_dirs: tuple[str | Path, ...] = ()
) -> Path:
    """The URDF file that a xacro file expands to.

    It lies in a folder for temporary files, under a name of its content; its meshes have absolute paths. What xacro
    says goes to the log.

    Args:
        path: the file.
        mappings: arguments by name.
        package_dirs: folders to search for packages (``$(find …)``, ``package://…``), before the usual ones.

    Raises:
        RobotError: no such file, or xacro refuses it, in its words.
        MissingExtraError: xacro is not installed.
    """
    source = Path(path).expanduser().absolute()
    text = read_input(source, "xacro file", _MAX_BYTES, RobotError)
    if b"<!DOCTYPE" in text or b"<!ENTITY" in text:
        raise RobotError(f"{source}: the xacro file has a document type or entities, which are not accepted")
    folders = search_folders(source, package_dirs)
    document = _expanded(source, {k: str(v) for k, v in (mappings or {}).items()}, folders)
    try:
        root = etree.fromstring(
            document, etree.XMLParser(resolve_entities=False, no_network=True, remove_comments=True)
        )
    except (etree.XMLSyntaxError, ValueError) as error:
        raise RobotError(f"{source}: what xacro made is no XML: {_words(error)}") from None
    packages: dict[str, Path | None] = {}
    for mesh in root.iter("mesh"):
        found = resolve_mesh(mesh.get("filename", ""), source, folders, packages)
        if found is not None:
            mesh.set("filename", f"file://{found}")
    data = etree.tostring(root, encoding="utf-8", xml_declaration=True)
    stem = source.name[: -len(".xacro")].removesuffix(".urdf") or "robot"
    try:
        return atomic_write(_folder() / f"{stem[:80]}-{hashlib.sha256(data).hexdigest()[:12]}.urdf", data)
    except (OSError, InputError) as error:
        raise RobotError(f"{source}: the expanded file cannot be written: {error}") from None


def _folder() -> Path:
    """A folder for temporary files that nobody else can write to."""
    folder = Path(tempfile.gettempdir()) / f"elastic-strips-{getpass.getuser()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    if hasattr(os, "getuid") and folder.stat().st_uid != os.getuid():
        return Path(tempfile.mkdtemp(prefix="elastic-strips-"))
    return folder


def _expanded(source: Path, mappings: dict[str, str], folders: list[Path]) -> bytes:
    """What xacro makes of a file."""
    try:
        xacro = importlib.import_module("xacro")
        arguments = importlib.import_module("xacro.substitution_args")
    except ModuleNotFoundError:
        raise missing_extra(f"the robot of {source.name}", "xacro", "ros") from None
    said = io.StringIO()
    with _LOCK, redirect_stderr(said), redirect_stdout(said):
        usual = arguments._eval_find
        arguments._eval_find = arguments._eval_dict["find"] = _finder(folders, usual)
        vars(xacro)["open"] = _opened
        try:
            document: bytes = xacro.process_file(str(source), mappings=mappings, verbosity=1).toxml(encoding="utf-8")
        except Exception as error:  # of xacro, expat, what an expression raises, what an include cannot open
            macros = [(m.body.getAttribute("name"), m.history[-1][-1]) for m in reversed(xacro.macrostack or [])]
            files = dict.fromkeys(str(f) for f in [*(f for _, f in macros), *reversed(xacro.filestack or [])] if f)
            where = _place(error, tuple(files)) or next(iter(files), str(source))
            within = list(dict.fromkeys(f"macro {name!r}" for name, _ in macros))[:4]  # one that calls itself: once
            if where.removeprefix(str(source))[:1] not in ("", ":"):
                within.append(f"of {source}")
            inside = f" ({', '.join(within)})" if within else ""
            raise RobotError(f"{where}: xacro cannot expand it{inside}: {_words(error)}") from None
        finally:
            arguments._eval_find = arguments._eval_dict["find"] = usual
            del vars(xacro)["open"]
    for line in filter(None, (line.strip() for line in said.getvalue().splitlines()[:20])):
        _log.warning("%s: xacro: %s", source, shortened(line, 300))
    return document


def _opened(path: str) -> BinaryIO:
    """A file that xacro reads: a regular one, of a size that is accepted; xacro itself says that there is none."""
    if not os.path.exists(path):
        return open(path, "rb")
    return io.BytesIO(read_input(path, "xacro file", _MAX_BYTES, RobotError))


class _NoPackage(LookupError):
    """What ``$(find package)`` names is nowhere."""

    def __init__(self, package: str, searched: str) -> None:
        super().__init__(f"package {package!r} not found (searched {searched}, …)")
        self.package = package


def _finder(folders: list[Path], usual: Callable[[str], str]) -> Callable[[str], str]:
    """What resolves ``$(find package)``: in these folders first, then as xacro does where ROS is installed."""

    def find(package: str) -> str:
        found = next((f / package for f in folders if os.path.isdir(f / package)), None)
        found = found or package_of(package, folders)
        if found is not None:
            return str(found)
        try:
            return usual(package)
        except ModuleNotFoundError:  # without ROS
            searched = ", ".join(str(f) for f in folders[:4])
            raise _NoPackage(package, searched) from None

    return find


def _words(error: Exception) -> str:
    """What an error says, on one line, or what it is where it says nothing."""
    inner, said = getattr(error, "exc", None), str(error)
    if inner is not None and said.count(str(inner)) > 1:  # xacro's own words are the inner error's once more
        said = f"{inner} {getattr(error, 'suffix', None) or ''}"
    return shortened(" ".join(said.split()), 300) or type(error).__name__


def _place(error: Exception, files: tuple[str, ...]) -> str:
    """``file:line`` where the first of the files has what cannot be evaluated, or nothing: xacro knows no lines."""
    sought = re.search(r"when evaluating expression '(.*)'", str(error), re.DOTALL)
    wanted = f"${{{sought[1]}}}" if sought else ""
    while (inner := getattr(error, "exc", None)) is not None:
        error = inner
    if isinstance(error, _NoPackage):
        wanted = f"$(find {error.package})"
    elif type(error).__name__ == "ArgException":  # of xacro.substitution_args
        wanted = f"$(arg {error})"
    for file in files if wanted else ():
        try:
            text = Path(file).read_text(encoding="utf-8", errors="replace")
        except OSError:
            continue
        if wanted in text:
            return f"{file}:{text[: text.index(wanted)].count(chr(10)) + 1}"
    return ""
