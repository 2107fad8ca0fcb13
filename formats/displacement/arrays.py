"""Displacement tables as arrays: .npy, .npz and HDF5."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
from numpy.typing import NDArray

from meshdeform_core.errors import FormatError, MeshDeformError

from ..files import reason_of
from .numpy_files import load_array, load_arrays
from .table import DISPLACEMENT_NAMES, NO_TRIANGLES, POINT_NAMES, DisplacementTable, pick_vector, row_place

# Deflate cannot compress more; a dataset that declares more data was never written or is damaged.
_MAXIMUM_COMPRESSION = 1100


def read_npy(path: Path) -> DisplacementTable:
    """Read an array ``(n, 6)`` of ``x y z dx dy dz`` or ``(n, 4)`` of ``x y dx dy``.

    Raises
    ------
    FormatError
        When the file is truncated or has other content.
    """
    values = load_array(path)
    if values.ndim != 2 or values.shape[1] not in (4, 6) or values.dtype.kind not in "iuf":
        raise FormatError(f"{path} holds {values.dtype} numbers of shape {values.shape}; expected (n, 6) or (n, 4)")
    half = values.shape[1] // 2
    return DisplacementTable(values[:, :half], values[:, half:], NO_TRIANGLES, row_place)


def read_npz(path: Path) -> DisplacementTable:
    """Read arrays ``points`` and ``displacement`` (n, 3), or ``x y z dx dy dz`` (n,), optionally ``triangles`` (m, 3).

    Raises
    ------
    FormatError
        When the file is truncated or has no such arrays; the message lists those found.
    """
    arrays = load_arrays(path)
    table = _table({name: values for name, values in arrays.items() if values.dtype.kind in "iuf"})
    if table is None:
        raise FormatError(f"{path} needs arrays points and displacement, (n, 3) each; found {_list(arrays)}")
    return table


def read_hdf5(path: Path) -> DisplacementTable:
    """Read datasets as in npz, in the root group or in the one group below it that has them.

    Raises
    ------
    FormatError
        When the file is damaged, or not exactly one group has the datasets; the message lists those found.
    """
    with _opened(path) as file:
        groups = {name: _arrays(group) for name, group in _groups(file)}
    tables = {name: table for name, arrays in groups.items() if (table := _table(arrays))}
    if len(tables) == 1:
        return next(iter(tables.values()))
    if tables:
        raise FormatError(f"{path} has displacements in several groups, {' '.join(tables)}; expected one")
    found = "; ".join(f"{name}: {_list(arrays)}" for name, arrays in groups.items())
    raise FormatError(f"{path} needs datasets points and displacement, (n, 3) each, in one group; found {found}")


def hdf5_entries(path: Path) -> set[str]:
    """Names in the root group, by which the program that wrote the file is recognised."""
    with _opened(path) as file:
        return set(file)


@contextmanager
def _opened(path: Path) -> Iterator[h5py.File]:
    try:
        with h5py.File(path, "r") as file:
            yield file
    except MeshDeformError as error:
        raise FormatError(f"cannot read {path}: {error}") from error
    # For damaged files h5py raises OSError, RuntimeError, KeyError, ValueError or TypeError.
    except Exception as error:
        raise FormatError(f"cannot read {path} as HDF5: {reason_of(error)}") from error


def _groups(file: h5py.File) -> Iterator[tuple[str, h5py.Group]]:
    yield "/", file
    for name, entry in _entries(file):
        if isinstance(entry, h5py.Group):
            yield f"/{name}", entry


def _entries(group: h5py.Group) -> Iterator[tuple[str, Any]]:
    """Members of a group, except those whose name is not text and broken or circular links."""
    for name in group:
        try:
            entry = group[name] if isinstance(name, str) else None
        except (KeyError, OSError, RuntimeError):
            continue
        if entry is not None:
            yield name, entry


def _arrays(group: h5py.Group) -> dict[str, NDArray[Any]]:
    sets = {name: entry for name, entry in _entries(group) if isinstance(entry, h5py.Dataset)}
    numbers = {name: entry for name, entry in sets.items() if entry.dtype.kind in "iuf" and entry.ndim in (1, 2)}
    return {name: _values(entry) for name, entry in numbers.items()}


def _values(entry: h5py.Dataset) -> NDArray[Any]:
    stored = entry.id.get_storage_size()
    if entry.size * entry.dtype.itemsize > stored * _MAXIMUM_COMPRESSION:
        raise FormatError(f"{entry.name} declares {entry.shape} {entry.dtype} values; only {stored} bytes are stored")
    values: NDArray[Any] = entry[()]
    return values


def _table(arrays: Mapping[str, NDArray[Any]]) -> DisplacementTable | None:
    triangles = arrays.get("triangles", NO_TRIANGLES)
    columns = {name: values for name, values in arrays.items() if name != "triangles"}
    points, displacement = pick_vector(POINT_NAMES, columns), pick_vector(DISPLACEMENT_NAMES, columns)
    if points is None or displacement is None or triangles.ndim != 2 or triangles.shape[1] != 3:
        return None
    return DisplacementTable(points, displacement, triangles, row_place)


def _list(arrays: Mapping[str, NDArray[Any]]) -> str:
    return ", ".join(f"{name} {values.shape}" for name, values in arrays.items()) or "none"
