"""Displacement tables: the displacements of the points of a surface, from any file, with checks common to all.

A file is a table if it has displacements: text columns, arrays (.npy, .npz, HDF5), or a surface with a vector at its
points, preferably one called displacement. A structured grid (Plot3D, CGNS, VTK) is a table only if every block has a
node array called ``displacement``, ``disp`` or ``deformation``. Otherwise its coordinates are the deformed positions of
the same nodes, whatever solution (``U``, ...) it contains.
"""

from __future__ import annotations

import csv
import importlib
import re
from array import array
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.boundary.tables import SurfaceData
from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Grid, IntArray
from meshdeform_core.wording import counted, vector

from ..files import read_head, replacing
from ..grids import FORMATS, read_grid

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
    """The table of a surface with arrays at its points: the one called displacement, or its only vector."""
    displacement = pick_vector(DISPLACEMENT_NAMES, arrays)
    vectors = [values for values in arrays.values() if values.ndim == 2 and values.shape[1] == 3]
    if displacement is None and len(vectors) == 1:
        displacement = vectors[0]
    if displacement is None:
        found = ", ".join(f"{name} {values.shape[1:] or 'scalar'}" for name, values in arrays.items()) or "none"
        raise FormatError(f"{path} has no vector called displacement (or disp, d, u) at its points; found {found}")
    return DisplacementTable(points, displacement, triangles, row_place)


def checked_surface(table: DisplacementTable, path: Path) -> SurfaceData:
    """The table as surface data, with (n, 3) contiguous float64 arrays."""
    points, displacement = (
        np.ascontiguousarray(np.pad(values, ((0, 0), (0, 3 - values.shape[1]))), dtype=np.float64)
        for values in (table.points, table.displacement)
    )
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


