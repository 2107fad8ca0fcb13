"""Files of OpenFOAM's meshes: lists of points, faces and labels, as text or binary; those packed by gzip are read, too.

Of the existing mesh of a case: whether it is sound, and which of its points is which node of the grid.
"""

from __future__ import annotations

import dataclasses
import gzip
import re
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import scipy
from numpy.typing import NDArray

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import FloatArray, Grid, IntArray
from meshdeform_core.grid.topology import RELATIVE_TOLERANCE, find_topology, separated
from meshdeform_core.parallel import empty
from meshdeform_core.smoothness import shortest_edges
from meshdeform_core.wording import vector

from ..files import LARGEST, reason_of, require_regular
from ..markers import point_numbers
from ..text import strict_numbers, text_rows
from .case import POLY_MESH, mesh_file

_ROWS_AT_ONCE = 20_000
_LABEL = np.dtype("<i4")
# Largest length of a row of text, which bounds what is decompressed.
_ROW_BYTES = 100
_BANNER = "/* Written by meshdeform */\n"
_LENGTH = re.compile(rb"\s*(?:(?://[^\n]*\n|/\*.*?\*/)\s*)*(\d+)\s*", re.DOTALL)


def write_points(path: Path, points: FloatArray, place: str, binary: bool) -> None:
    """A ``vectorField`` of points (n, 3); ``place`` is the folder that the header names."""
    with path.open("wb") as stream:
        _head(stream, "vectorField", "points", binary, place=place)
        _rows_in_list(stream, np.ascontiguousarray(points, dtype="<f8"), "(%.17g %.17g %.17g)\n", binary)


def write_labels(path: Path, labels: IntArray, binary: bool, note: str) -> None:
    """A ``labelList``; ``note`` holds the sizes of the mesh."""
    with path.open("wb") as stream:
        _head(stream, "labelList", path.name, binary, note)
        _rows_in_list(stream, labels.astype(_LABEL)[:, None], "%d\n", binary)


def write_faces(path: Path, corners: IntArray, kept: NDArray[np.bool_], binary: bool) -> None:
    """Faces from corners (n, 4) and which of them count: a ``faceList`` as text, a ``faceCompactList`` as binary."""
    sizes = kept.sum(axis=1)
    with path.open("wb") as stream:
        _head(stream, "faceCompactList" if binary else "faceList", "faces", binary)
        if binary:
            starts = np.concatenate([[0], np.cumsum(sizes)]).astype(_LABEL)
            _rows_in_list(stream, starts[:, None], "", True)
            _rows_in_list(stream, corners[kept].astype(_LABEL)[:, None], "", True)
            return
        stream.write(b"%d\n(\n" % len(corners))
        for begin in range(0, len(corners), _ROWS_AT_ONCE):
            rows = slice(begin, begin + _ROWS_AT_ONCE)
            lines = np.where(sizes[rows] == 4, "4(%d %d %d %d)", "3(%d %d %d)")
            stream.write(("\n".join(lines.tolist()) % tuple(corners[rows][kept[rows]].tolist()) + "\n").encode())
        stream.write(b")\n")


def write_boundary(path: Path, patches: list[str]) -> None:
    """The list of the patches, each as the text of its dictionary with its name before it."""
    with path.open("wb") as stream:
        _head(stream, "polyBoundaryMesh", "boundary", False)
        stream.write("\n".join([str(len(patches)), "(", *patches, ")", ""]).encode())


def _head(
    stream: BinaryIO, kind: str, name: str, binary: bool, note: str = "", place: str = POLY_MESH.as_posix()
) -> None:
    lines = ["version 2.0;", f"format {'binary' if binary else 'ascii'};", 'arch "LSB;label=32;scalar=64";']
    lines += [f"class {kind};", f'location "{place}";', f"object {name};"] + ([f'note "{note}";'] if note else [])
    stream.write((_BANNER + "FoamFile\n{\n" + "".join(f"    {line}\n" for line in lines) + "}\n\n").encode())


def _rows_in_list(stream: BinaryIO, rows: NDArray, line: str, binary: bool) -> None:
    """A list of rows (n, m): its length, and the values in parentheses."""
    stream.write(b"%d\n(" % len(rows))
    stream.writelines([np.ascontiguousarray(rows).data] if binary else [b"\n", *text_rows(rows, line)])
    stream.write(b")\n")


def read_points(path: Path, most: int) -> FloatArray:
    """The points (n, 3) of a mesh; no more than this many are expected."""
    return _read_list(path, "vectorField", float, 3, most)


