"""The arrays of .npy and .npz files, each checked against its size in the file before memory is allocated."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.errors import FormatError, MeshDeformError

from ..files import reason_of

# Deflate cannot compress more; other methods exceed this only for zeros.
_LARGEST_RATIO = 1100
# Coordinates and displacements compress far less; only zeros may compress more.
_LARGEST_WHOLE_RATIO, _SMALL = 100, 1 << 28
_ENCRYPTED = 1
_SUFFIX = ".npy"


def load_array(path: Path) -> NDArray[Any]:
    """The array of a .npy file.

    Raises
    ------
    FormatError
        When the file is truncated, damaged or holds Python objects.
    """
    try:
        with path.open("rb") as stream:
            return _array(stream, path.stat().st_size, path.name)
    except MeshDeformError as error:
        raise FormatError(f"cannot read {path}: {error}") from error
    # numpy evaluates the header as Python, which raises various errors for a damaged file.
    except Exception as error:
        raise _damaged(path, error) from error


def load_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """The arrays of a .npz file by name.

    Raises
    ------
    FormatError
        When the file is truncated, damaged, encrypted, has two arrays of the same name or members that are not arrays.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            _require_plausible(archive)
            arrays: dict[str, NDArray[Any]] = {}
            for name, values in _members(archive):
                if name in arrays:
                    raise FormatError(f"it has two arrays called {name}; expected one")
                arrays[name] = values
            return arrays
    except MeshDeformError as error:
        raise FormatError(f"cannot read {path}: {error}") from error
    # zipfile and its decompressors raise various errors for a damaged file.
    except Exception as error:
        raise _damaged(path, error) from error


def _damaged(path: Path, error: Exception) -> FormatError:
    return FormatError(f"cannot read {path}: {reason_of(error)}")


def _require_plausible(archive: zipfile.ZipFile) -> None:
    """Refuse, before memory is allocated, members that unpack to far more than data would."""
    members = archive.infolist()
    packed, unpacked = (sum(sizes) for sizes in zip(*((m.compress_size, m.file_size) for m in members), strict=True))
    if unpacked > max(_SMALL, _LARGEST_WHOLE_RATIO * packed):
        raise FormatError(
            f"its {len(members)} arrays unpack from {packed:,} to {unpacked:,} bytes, which no table of displacements "
            f"does; expected at most {_LARGEST_WHOLE_RATIO} times as many"
        )


def _members(archive: zipfile.ZipFile) -> Iterator[tuple[str, NDArray[Any]]]:
    for member in archive.infolist():
        if not member.filename.endswith(_SUFFIX):
            raise FormatError(f"its member {member.filename!r} is not an array; expected a file written by numpy.savez")
        if member.flag_bits & _ENCRYPTED:
            raise FormatError(f"its member {member.filename!r} is encrypted; save it without a password")
        if member.file_size > _LARGEST_RATIO * max(member.compress_size, 1):
            raise FormatError(
                f"its member {member.filename!r} unpacks from {member.compress_size} to {member.file_size} bytes; the "
                "file is damaged"
            )
        with archive.open(member) as stream:
            values = _array(stream, member.file_size, member.filename)
            # Reading to the end also verifies the checksum.
            if stream.read(1):
                raise FormatError(f"its member {member.filename!r} continues after the array")
        yield member.filename.removesuffix(_SUFFIX), values


def _array(stream: IO[bytes], size: int, name: str) -> NDArray[Any]:
    """The array in a stream of ``size`` bytes."""
    version = np.lib.format.read_magic(stream)
    readers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    if version not in readers:
        raise FormatError(f"{name} is an array of structures (format {version[0]}.{version[1]}); expected numbers")
    shape, _, dtype = readers[version](stream)
    if dtype.hasobject:
        raise FormatError(f"{name} holds Python objects, which are not read (allow_pickle=False); expected numbers")
    needed, left = math.prod(shape) * dtype.itemsize, size - stream.tell()
    if min(shape, default=1) < 0 or needed > left:
        raise FormatError(f"{name} declares {dtype} values of shape {shape}, {needed} bytes; {left} are left")
    stream.seek(0)
    return np.lib.format.read_array(stream, allow_pickle=False)
