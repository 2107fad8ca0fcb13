"""Files of OpenFOAM's meshes: lists of points, faces and labels, as text or binary; those packed by gzip are read, too.

Of the existing mesh of a case: whether it is sound, and which of its points is which node of the grid.
"""

from __future__ import annotations

import dataclasses
import gzip
import re
from pathlib import Path
from typing import Any, BinaryIO, NoReturn

import numpy as np
import scipy
from numpy.typing import NDArray

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import FloatArray, Grid, IntArray
from meshdeform_core.grid.topology import RELATIVE_TOLERANCE, find_topology, separated
from meshdeform_core.parallel import empty
from meshdeform_core.velocity import shortest_edges
from meshdeform_core.wording import vector

from ..files import LARGEST, reason_of, require_regular
from ..markers import point_numbers
from ..text import strict_numbers, text_rows
from .case import POLY_MESH, mesh_file
from .dictionary import parse_dictionary

_ROWS_AT_ONCE = 20_000
_LABEL = np.dtype("<i4")
# Largest length of a row of text, which bounds what is decompressed.
_ROW_BYTES = 100
_BANNER = "/* Written by meshdeform */\n"
_LENGTH = re.compile(rb"\s*(?:(?://[^\n]*\n|/\*.*?\*/)\s*)*(\d+)\s*", re.DOTALL)
_CLOSED = -9
"""Stands for the closing parenthesis of a face."""


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
    return _ListFile(path, ("vectorField",), most).rows(float, 3)


def read_faces(path: Path, most: int) -> tuple[IntArray, IntArray]:
    """The points (m,) of all faces, one face after another, and where each begins (n + 1,)."""
    file = _ListFile(path, ("faceList", "faceCompactList"), most)
    if file.binary:
        start = file.rows(int, 1)[:, 0]
        corners = file.rows(int, 1)[:, 0]
    else:
        count, numbers = file.count(), file.numbers_of_text(int, b" %d " % _CLOSED)
        # Each face is the number of its corners, the corners, and the mark of a parenthesis.
        end = np.flatnonzero(numbers == _CLOSED)
        sizes = np.diff(end, prepend=-1) - 2
        start = np.append(0, np.cumsum(sizes))
        inside = np.ones(len(numbers), dtype=bool)
        inside[end] = inside[end - sizes - 1] = False
        corners = numbers[inside]
        if len(end) != count or not (numbers[end - sizes - 1] == sizes).all():
            raise FormatError(f"{path} is truncated or damaged: the sizes of its {count:,} faces do not fit")
    if start[0] != 0 or start[-1] != len(corners) or (np.diff(start) < 3).any():
        raise FormatError(f"{path} is truncated or damaged: faces need three or more corners")
    return corners, start


def read_content(path: Path, most: int = -1) -> bytes:
    """The content of a file, decompressed, at most this many bytes of it."""
    require_regular(path)
    try:
        with gzip.open(path) if path.suffix == ".gz" else path.open("rb") as stream:
            return stream.read(most)
    except (OSError, EOFError) as error:
        raise FormatError(f"cannot read {path}: {reason_of(error)}") from error