def _read_list(path: Path, title: str, kind: type, width: int, most: int) -> NDArray[Any]:
    """The rows (n, width) of ``int`` or ``float`` in a file of class ``title``; no more than ``most`` are expected."""
    require_regular(path)
    try:
        with gzip.open(path) if path.suffix == ".gz" else path.open("rb") as stream:
            content = stream.read(_ROW_BYTES * (most + 100))
    except (OSError, EOFError) as error:
        raise FormatError(f"cannot read {path}: {reason_of(error)}") from error
    head = re.search(rb"FoamFile\s*\{([^}]*)\}", content)
    if head is None or not re.search(rb"\bclass\s+%b\b" % title.encode(), head[1]):
        raise FormatError(f"{path} is not a {title} of OpenFOAM")
    length = _LENGTH.match(content, head.end())
    if length is None:
        raise FormatError(f"{path} is truncated or damaged: there is no list")
    count, begin = int(length[1]), length.end()
    if re.search(rb"format\s+binary", head[1]):
        large = b"label=64" in head[1] if kind is int else b"scalar=32" not in head[1]
        dtype = np.dtype(f"<{'i' if kind is int else 'f'}{8 if large else 4}")
        body = content[begin + 1 : begin + 1 + count * width * dtype.itemsize]
        values = np.frombuffer(body[: len(body) // dtype.itemsize * dtype.itemsize], dtype)
    else:
        text = content[begin + 1 : content.rfind(b")")].replace(b"(", b" ").replace(b")", b" ").strip()
        try:
            with strict_numbers():
                values = np.fromstring(text, dtype=kind, sep=" ") if text else np.empty(0, dtype=kind)
        except ValueError as error:
            raise FormatError(f"{path} is damaged: {error}") from error
    if values.size != count * width or content[begin : begin + bool(count)] not in (b"(", b""):
        raise FormatError(f"{path} is truncated: {count:,} rows need {count * width:,} numbers")
    return values.reshape(count, width).astype(kind)


_FEWEST_DIGITS, _ALL_DIGITS, _EXACT = 6, 17, 12
_SAMPLES = 1000


def with_points_of(grid: Grid, mesh: Path) -> tuple[Grid, IntArray]:
    """The grid with the points of a mesh that blockMesh made of it, and the point number of every node (n_nodes,).

    Points are numbered as by blockMesh, or found by their places. Points of a few digits only show that it is the mesh:
    the coordinates stay those of the dictionary.
    """
    topology = separated(grid, find_topology(grid))
    number, nodes = point_numbers(grid, topology)
    path = mesh_file(mesh, "points")
    points = read_points(path, len(nodes))
    if len(points) != len(nodes):
        raise FormatError(
            f"{path} has {len(points):,} points, the blocks of {grid.path} have {len(nodes):,} nodes; "
            "expected a mesh that blockMesh made of it"
        )
    strange = np.flatnonzero(~(np.abs(points) <= LARGEST).all(axis=1))
    if strange.size:
        raise FormatError(
            f"{path}: point {strange[0]} is {vector(points[strange[0]])}; expected finite coordinates up to {LARGEST:g}"
        )
    _require_sound(mesh, grid.n_cells)
    # The number of significant digits with which points were written; their rounding is up to half a unit of the last.
    sample = points[:: max(len(points) // _SAMPLES, 1)].ravel().tolist()
    digits = _FEWEST_DIGITS
    while digits < _ALL_DIGITS and any(float(f"{value:.{digits}g}") != value for value in sample):
        digits += 1
    own = grid.points[nodes]
    rounding = 0.51 * 10.0 ** (1 - digits) * np.abs(own)
    allowed = np.maximum(RELATIVE_TOLERANCE * shortest_edges(grid)[nodes, None], rounding)
    found = _numbers_of_block_mesh(grid, number)
    if (np.abs(points[found] - own) > allowed).any():
        found = scipy.spatial.cKDTree(points).query(own)[1]
    excess = (np.abs(points[found] - own) - allowed).max(axis=1)
    if excess.max() > 0:
        worst = int(np.argmax(excess))
        raise FormatError(
            f"{path}: {int((excess > 0).sum())} points are not where the blocks of {grid.path} have nodes; the nearest "
            f"one to {grid.node_label(int(nodes[worst]))} = {vector(own[worst])} is "
            f"{np.linalg.norm(points[found[worst]] - own[worst]):.3g} away. Run blockMesh, or restore the undeformed "
            "points"
        )
    if len(np.unique(found)) < len(found):
        raise FormatError(
            f"{path}: two nodes of {grid.path} are nearest to one point; give it more digits, and where two points lie "
            "at one place the numbers of blockMesh"
        )
    numbering: IntArray = np.asarray(found[number], dtype=np.int64)
    if digits < _EXACT and np.abs(points[found] - own).max() > 10.0**-_EXACT * np.abs(own).max():
        note = f"{path} has {digits} digits only: the undeformed coordinates are those of the blockMeshDict"
        return dataclasses.replace(grid, notes=(*grid.notes, note)), numbering
    placed = dataclasses.replace(grid, points=empty(grid.points.shape))
    np.take(points, numbering, axis=0, out=placed.points, mode="clip")
    return placed, numbering


def _numbers_of_block_mesh(grid: Grid, number: IntArray) -> IntArray:
    """blockMesh's number of each point: in the order of the blocks, i running fastest, each where it comes first."""
    ranges = zip(grid.offsets, grid.offsets[1:], grid.shapes, strict=False)
    order = np.concatenate([number[low:high].reshape(shape).ravel(order="F") for low, high, shape in ranges])
    first = np.unique(order, return_index=True)[1]
    found = np.empty(len(first), dtype=np.int64)
    found[np.argsort(first)] = np.arange(len(first))
    return found


def _require_sound(mesh: Path, n_cells: int) -> None:
    """Refuse a mesh whose faces, which are copied as they are, name other cells than those of the grid."""
    files = {name: mesh_file(mesh, name) for name in ("owner", "neighbour", "faces", "boundary")}
    for path in (files["owner"], files["neighbour"]):
        cells = _read_list(path, "labelList", int, 1, 6 * n_cells)
        if cells.size and not 0 <= cells.min() <= cells.max() < n_cells:
            raise FormatError(
                f"{path} has numbers from {cells.min()} to {cells.max()}, expected 0 to {n_cells - 1}; run blockMesh"
            )
