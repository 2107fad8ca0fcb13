"""The existing mesh of a case: whether it is sound, and which of its points is which node of the grid."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import NoReturn

import numpy as np
import scipy

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import FloatArray, Grid, IntArray
from meshdeform_core.grid.topology import RELATIVE_TOLERANCE, find_topology, separated
from meshdeform_core.parallel import empty
from meshdeform_core.smoothness import shortest_edges
from meshdeform_core.wording import vector

from ..markers import point_numbers
from ..plausible import LARGEST
from .case import mesh_file
from .dictionary import parse_dictionary
from .lists import read_content, read_faces, read_labels, read_points

_FEWEST_DIGITS, _ALL_DIGITS, _EXACT = 6, 17, 12
_SAMPLES = 1000


def with_points_of(grid: Grid, mesh: Path) -> tuple[Grid, IntArray]:
    """The grid with the points of a mesh that blockMesh made of it, and the point number of every node (n_nodes,).

    Points are numbered as by blockMesh, or found by their places. Points of a few digits only show that it is the mesh:
    the coordinates stay those of the dictionary.

    Raises FormatError when a file is damaged, a point is not where a node of the grid is, or the numbers of points
    differ.
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
    own, digits = grid.points[nodes], _digits(points)
    # Up to half a unit of the last digit.
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


def _digits(points: FloatArray) -> int:
    """The number of significant digits, six or more, with which points were written."""
    sample = points[:: max(len(points) // _SAMPLES, 1)].ravel().tolist()
    texts = (digits for digits in range(_FEWEST_DIGITS, _ALL_DIGITS)
             if all(float(f"{value:.{digits}g}") == value for value in sample))  # fmt: skip
    return next(texts, _ALL_DIGITS)


def _require_sound(mesh: Path, n_points: int, n_cells: int) -> None:
    """Refuse a mesh whose faces, cells and patches do not fit together, with this many points and cells."""

    def damaged(what: str) -> NoReturn:
        raise FormatError(f"{mesh} is damaged: {what}; run blockMesh again")

    owner, neighbour = (read_labels(mesh_file(mesh, name), 6 * n_cells) for name in ("owner", "neighbour"))
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