class _ListFile:
    """A file with a list of numbers, or with two if it is binary, to be read one after another."""

    def __init__(self, path: Path, kinds: tuple[str, ...], most: int):
        self._content = read_content(path, _ROW_BYTES * (most + 100))
        head = re.search(rb"FoamFile\s*\{([^}]*)\}", self._content)
        kind = re.search(rb"\bclass\s+(\w+)", head[1]) if head else None
        if head is None or kind is None or kind[1].decode() not in kinds:
            raise FormatError(f"{path} is not a {' or '.join(kinds)} of OpenFOAM")
        self._path, self._at = path, head.end()
        self.binary = re.search(rb"format\s+binary", head[1]) is not None
        self._types = {
            int: "<i8" if b"label=64" in head[1] else "<i4",
            float: "<f4" if b"scalar=32" in head[1] else "<f8",
        }

    def count(self) -> int:
        """The length in front of the next list."""
        found = _LENGTH.match(self._content, self._at)
        if found is None:
            raise FormatError(f"{self._path} is truncated or damaged: there is no list")
        self._at = found.end()
        return int(found[1])

    def rows(self, kind: type, width: int) -> NDArray[Any]:
        """The next list as rows (n, width) of ``int`` or ``float``."""
        count = self.count()
        if self.binary:
            size = count * width * np.dtype(self._types[kind]).itemsize
            begin = self._at + 1
            self._at = begin + size + 1 if count else self._at
            whole = len(self._content) >= begin + size and self._content[begin - 1 : begin] == b"("
            values = np.frombuffer(
                self._content, self._types[kind], count * width if whole else 0, begin if whole else 0
            )
        else:
            values = self.numbers_of_text(kind)
        if values.size != count * width:
            raise FormatError(f"{self._path} is truncated: {count:,} rows need {count * width:,} numbers")
        return values.reshape(count, width).astype(kind)

    def numbers_of_text(self, kind: type, closed: bytes = b" ") -> NDArray[Any]:
        """All numbers of a list of text; ``closed`` takes the place of closing parentheses within it."""
        text = self._content[self._at + 1 : self._content.rfind(b")")]
        text = text.replace(b"(", b" ").replace(b")", closed).strip()
        if not text:
            return np.empty(0, dtype=kind)
        try:
            with strict_numbers():
                return np.fromstring(text, dtype=kind, sep=" ")
        except ValueError as error:
            raise FormatError(f"{self._path} is damaged: {error}") from error


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
    _require_sound(mesh, len(points), grid.n_cells)
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


def _require_sound(mesh: Path, n_points: int, n_cells: int) -> None:
    """Refuse a mesh whose faces, cells and patches do not fit together, with this many points and cells."""

    def damaged(what: str) -> NoReturn:
        raise FormatError(f"{mesh} is damaged: {what}; run blockMesh again")

    files = (_ListFile(mesh_file(mesh, name), ("labelList",), 6 * n_cells) for name in ("owner", "neighbour"))
    owner, neighbour = (file.rows(int, 1)[:, 0] for file in files)
    corners, start = read_faces(mesh_file(mesh, "faces"), 6 * n_cells)
    inside, n_faces = len(neighbour), len(start) - 1
    if len(owner) != n_faces or inside > n_faces:
        damaged(f"faces has {n_faces:,} faces, owner {len(owner):,} and neighbour {inside:,}")
    for name, labels, count in (
        ("faces", corners, n_points),
        ("owner", owner, n_cells),
        ("neighbour", neighbour, n_cells),
    ):
        if labels.size and not 0 <= labels.min() <= labels.max() < count:
            damaged(f"{name} has numbers from {labels.min()} to {labels.max()}, expected 0 to {count - 1}")
    # Around a closed cell, each edge is passed once in each direction: with random integers at the points, the sum over
    # the edges of what changes its sign with the direction is exactly zero (modulo 2^64).
    one, two = np.random.default_rng(0).integers(2**63, size=(2, n_points), dtype=np.uint64)
    following = np.arange(1, len(corners) + 1)
    following[start[1:] - 1] = start[:-1]
    ahead = corners[following]
    area = np.add.reduceat(one[corners] * two[ahead] - two[corners] * one[ahead], start[:-1])
    total = np.zeros(n_cells, dtype=np.uint64)
    np.add.at(total, owner, area)
    np.subtract.at(total, neighbour, area[:inside])
    if total.any():
        damaged(f"{np.count_nonzero(total):,} cells are not closed by the faces of faces, owner and neighbour")
    path = mesh_file(mesh, "boundary")
    header, _, rest = read_content(path).decode("utf-8", "replace").partition("}")
    patches = parse_dictionary(f"{header}}} boundary {rest.rpartition(')')[0]});", path).list("boundary")
    while patches.more:
        name = patches.word("the name of a patch")
        patch = patches.dictionary(f"patch {name}")
        begin, count = (patch.reading(key).whole(f"{key} of patch {name}") for key in ("startFace", "nFaces"))
        if begin != inside or count < 0:
            damaged(f"patch {name} of boundary begins at face {begin:,}, expected {inside:,}")
        inside += count
    if inside != n_faces:
        damaged(f"the patches of boundary end at face {inside:,}, expected {n_faces:,}")
