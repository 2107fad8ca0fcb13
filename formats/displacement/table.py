"""Points with displacements from any file: names of columns, triangles of cells, checks common to all tables."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.boundary.tables import SurfaceData
from meshdeform_core.errors import FormatError
from meshdeform_core.grid import FloatArray, IntArray
from meshdeform_core.wording import counted, vector

POINT_NAMES = ("", "points", "point", "coordinates", "coordinate", "coords", "coord", "positions", "position", "nodes")
VECTOR_NAMES = ("displacement", "displacements", "pointdisplacement", "disp", "displ", "depl", "deformation")
DISPLACEMENT_NAMES = (*VECTOR_NAMES, "delta", "d", "u")

NO_TRIANGLES: IntArray = np.empty((0, 3), dtype=np.int64)

# Points that differ by less than this fraction of the largest coordinate, by rounding, are identical.
_TOGETHER = 1e-14
# Coincident points must have the same displacement, up to this fraction of the largest one.
_ALIKE = 1e-9


@dataclass(frozen=True)
class DisplacementTable:
    """A table as read.

    Attributes
    ----------
    points, displacement : (n, 2) or (n, 3)
    triangles : (m, 3) indices into ``points``
    place : text for the position of row ``i`` in the file, such as ``line 7``
    named : whether the file says what its columns are
    """

    points: NDArray[Any]
    displacement: NDArray[Any]
    triangles: IntArray
    place: Callable[[int], str]
    named: bool = True


def row_place(row: int) -> str:
    """Position of a row in a file without lines."""
    return f"row {row + 1}"


def vector_names(
    names: Sequence[str], scalars: Collection[str], vectors: Collection[str] = ()
) -> tuple[str, ...] | None:
    """The array, or the two or three columns, of the vector called one of ``names``; ``None`` if absent.

    Case, units in brackets and punctuation do not matter. The components of ``u`` are ``u_x u_y u_z``, ``u0 u1 u2``,
    ``u1 u2 u3`` or ``x-u y-u z-u``; without a third one the vector is two-dimensional.

    Raises FormatError when two columns have the name of a component.
    """
    whole = {_plain(name): name for name in reversed(list(vectors))}
    parts = {_plain(name): name for name in reversed(list(scalars))}
    for name in names:
        if name in whole:
            return _single((whole[name],), vectors)
        patterns = ["{name}{axis}", "{axis}{name}"] if name else ["{axis}"]
        for pattern in patterns:
            for axes in ("xyz", "012", "123") if pattern == "{name}{axis}" else ("xyz",):
                found = [parts.get(pattern.format(name=name, axis=axis)) for axis in axes]
                if found[0] and found[1]:
                    return _single(tuple(word for word in found if word), scalars)
    return None


def _single(found: tuple[str, ...], names: Collection[str]) -> tuple[str, ...]:
    for name in found:
        same = [other for other in names if _plain(other) == _plain(name)]
        if len(same) > 1:
            raise FormatError(f"a table has several columns for the same component: {' '.join(map(repr, same))}")
    return found


def _plain(name: str) -> str:
    return re.sub(r"\[.*\]|\(.*\)|[^a-z0-9]", "", name.lower())


def pick_vector(names: Sequence[str], arrays: Mapping[str, NDArray[Any]]) -> NDArray[Any] | None:
    """The vector called one of ``names``, (n, 2) or (n, 3), from arrays by name; ``None`` if absent."""
    vectors = [name for name, values in arrays.items() if values.ndim == 2 and values.shape[1] in (2, 3)]
    scalars = [name for name, values in arrays.items() if values.ndim == 1]
    found = vector_names(names, scalars, vectors)
    if found is None:
        return None
    return arrays[found[0]] if len(found) == 1 else np.stack([arrays[name] for name in found], axis=1)


def surface_table(
    path: Path, points: NDArray[Any], arrays: Mapping[str, NDArray[Any]], triangles: NDArray[Any]
) -> DisplacementTable:
    """The table of a surface with arrays at its points: the one called displacement, or its only vector.

    Raises FormatError when there is none, or several vectors with other names; the message lists them.
    """
    displacement = pick_vector(DISPLACEMENT_NAMES, arrays)
    vectors = [values for values in arrays.values() if values.ndim == 2 and values.shape[1] == 3]
    if displacement is None and len(vectors) == 1:
        displacement = vectors[0]
    if displacement is None:
        found = ", ".join(f"{name} {values.shape[1:] or 'scalar'}" for name, values in arrays.items()) or "none"
        raise FormatError(f"{path} has no vector called displacement (or disp, d, u) at its points; found {found}")
    return DisplacementTable(points, displacement, triangles, row_place)


def checked_surface(table: DisplacementTable, path: Path) -> SurfaceData:
    """The table as surface data, with (n, 3) contiguous float64 arrays.

    Raises FormatError when it is empty, contains non-finite numbers or different displacements of one point, or when
    triangles refer to points that do not exist.
    """
    points, displacement = (_three_columns(values) for values in (table.points, table.displacement))
    if len(points) != len(displacement):
        raise FormatError(f"{path} has {len(points)} points but {len(displacement)} displacements")
    if not len(points):
        raise FormatError(f"{path} has no points with displacements")
    for what, values in (("point", points), ("displacement", displacement)):
        bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
        if bad.size:
            raise FormatError(
                f"{path}, {table.place(int(bad[0]))}: the {what} {vector(values[bad[0]])} is not finite "
                f"({counted(bad.size, 'such row')})"
            )
    largest = float(np.abs(points).max())
    places = np.round(points / largest / _TOGETHER) if largest else points
    order = np.lexsort(places.T)
    same = (places[order[1:]] == places[order[:-1]]).all(axis=1)
    first, second = order[:-1][same], order[1:][same]
    apart = np.abs(displacement[first] - displacement[second]).max(axis=1, initial=0)
    conflict = np.flatnonzero(apart > _ALIKE * np.abs(displacement).max())
    if conflict.size:
        one, other = sorted((int(first[conflict[0]]), int(second[conflict[0]])))
        raise FormatError(
            f"{path}: the point {vector(points[one])} has two displacements, {vector(displacement[one])} in "
            f"{table.place(one)} and {vector(displacement[other])} in {table.place(other)}; keep one of them"
        )
    if not (table.triangles == np.floor(table.triangles)).all():
        raise FormatError(f"{path} has triangles whose corners are not whole numbers; expected row numbers of points")
    triangles = np.ascontiguousarray(table.triangles, dtype=np.int64)
    if triangles.size and not 0 <= triangles.min() <= triangles.max() < len(points):
        raise FormatError(f"{path}: triangles refer to points {triangles.min()} to {triangles.max()} of {len(points)}")
    width = table.displacement.shape[1]
    distinct = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
    numbered = not table.named and width < 3
    return SurfaceData(points, displacement, triangles[distinct], path.name, width == 2, numbered)


def _three_columns(values: NDArray[Any]) -> FloatArray:
    padding = np.zeros((len(values), 3 - values.shape[1]))
    return np.ascontiguousarray(np.hstack([values, padding]), dtype=np.float64)


def fans(connectivity: NDArray[Any], first: NDArray[Any], corners: NDArray[Any], strip: bool = False) -> IntArray:
    """Split polygons into triangle fans about their first corner, or triangle strips into triangles.

    Parameters
    ----------
    connectivity : node numbers of all cells, one after the other
    first, corners : (m,) index at which each cell begins, and its number of corners

    Returns
    -------
    (t, 3) node numbers; none for cells with fewer than three corners
    """
    count = np.maximum(corners - 2, 0)
    start = np.repeat(first, count)
    step = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    apex = start + step if strip else start
    return connectivity[np.stack([apex, start + step + 1, start + step + 2], axis=1)].astype(np.int64)


def grid_triangles(number: NDArray[Any]) -> IntArray:
    """Triangles of a plane of nodes, or of the six faces of a block, from its node numbers ``(ni, nj, nk)``."""
    if 1 in number.shape:
        faces = [number.squeeze(axis=number.shape.index(1))]
    else:
        faces = [np.take(number, end, axis=axis) for axis in range(3) for end in (0, -1)]
    quads = [np.stack([f[:-1, :-1], f[1:, :-1], f[1:, 1:], f[:-1, 1:]], axis=-1).reshape(-1, 4) for f in faces]
    return split_cells(np.concatenate(quads), 4)


def split_cells(cells: NDArray[Any], corners: int) -> IntArray:
    """Triangles of cells ``(m, nodes)`` whose first ``corners`` nodes are their corners."""
    m, nodes = cells.shape
    return fans(cells.ravel(), nodes * np.arange(m), np.full(m, corners))


def starts_of_list(entries: NDArray[Any]) -> IntArray:
    """Index at which each cell begins in a list ``n a b c ... n d e ...``; ends with the first that does not fit.

    Each entry is taken as the length of a jump to the next cell. The chain of jumps from the first entry is found by
    doubling: each round doubles the length of all jumps and the number of known cells.
    """
    size = len(entries)
    jump = np.append(np.arange(size) + 1 + np.clip(entries, 0, size), size)
    jump = np.minimum(jump, size)
    starts = np.zeros(1, dtype=np.int64)
    while starts[-1] < size:
        starts = np.concatenate([starts, jump[starts]])
        jump = jump[jump]
    return starts[starts < size]