def fans(connectivity: NDArray[Any], first: NDArray[Any], corners: NDArray[Any], strip: bool = False) -> IntArray:
    """Node numbers (t, 3) of triangles about the first corner of each polygon, or along strips of triangles.

    ``connectivity`` has the nodes of all cells; each begins at ``first`` (m,) and has ``corners`` (m,).
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


# meshio's formats that can hold a displacement at points, by suffix; others are recognised by a magic number.
_MESHIO_FORMATS = {
    ".avs": "avsucd", ".dat": "tecplot", ".med": "med", ".msh": "gmsh", ".tec": "tecplot", ".xdmf": "xdmf",
    ".xmf": "xdmf",
}  # fmt: skip
_TEXT_SUFFIXES = (".csv", ".txt", ".dat", ".tsv")


def read_displacement(path: str | Path) -> SurfaceData | Grid:
    """Read a displacement table, or a grid that holds the deformed position of the same nodes.

    Files are recognised by content where possible; text files by suffix: ``.csv``, ``.txt``, ``.dat`` and ``.tsv`` are
    columns of numbers, the suffixes of Plot3D are grids, others are read by meshio.

    Raises FormatError when the file is damaged or has no displacement (with what was found), numbers are not finite, or
    a point has two displacements (with both lines).
    """
    path = Path(path)
    table = _table_or_grid(path, read_head(path))
    return table if isinstance(table, Grid) else checked_surface(table, path)


def write_displacement(path: str | Path, data: SurfaceData) -> None:
    """Write a table as text (``.csv``, exact) or ``.npz`` (with triangles), replacing ``path`` as a whole."""
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in (".csv", ".npz"):
        raise FormatError(f"cannot write {path}: displacement tables can be written as .csv or .npz")
    with replacing(path) as partial:
        if suffix == ".npz":
            np.savez(partial, points=data.points, displacement=data.displacement, triangles=data.triangles)
        else:
            columns = np.hstack([data.points, data.displacement])
            np.savetxt(partial, columns, fmt="%.17g", delimiter=",", header="x,y,z,dx,dy,dz", comments="")


def _table_or_grid(path: Path, head: bytes) -> DisplacementTable | Grid:
    suffix, words = path.suffix.lower(), head.lower()
    if head.startswith(b"\x93NUMPY"):
        return _module("arrays").read_npy(path)
    if head.startswith(b"PK\x03\x04"):
        return _module("arrays").read_npz(path)
    if head.startswith(b"\x89HDF\r\n\x1a\n"):
        entries = _module("arrays").hdf5_entries(path)
        if "ENS_MAA" in entries:
            return _module("meshio").read(path, "med")
        return _read_structured(path) if "CGNSLibraryVersion" in entries else _module("arrays").read_hdf5(path)
    if head.startswith(b"# vtk DataFile") or b"<VTKFile" in head:
        from ..vtk.legacy import LegacyFile
        from ..vtk.xml_tags import read_tags

        if head.startswith(b"# vtk DataFile"):
            with path.open("rb") as stream:
                kind = LegacyFile(path, stream).kind
            if kind == "UNSTRUCTURED_GRID":
                return _module("meshio").read(path, "vtk")
            return _module("vtk").read_vtk_legacy(path) if kind == "POLYDATA" else _read_structured(path)
        kind = read_tags(path).kind
        if kind in ("PPolyData", "PUnstructuredGrid"):
            raise FormatError(f"{path} is the index of a parallel data set; expected its pieces merged into one file")
        return _module("vtk").read_vtk_xml(path) if kind in ("PolyData", "UnstructuredGrid") else _read_structured(path)
    if suffix in _TEXT_SUFFIXES and not (b"variables" in words and b"zone" in words):
        # With both words it is Tecplot's.
        return read_text(path)
    if b"ADF Database Version" in head[:64] or suffix in FORMATS["plot3d"].suffixes:
        return _read_structured(path)
    if suffix == ".frd":
        return _module("frd").read(path)
    if suffix not in _MESHIO_FORMATS:
        known = " ".join(sorted({*_MESHIO_FORMATS, ".frd"}))
        called = f"with suffix {suffix}" if suffix else "without suffix"
        raise FormatError(
            f"{path}: a file {called} is not a displacement table; expected text "
            f"({' '.join(_TEXT_SUFFIXES)}), .npz, .npy, HDF5, VTK, {known}, or a grid"
        )
    return _module("meshio").read(path, _MESHIO_FORMATS[suffix])


def _module(name: str) -> ModuleType:
    """A reader, imported when first needed: importing h5py and meshio is slow."""
    return importlib.import_module(f"{__package__}.{name}")


def _read_structured(path: Path) -> DisplacementTable | Grid:
    grid = read_grid(path)
    known = []
    for block in range(grid.n_blocks):
        fields = [field for field in grid.fields if field.block == block and field.location == "node"]
        values = pick_vector(VECTOR_NAMES, {f.name: f.values.reshape(-1, *f.values.shape[3:]) for f in fields})
        known += [] if values is None else [values]
    if len(known) < grid.n_blocks:
        return grid
    numbers = np.arange(grid.n_nodes)
    triangles = [
        grid_triangles(numbers[low:high].reshape(shape))
        for low, high, shape in zip(grid.offsets, grid.offsets[1:], grid.shapes, strict=False)
    ]
    return DisplacementTable(grid.points, np.concatenate(known), np.concatenate(triangles), grid.node_label)


# --- columns separated by commas, semicolons, tabs or blanks, with or without a header

_UNITS = {"m", "dm", "cm", "mm", "um", "µm", "nm", "km", "in", "inch", "inches", "ft", "feet", "yd"}
_BY_ORDER = {6: "x y z dx dy dz", 4: "x y dx dy", 3: "number x y, as of SU2"}


def read_text(path: Path) -> DisplacementTable:
    """Read a text table.

    Without a header the columns are ``x y z dx dy dz``, or ``x y dx dy`` in 2-D, or the number and the new position of
    each point, as in SU2's surface_positions.dat. A header, possibly in a comment, names any number of columns in any
    order (see :func:`vector_names`). ``#`` begins a comment.
    """
    header, remark, separator, width = "", "", None, 0
    points: tuple[int, ...] = ()
    moves: tuple[int, ...] = ()
    lines, values, named = array("q"), array("d"), False
    for number, text, comment in _contents(path):
        if not text:
            remark = remark if width else comment
            continue
        if not width:
            separator = next((mark for mark in ";," if mark in text), None)
        words = _words(text, separator)
        if not width:
            wrong = [word for word in words if not _is_number(word)]
            if not header and len(wrong) == len(words):
                header = text
                continue
            if not header and wrong:
                raise FormatError(f"{path}, line {number}: {_no_number(wrong[0])}")
            width = len(words)
            points, moves, named = _columns(path, number, separator, width, header, remark)
        if len(words) != width:
            raise FormatError(f"{path}, line {number}: found {len(words)} columns; expected {width} as before")
        own = [words[column] for column in points + moves]
        # Python also reads 1_000 and the digits of other scripts.
        strange = "_" in text or not text.isascii()
        try:
            values.extend(map(float, own))
        except ValueError:
            strange = True
        if strange and (wrong := [word for word in own if not _is_number(word)]):
            raise FormatError(f"{path}, line {number}: {_no_number(wrong[0])}")
        lines.append(number)
    if not lines:
        below = f" below the header {header[:60]!r}" if header else ""
        raise FormatError(f"{path} has no rows of numbers{below}")
    rows = np.frombuffer(values).reshape(len(lines), -1)
    split = len(points)
    return DisplacementTable(rows[:, :split], rows[:, split:], NO_TRIANGLES, lambda row: f"line {lines[row]}", named)


def _contents(path: Path) -> Iterator[tuple[int, str, str]]:
    """Number, text before ``#`` and comment after it of each line that is not blank."""
    try:
        with path.open(encoding="utf-8-sig") as stream:
            for number, line in enumerate(stream, start=1):
                text, _, comment = line.partition("#")
                if text.strip() or comment.strip():
                    yield number, text.strip(), comment.strip()
    except UnicodeDecodeError as error:
        raise FormatError(f"{path} is not UTF-8 text: {error}") from error


