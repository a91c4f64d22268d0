"""xacro files: expanded by the package ``xacro`` into a URDF file, which is then read as any other."""

from __future__ import annotations

import getpass
import hashlib
import logging
import os
import stat
import tempfile
from collections.abc import Mapping
from pathlib import Path

from lxml import etree

from elastic_strips.errors import InputError, RobotError
from elastic_strips.files import atomic_write, read_input
from elastic_strips.summary import shortened
from elastic_strips.xacro_process import MAX_BYTES, expanded

from .urdf_shapes import resolve_mesh, search_folders

_log = logging.getLogger(__name__)


def expand_xacro(
    path: str | Path, mappings: Mapping[str, str] | None = None, package_dirs: tuple[str | Path, ...] = ()
) -> Path:
    """The URDF file that a xacro file expands to.

    It lies in a folder for temporary files, named after its content; its meshes have absolute paths. Messages of xacro
    go to the log.

    Args:
        path: the file.
        mappings: arguments by name.
        package_dirs: folders to search for packages (``$(find …)``, ``package://…``), before the usual ones.

    Raises:
        RobotError: there is no such file; or xacro refuses it (the message quotes why) or needs more than 3 s or 1.5
            GB.
        MissingExtraError: xacro is not installed.
    """
    source = Path(path).expanduser().absolute()
    text = read_input(source, "xacro file", MAX_BYTES, RobotError)
    if b"<!DOCTYPE" in text or b"<!ENTITY" in text:
        raise RobotError(f"{source}: the xacro file has a document type or entities, which are not accepted")
    folders = search_folders(source, package_dirs)
    document, said = expanded(source, {k: str(v) for k, v in (mappings or {}).items()}, folders)
    for line in said:
        _log.warning("%s: xacro: %s", source, line)
    try:
        root = etree.fromstring(
            document.encode(), etree.XMLParser(resolve_entities=False, no_network=True, remove_comments=True)
        )
    except (etree.XMLSyntaxError, ValueError) as error:
        raise RobotError(
            f"{source}: xacro's result is not XML: {shortened(' '.join(str(error).split()), 300)}"
        ) from None
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
    """A folder for temporary files that nobody else can write to; a new one where that of this user is not safe."""
    try:
        folder = Path(tempfile.gettempdir()) / f"elastic-strips-{getpass.getuser()}"
        folder.mkdir(mode=0o700, exist_ok=True)
    except (OSError, KeyError, ImportError):  # a file has its name, or the user has none
        return Path(tempfile.mkdtemp(prefix="elastic-strips-"))
    if hasattr(os, "getuid"):
        status = folder.lstat()  # of the link itself, where somebody made one
        others = stat.S_IMODE(status.st_mode) & (stat.S_IWGRP | stat.S_IWOTH)
        if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.getuid() or others:
            _log.warning("%s: others may write to this folder, so that it is not used", folder)
            return Path(tempfile.mkdtemp(prefix="elastic-strips-"))
    return folder
