"""Displacement tables as arrays: .npy, .npz and HDF5."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from meshdeform_core.errors import FormatError, MeshDeformError

from ..files import reason_of
from .table import DISPLACEMENT_NAMES, NO_TRIANGLES, POINT_NAMES, DisplacementTable, pick_vector, row_place

# Deflate cannot compress more; what declares more data was never written or is damaged.
_MAXIMUM_COMPRESSION = 1100
# Coordinates and displacements compress far less; only zeros may compress more.
_LARGEST_WHOLE_RATIO, _SMALL = 100, 1 << 28


def read_npy(path: Path) -> DisplacementTable:
    """Read an array ``(n, 6)`` of ``x y z dx dy dz`` or ``(n, 4)`` of ``x y dx dy``."""
    with _reading(path):
        values = np.load(path, allow_pickle=False)
    if values.ndim != 2 or values.shape[1] not in (4, 6) or values.dtype.kind not in "iuf":
        raise FormatError(f"{path} holds {values.dtype} numbers of shape {values.shape}; expected (n, 6) or (n, 4)")
    half = values.shape[1] // 2
    return DisplacementTable(values[:, :half], values[:, half:], NO_TRIANGLES, row_place)


def read_npz(path: Path) -> DisplacementTable:
    """Arrays ``points`` and ``displacement`` (n, 3), or ``x y z dx dy dz`` (n,), optionally ``triangles`` (m, 3)."""
    with _reading(path), np.load(path, allow_pickle=False) as archive:
        _require_plausible(archive.zip)
        names = [member.filename.removesuffix(".npy") for member in archive.zip.infolist()]
        arrays = {name: archive[name] for name in names}
        if len(arrays) < len(names):
            raise FormatError(f"it has several arrays of the same name: {', '.join(sorted(names))}")
        if other := [name for name, values in arrays.items() if not isinstance(values, np.ndarray)]:
            raise FormatError(f"its member {other[0]!r} is not an array; expected a file written by numpy.savez")
    table = _table_of_arrays({name: values for name, values in arrays.items() if values.dtype.kind in "iuf"})
    if table is None:
        raise FormatError(f"{path} needs arrays points and displacement, (n, 3) each; found {_list(arrays)}")
    return table


def read_hdf5(path: Path) -> DisplacementTable:
    """Read datasets as in npz, in the root group or in the one group below it that has them."""
    with _reading(path, " as HDF5"), h5py.File(path, "r") as file:
        below = {f"/{name}": entry for name, entry in _readable_members(file) if isinstance(entry, h5py.Group)}
        groups: dict[str, dict[str, NDArray[Any]]] = {}
        for name, group in ({"/": file} | below).items():
            sets = {key: entry for key, entry in _readable_members(group) if isinstance(entry, h5py.Dataset)}
            numbers = {key: entry for key, entry in sets.items() if entry.dtype.kind in "iuf" and entry.ndim in (1, 2)}
            for entry in numbers.values():
                stored = entry.id.get_storage_size()
                if entry.size * entry.dtype.itemsize > stored * _MAXIMUM_COMPRESSION:
                    declared = f"declares {entry.shape} {entry.dtype} values"
                    raise FormatError(f"{entry.name} {declared}; only {stored} bytes are stored")
            groups[name] = {key: entry[()] for key, entry in numbers.items()}
    tables = {name: table for name, arrays in groups.items() if (table := _table_of_arrays(arrays))}
    if len(tables) == 1:
        return next(iter(tables.values()))
    if tables:
        raise FormatError(f"{path} has displacements in several groups, {' '.join(tables)}; expected one")
    found = "; ".join(f"{name}: {_list(arrays)}" for name, arrays in groups.items())
    raise FormatError(f"{path} needs datasets points and displacement, (n, 3) each, in one group; found {found}")


def hdf5_entries(path: Path) -> set[str]:
    """Names in the root group, by which the program that wrote the file is recognised."""
    with _reading(path, " as HDF5"), h5py.File(path, "r") as file:
        return set(file)


@contextmanager
def _reading(path: Path, kind: str = "") -> Iterator[None]:
    """Errors of damaged files: numpy evaluates headers as Python; zipfile and h5py raise errors of any type."""
    try:
        yield
    except MeshDeformError as error:
        raise FormatError(f"cannot read {path}: {error}") from error
    except Exception as error:
        raise FormatError(f"cannot read {path}{kind}: {reason_of(error)}") from error


def _readable_members(group: h5py.Group) -> Iterator[tuple[str, Any]]:
    """Members of a group, except those whose name is not text and broken or circular links."""
    for name in group:
        try:
            entry = group[name] if isinstance(name, str) else None
        except (KeyError, OSError, RuntimeError):
            continue
        if entry is not None:
            yield name, entry


def _table_of_arrays(arrays: Mapping[str, NDArray[Any]]) -> DisplacementTable | None:
    triangles = arrays.get("triangles", NO_TRIANGLES)
    columns = {name: values for name, values in arrays.items() if name != "triangles"}
    points, displacement = pick_vector(POINT_NAMES, columns), pick_vector(DISPLACEMENT_NAMES, columns)
    if points is None or displacement is None or triangles.ndim != 2 or triangles.shape[1] != 3:
        return None
    return DisplacementTable(points, displacement, triangles, row_place)


def _list(arrays: Mapping[str, NDArray[Any]]) -> str:
    return ", ".join(f"{name} {values.shape}" for name, values in arrays.items()) or "none"


def _require_plausible(archive: zipfile.ZipFile) -> None:
    """Refuse, before memory is allocated, members that unpack to far more than data would."""
    members = archive.infolist()
    packed, unpacked = (sum(sizes) for sizes in zip(*((m.compress_size, m.file_size) for m in members), strict=True))
    if unpacked > max(_SMALL, _LARGEST_WHOLE_RATIO * packed):
        raise FormatError(
            f"its {len(members)} arrays unpack from {packed:,} to {unpacked:,} bytes, which no table of displacements "
            f"does; expected at most {_LARGEST_WHOLE_RATIO} times as many"
        )
