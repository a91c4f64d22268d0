"""Mutations of files: bytes, lines, numbers, words, structure, and what may stand at a path instead of a file."""

# ruff: noqa: E501 - tables

from __future__ import annotations

import json
import os
import re
import socket
import zipfile
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from lxml import etree
from seeds import Seed

Rng = np.random.Generator

NUMBERS = (
    "nan", "NaN", "inf", "-inf", "Infinity", "1e300", "-1e300", "1e-300", "5e-324", "1e308", "1e400", "-0", "-0.0", "0",
    "1", "-1", "1e6", "1e9", "1e-9", "1e17", "9" * 30, "9" * 400, "9" * 5000, "-" + "9" * 30, "2147483648", "9223372036854775808",
    "0x10", "1_000", "1,5", "+1", "1.", ".5", "1e", "٣", "", "null", "true", ".nan", ".inf", "abc", "[]", "{}", '""', "~",
    "1e5", "1000000", "3.4e38", "6.28", "65536", "4294967295", "1e-5", "0.5", "2", "17",
)  # fmt: skip
VALUES: tuple[Any, ...] = (
    None, True, False, 0, -1, 1e300, -1e300, float("nan"), float("inf"), 10**30, 10**400, 1e-300, "", "x", "nan", "\ud800", "\0",
    "a" * 1000, [], {}, [[]], [None], {"a": 1}, [1, 2, 3], [1e300] * 3, [[1, 2, 3]], [0, 0, 0], 0.5, 3, -0.0, "../../etc", [[1], [1, 2]],
)  # fmt: skip
_NUMBER = re.compile(rb"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")
_WORD = re.compile(rb"[A-Za-z_]{2,}")


def mutate(seed: Seed, others: tuple[Seed, ...], folder: Path, rng: Rng) -> Path:
    """Write a mutated input, and what stands beside it, into a folder; returns the path that is read."""
    for name, content in seed.beside.items():
        (folder / name).write_bytes(content)
    path = folder / seed.file
    if rng.random() < 0.03:
        _in_its_place(path, rng)
        return path
    data = seed.content
    ways: list[Callable[[bytes], bytes]] = [
        lambda d: _bytes(d, rng),
        lambda d: _lines(d, rng),
        lambda d: _number(d, rng),
        lambda d: _number(d, rng),
        lambda d: _word(d, rng),
        lambda d: _encoding(d, rng),
    ]
    if data.startswith(b"PK"):
        ways += [lambda d: _archive(d, rng)] * 10
    elif path.suffix in (".urdf", ".srdf", ".dae"):
        ways += [lambda d: _xml(d, rng)] * 6
    elif data.lstrip().startswith(b"{"):
        ways += [lambda d: _document(d, rng)] * 8
    if rng.random() < 0.03:
        data = _bomb(path.suffix, rng)
    elif rng.random() < 0.02:
        data = others[int(rng.integers(len(others)))].content
    else:
        for _ in range(1 if rng.random() < 0.85 else int(rng.integers(2, 5))):
            data = ways[int(rng.integers(len(ways)))](data)[:20_000_000]
    path.write_bytes(data)
    return path


def _pick(rng: Rng, items: Any) -> Any:
    return items[int(rng.integers(len(items)))]


def _in_its_place(path: Path, rng: Rng) -> None:
    """A FIFO, a device, a socket, a folder, nothing, a link to itself, a file of 100 GB."""
    what = int(rng.integers(7))
    if what == 0:
        os.mkfifo(path)
    elif what == 1:
        path.symlink_to(_pick(rng, ("/dev/zero", "/dev/urandom", "/dev/null", "/dev/full")))
    elif what == 2:
        with socket.socket(socket.AF_UNIX) as server:
            server.bind(str(path))
    elif what == 3:
        path.mkdir()
    elif what == 4:
        path.symlink_to(path.name)
    elif what == 5:
        with path.open("wb") as stream:
            stream.truncate(_pick(rng, (300_000_000, 100_000_000_000)))


def _span(data: bytes, rng: Rng, most: int) -> tuple[int, int]:
    begin = int(rng.integers(len(data) + 1))
    return begin, min(begin + int(rng.integers(1, most + 1)), len(data))


