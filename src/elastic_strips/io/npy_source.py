"""IO room, npy source: arrays from ``.npy`` and ``.npz`` files; their sizes are checked before memory is allocated."""

from __future__ import annotations

import math
import struct
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from typing import IO, BinaryIO

import numpy as np
from numpy.typing import NDArray

MAX_DIRECTORY = 100_000  # bytes of a .npz file's list of members: a thousand of them
_ENTRY = struct.Struct("<4s4H2LH")  # how a zip file ends


class NpyError(ValueError):
    """Not an array, or one that is damaged or too large; the message says why."""


def read_npy(stream: IO[bytes], size: int, limit: int) -> NDArray[np.generic]:
    """An array of numbers or text in numpy's own format, read-only.

    Args:
        stream: binary stream at the array's beginning.
        size: bytes from there to the end.
        limit: largest size [bytes] that the array may have.

    Raises:
        NpyError: another format, Python objects or fields instead of numbers, or fewer or more bytes than the shape
            says.
    """
    try:
        version = np.lib.format.read_magic(stream)
        if version not in ((1, 0), (2, 0)):
            raise NpyError(f"is of version {version} of numpy's format; 1.0 and 2.0 are read")
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, fortran, dtype = read(stream)
    except (NpyError, OSError, zipfile.BadZipFile, zlib.error):
        raise
    except Exception as error:  # numpy evaluates the header as a Python literal: many kinds, and all of them damage
        raise NpyError(f"has no sound header: {' '.join(str(error).split())[:200]}") from None
    if dtype.kind not in "fiubUc" or dtype.itemsize == 0:
        raise NpyError(f"holds {'Python objects' if dtype.hasobject else dtype}, not numbers; they are not read")
    needed = math.prod(shape) * dtype.itemsize
    given = size - stream.tell()
    if needed != given or min(shape, default=0) < 0:
        raise NpyError(f"has {given} bytes; {dtype} of the shape {shape} has {needed}")
    if needed > limit:
        raise NpyError(f"has {needed} bytes; at most {limit} are read")
    data = stream.read(needed)
    if len(data) < needed:
        raise NpyError(f"is cut off after {len(data)} of {needed} bytes")
    return np.frombuffer(data, dtype=dtype).reshape(shape, order="F" if fortran else "C")


class NpzArrays(Mapping[str, NDArray[np.generic]]):
    """The arrays of a ``.npz`` file by name, each read when it is looked up; their total size is bounded.

    Raises:
        NpyError: not compressed as by numpy, or too large in all.
        zipfile.BadZipFile: not a zip file, or a damaged one.
    """

    def __init__(self, stream: BinaryIO, size: int, limit: int) -> None:
        """Read the list of the members.

        Args:
            stream: the file.
            size: its size [bytes].
            limit: largest size [bytes] of all arrays together, uncompressed.
        """
        _check_directory(stream, size)
        try:
            self._archive = zipfile.ZipFile(stream)
        except NotImplementedError as problem:  # a version of the format that zipfile does not know
            raise NpyError(f"is not an archive of numpy's: {problem}") from None
        self._limit = self._left = limit
        self._members = {
            info.filename.removesuffix(".npy"): info
            for info in self._archive.infolist()
            if info.filename.endswith(".npy")
        }

    def __getitem__(self, name: str) -> NDArray[np.generic]:
        info = self._members[name]
        if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) or info.flag_bits & 1:
            raise NpyError(f"the array {name!r} is encrypted, or compressed otherwise than by 'deflate'")
        if info.file_size > self._left:
            raise NpyError(f"the arrays have more than {self._limit} bytes together, which is the most that is read")
        try:
            with self._archive.open(info) as stream:
                array = read_npy(stream, info.file_size, self._left)
                stream.read(1)  # its end, where zipfile compares the checksum
        except (NpyError, NotImplementedError) as error:
            raise NpyError(f"the array {name!r} {error}") from None
        self._left -= array.nbytes
        return array

    def __iter__(self) -> Iterator[str]:
        return iter(self._members)

    def __len__(self) -> int:
        return len(self._members)

    def __contains__(self, name: object) -> bool:
        return name in self._members


def _check_directory(stream: BinaryIO, size: int) -> None:
    """Refuse a list of members that would fill the memory: zipfile reads all of it at once."""
    stream.seek(max(size - 42, 0))
    tail = stream.read(42)
    stream.seek(0)
    if len(tail) < 22 or tail[-22:-18] != b"PK\5\6":
        raise zipfile.BadZipFile("it does not end as a .npz file does")
    directory = _ENTRY.unpack(tail[-22:])[5]
    if directory > MAX_DIRECTORY or tail[:4] == b"PK\6\7":  # the latter: a second, larger list
        raise NpyError(f"the list of its arrays has more than {MAX_DIRECTORY} bytes")