def _columns(
    path: Path, number: int, separator: str | None, width: int, header: str, comment: str
) -> tuple[tuple[int, ...], tuple[int, ...], bool]:
    """The columns of points and displacement in the rows that begin at line ``number``, and whether names tell them."""
    names = _words(header or comment, separator)
    if len(names) != width:
        names = _words(header or comment, None)
    try:
        found = [vector_names(wanted, names) for wanted in (POINT_NAMES, DISPLACEMENT_NAMES)]
    except FormatError as error:
        raise FormatError(f"{path}: {error}") from None
    if len(names) == width and found[0] and found[1]:
        units = {unit.lower() for name in found[0] + found[1] for unit in re.findall(r"[\[(]\s*(\w+)\s*[\])]", name)}
        if len(units := units & _UNITS) > 1:
            # Like ``x [m]`` and ``dx [mm]``.
            raise FormatError(
                f"{path}: its columns have lengths in {', '.join(sorted(units))}; expected all in the grid's unit"
            )
        points, displacement = (tuple(map(names.index, columns)) for columns in found if columns)
        return points, displacement, True
    if header:
        raise FormatError(
            f"{path}: expected a name for each of {width} columns, x y z (or x y) and dx dy dz (or dx dy) among them; "
            f"found {' '.join(map(repr, names))}"
        )
    if width not in _BY_ORDER:
        expected = " or ".join(f"{number} ({names})" for number, names in _BY_ORDER.items())
        raise FormatError(f"{path}, line {number}: found {width} columns without names; expected {expected}")
    half = (width + 1) // 2
    return tuple(range(half)), tuple(range(half, width)), False


def _words(text: str, separator: str | None) -> list[str]:
    if separator is None:
        return [word.strip('"') for word in text.split()]
    if '"' not in text or len(text) > csv.field_size_limit():
        return [word.strip() for word in text.split(separator)]
    return [word.strip() for word in next(csv.reader([text], delimiter=separator, skipinitialspace=True))]


def _is_number(word: str) -> bool:
    """Whether it is a number without underscores and in plain digits."""
    try:
        float(word)
    except ValueError:
        return False
    return word.isascii() and "_" not in word


def _no_number(word: str) -> str:
    comma = "; decimal commas are not read: write points" if _is_number(word.replace(",", ".", 1)) else ""
    return f"{word!r} is not a number{comma}"