def _bytes(data: bytes, rng: Rng) -> bytes:
    way = int(rng.integers(9))
    a, b = _span(data, rng, 64)
    if way <= 2 and data:
        changed = bytearray(data)
        for k in rng.integers(len(data), size=int(rng.integers(1, 6))).tolist():
            changed[k] = changed[k] ^ (1 << int(rng.integers(8))) if way == 0 else int(rng.integers(256))
        return bytes(changed)
    if way == 3:
        return data[:a]
    if way == 4:
        return data[:a] + data[b:]
    if way == 5:
        return data[:b] + data[a:b] * int(_pick(rng, (1, 3, 1000))) + data[b:]
    if way == 6:
        return data[:a] + rng.bytes(int(rng.integers(1, 200))) + data[a:]
    if way == 7:
        return data[a:] + data[:a]
    return _pick(rng, (b"", b" \n\t", b"\0" * 64, rng.bytes(300), data + data, data + b"\0", b"\n" * 3000))


def _lines(data: bytes, rng: Rng) -> bytes:
    lines = data.split(b"\n")
    i, k = (int(rng.integers(len(lines))) for _ in range(2))
    way = int(rng.integers(6))
    if way == 0:
        del lines[i]
    elif way == 1:
        lines.insert(k, lines[i])
    elif way == 2:
        lines[i], lines[k] = lines[k], lines[i]
    elif way == 3:
        lines[i:i] = [lines[i]] * int(_pick(rng, (10, 3000)))
    elif way == 4:
        lines[i] = lines[i] + _pick(rng, (b"a", b" ", b"9", b"1 ", b"1,", b"[")) * int(
            _pick(rng, (10, 100_000, 3_000_000))
        )
    else:
        lines[i] = b" " * int(rng.integers(1, 9)) + lines[i].strip()
    return b"\n".join(lines)


def _number(data: bytes, rng: Rng) -> bytes:
    found = list(_NUMBER.finditer(data[:200_000]))
    if not found:
        return _bytes(data, rng)
    match = _pick(rng, found)
    return data[: match.start()] + _pick(rng, NUMBERS).encode() + data[match.end() :]


def _word(data: bytes, rng: Rng) -> bytes:
    found = list(_WORD.finditer(data[:200_000]))
    if not found:
        return _bytes(data, rng)
    match, other = _pick(rng, found), _pick(rng, found).group()
    new = _pick(rng, (other, b"", match.group() + b"x", match.group()[1:], match.group().upper(), b"\xc3\xa4", b"\xff"))
    return data[: match.start()] + new + data[match.end() :]


def _encoding(data: bytes, rng: Rng) -> bytes:
    text = data.decode("utf-8", "replace")
    way = _pick(rng, ("utf-16", "utf-16-le", "utf-32", "utf-8-sig", "latin-1", "crlf", "cr", "utf-7", "nul"))
    if way == "crlf":
        return data.replace(b"\n", b"\r\n")
    if way == "cr":
        return data.replace(b"\n", b"\r")
    if way == "nul":
        return data.replace(b" ", b"\0", 3)
    return (text + "é").encode(way, "replace")


def _bomb(suffix: str, rng: Rng) -> bytes:
    """Small files that grow, or that nest, for the format's own reader or for another."""
    deep = int(_pick(rng, (50, 1000, 100_000)))
    many = int(_pick(rng, (10_000, 1_000_000)))
    aliases = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
        f"{b}: &{b} [{', '.join([f'*{a}'] * 9)}]\n" for a, b in zip("abcdefgh", "bcdefghi", strict=True)
    )
    entities = "".join(f'<!ENTITY e{k} "{f"&e{k - 1};" * 10}">' for k in range(1, 30))
    empty = BytesIO()
    with zipfile.ZipFile(
        empty, "w", _pick(rng, (zipfile.ZIP_DEFLATED, zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2))
    ) as archive:
        head = (
            b"\x93NUMPY\x01\x00v\x00"
            + b"{'descr': '<f8', 'fortran_order': False, 'shape': (2500000,), }".ljust(117)
            + b"\n"
        )
        archive.writestr("metadata.npy", head + bytes(20_000_000))
    header = (
        b"\x93NUMPY\x01\x00v\x00"
        + b"{'descr': '<f8', 'fortran_order': False, 'shape': (99999999999, 3), }".ljust(117)
        + b"\n"
    )
    own = {
        ".urdf": [f"<!DOCTYPE r [<!ENTITY e0 'boom'>{entities}]><robot name='&e29;'/>", "<robot name='r'>" + "<a>" * deep + "</a>" * deep + "</robot>",
                  "<robot name='r'>" + "<a/>" * many + "</robot>", "<robot name='r'>" + "".join(f"<link name='l{k}'/>" for k in range(many // 100)) + "</robot>",
                  "<robot name='r'>" + _chain(300) + "</robot>", f"<robot name='{'x' * many}'><link name='a'/></robot>"],
        ".yaml": [aliases, "obstacles: " + "[" * deep + "]" * deep, "a:\n" + "".join(f"{' ' * k}- \n" for k in range(1, min(deep, 2000))),
                  "obstacles: [" + "1," * many + "]", "obstacles:\n" + "- {shape: sphere, radius: 1}\n" * (many // 300), "sensors: {" + "a: " * deep + "}"],
        ".json": ["[" * deep, '{"a":' * deep + "1" + "}" * deep, "[" + "[]," * many + "1]", '{"worlds": [' + '{"id": 1},' * (many // 10) + '{"id": 1}]}'],
        ".npz": [empty.getvalue(), b"PK\5\6" + b"\0" * 18, b"PK\5\6" + b"\xff" * 18],
        ".npy": [header, b"\x93NUMPY\x01\x00\xff\xff" + b"(" * 65535, header.replace(b"<f8", b"|O8"), header.replace(b"(99999999999, 3)", b"(-1, 3)       ")],
        ".csv": ["1,2,3\n" * many, "1," * many, "stamp,angle_min,angle_increment,range_min,range_max,ranges\n" + "1,0,0.1,0,9,1,2\n" * (many // 10)],
        ".jsonl": ['{"ranges": [' + "1," * many + "1]}", "[" * deep, '{"a":' * deep],
        ".log": ["FLASER 99999 " + "1 " * many, "RAWLASER1 0 0 1 0 9 0 0 2 1 1 0 0 0\n" * (many // 10)],
        ".xyz": ["1 2 3\n" * many, "1 " * many],
        ".pgm": [b"P5 30000 30000 255 ", b"P2 4000 4000 255 " + b"0 " * many, b"P5 " + b"#\n" * many],
        ".ply": ["ply\nformat ascii 1.0\nelement vertex 99999999999\nproperty float x\nproperty float y\nproperty float z\nend_header\n1 2 3\n",
                 "ply\nformat binary_little_endian 1.0\nelement vertex 9999999\nproperty list uchar int x\nelement face 99999999\nproperty list int int vertex_indices\nend_header\n"],
        ".pcd": ["FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 10000\nWIDTH 99999\nHEIGHT 99999\nDATA binary\n"],
        ".stl": [b"\0" * 80 + b"\xff\xff\xff\x7f" + b"\0" * 100, "solid s\n" + "facet\nouter loop\nvertex 0 0 0\n" * (many // 10)],
        ".obj": ["v 0 0 0\n" * (many // 10) + "f 1 2 99999999\n", "f " + "1 " * many],
        ".dae": [f"<!DOCTYPE r [<!ENTITY e0 'boom'>{entities}]><COLLADA>&e29;</COLLADA>", "<COLLADA>" + "<a>" * deep],
    }  # fmt: skip
    choices = own.get(".urdf" if suffix == ".srdf" else suffix, []) or own[".json"]
    made = _pick(rng, choices if rng.random() < 0.8 else own[_pick(rng, sorted(own))])
    return made if isinstance(made, bytes) else made.encode()


def _chain(count: int) -> str:
    """A robot of so many links, one after another."""
    return "<link name='l0'><collision><geometry><sphere radius='0.1'/></geometry></collision></link>" + "".join(
        f"<link name='l{k}'/><joint name='j{k}' type='fixed'><parent link='l{k - 1}'/><child link='l{k}'/></joint>"
        for k in range(1, count)
    )


def _document(data: bytes, rng: Rng) -> bytes:
    """A JSON document (or lines of them) with some of its values changed."""
    try:
        text = data.decode()
        documents = [json.loads(line) for line in text.splitlines() if line] if "\n{" in text else [json.loads(text)]
    except (ValueError, RecursionError):
        return _bytes(data, rng)
    places: list[tuple[Any, Any]] = []

    def walk(value: Any, depth: int = 0) -> None:
        pairs = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
        for key, inner in list(pairs):
            places.append((value, key))
            if depth < 20:
                walk(inner, depth + 1)

    for document in documents:
        walk(document)
    if not places:
        return _bytes(data, rng)
    for _ in range(1 if rng.random() < 0.8 else 3):
        holder, key = _pick(rng, places)
        way = int(rng.integers(8))
        try:
            if way == 0:
                del holder[key]
            elif way == 1 and isinstance(holder, dict):
                holder[str(key) + "x"] = holder.pop(key)
            elif way == 2 and isinstance(holder, list):
                holder.insert(key, holder[key])
            elif way == 3:
                other, place = _pick(rng, places)
                holder[key] = json.loads(json.dumps(other[place]))
            elif way == 4 and isinstance(holder, list):
                holder.extend(json.loads(json.dumps(holder)) * int(_pick(rng, (1, 300))))
            else:
                holder[key] = _pick(rng, VALUES)
        except (LookupError, ValueError, RecursionError):
            continue
    return "\n".join(json.dumps(document) for document in documents).encode("utf-8", "surrogatepass")


def _xml(data: bytes, rng: Rng) -> bytes:
    """An XML document with some of its elements or attributes changed."""
    try:
        root = etree.fromstring(data, etree.XMLParser(huge_tree=True, resolve_entities=False))
        elements = [e for e in root.iter() if isinstance(e.tag, str)]
        for _ in range(1 if rng.random() < 0.8 else 3):
            element, other = _pick(rng, elements), _pick(rng, elements)
            way = int(rng.integers(9))
            parent = element.getparent()
            if way == 0 and parent is not None:
                parent.remove(element)
            elif way == 1 and parent is not None:
                for _ in range(int(_pick(rng, (1, 1, 100)))):
                    parent.append(etree.fromstring(etree.tostring(element)))
            elif way == 2:
                element.append(etree.fromstring(etree.tostring(other)))
            elif way == 3:
                element.tag = other.tag
            elif way == 4 and element.attrib:
                del element.attrib[_pick(rng, sorted(element.attrib))]
            elif way == 5 and element.attrib:
                key = _pick(rng, sorted(element.attrib))
                element.set(key + "x", element.attrib.pop(key))
            elif element.attrib:
                key = _pick(rng, sorted(element.attrib))
                words = element.get(key).split() or [""]
                words[int(rng.integers(len(words)))] = _pick(rng, NUMBERS)
                names = [v for e in elements for v in e.attrib.values()]
                element.set(key, " ".join(words) if rng.random() < 0.8 else _pick(rng, names))
            elif element.text:
                element.text = _number(element.text.encode(), rng).decode()
        return etree.tostring(root)
    except (etree.XMLSyntaxError, ValueError, AttributeError):
        return _number(data, rng)


def _archive(data: bytes, rng: Rng) -> bytes:
    """A .npz file with some of its arrays changed, dropped, renamed or written in another way."""
    try:
        with np.load(BytesIO(data), allow_pickle=False) as loaded:
            arrays = {name: loaded[name] for name in loaded.files}
    except Exception:  # what an earlier mutation left is no archive any more
        return _bytes(data, rng)
    if not arrays:
        return _bytes(data, rng)
    for _ in range(1 if rng.random() < 0.7 else 3):
        name = _pick(rng, sorted(arrays)) if rng.random() < 0.7 or "metadata" not in arrays else "metadata"
        array = arrays[name]
        way = int(rng.integers(9))
        if name == "metadata" and way < 7 and array.dtype.kind == "U":
            arrays[name] = np.array(_document(str(array).encode("utf-8", "replace"), rng).decode("utf-8", "replace"))
        elif way <= 2 and array.dtype.kind == "f" and array.size:
            array.flat[int(rng.integers(array.size))] = _pick(
                rng, (np.nan, np.inf, -np.inf, 1e300, -1e300, 1e-300, 0.0, 1e9)
            )
        elif way == 3:
            arrays[name] = (
                array.astype(_pick(rng, ("f2", "f4", "i8", "u1", "c16", "U8", "b1")), copy=True)
                if array.dtype.kind in "fiub"
                else array
            )
        elif way == 4:
            arrays[name] = _pick(
                rng,
                (array[None], array.reshape(-1), array.T, np.atleast_1d(array)[..., :0], np.zeros(0), np.float64(1.0)),
            )
        elif way == 5:
            called = _pick(rng, sorted(arrays)) + _pick(rng, ("", "x"))
            arrays[called] = arrays.pop(name)
        elif way == 6:
            del arrays[name]
            if not arrays:
                return data
        elif array.dtype.kind in "iu" and array.size:
            array.flat[int(rng.integers(array.size))] = _pick(rng, (0, 1, 200, 127))
        elif way == 7:
            arrays["huge"] = np.zeros(3_000_000)
        else:
            arrays[name] = np.array([{"a": 1}], dtype=object)
    stream = BytesIO()
    if rng.random() < 0.2:
        with zipfile.ZipFile(
            stream, "w", _pick(rng, (zipfile.ZIP_STORED, zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2))
        ) as archive:
            for key, value in arrays.items():
                inner = BytesIO()
                np.save(inner, value)
                archive.writestr(key + ".npy", inner.getvalue())
    else:
        with np.errstate(all="ignore"):
            np.savez_compressed(stream, **arrays)  # type: ignore[arg-type]
    return stream.getvalue()
