"""Tables that name points by number, like SU2's surface_positions.dat: numbers and new positions."""

from __future__ import annotations

import numpy as np

from ...errors import MotionError
from ...grid import FloatArray, Grid, IntArray
from ...grid.topology import Topology
from .matching import SurfaceData
from .tuned import COUNTED

_ROUGH = 3.0
"""If the displacements of neighbours typically differ by more than this many edges, the numbers of the points belong to
another mesh."""


def positions_by_number(
    numbers: IntArray, positions: FloatArray, label: str, grid: Grid, topology: Topology
) -> SurfaceData:
    """The displacements of points whose new ``positions`` (n, 3), or (n, 2) in a plane grid, are given by ``numbers``
    (n,); numbering is that of the unstructured files that this program writes.

    Raises
    ------
    MotionError
        When a number does not denote a point on a block face, or neighbours move so differently that the numbers must
        belong to another mesh.
    """
    beyond = np.flatnonzero((numbers < 0) | (numbers >= topology.n_unique))
    if beyond.size:
        raise MotionError(
            f"{label}: {beyond.size} numbers are not of points on block faces, the first {numbers[beyond[0]]}; these "
            f"have 0 to {topology.n_unique - 1}"
        )
    points = grid.nodes.at(topology.first[numbers])
    moved = points.copy()
    kept = np.sort(np.argsort(np.ptp(grid.points, axis=0))[3 - positions.shape[1] :])
    moved[:, kept] = positions
    row = np.full(topology.n_unique, -1, dtype=np.int64)
    row[numbers] = np.arange(len(numbers))
    a, b = row[topology.quads.corners[:, :2]].T
    a, b = a[(a >= 0) & (b >= 0)], b[(a >= 0) & (b >= 0)]
    displacement = moved - points
    apart = np.linalg.norm(displacement[a] - displacement[b], axis=1)
    if a.size and float(np.median(apart - _ROUGH * np.linalg.norm(points[a] - points[b], axis=1))) > 0:
        raise MotionError(
            f"{label}: neighbours move apart by several edges almost everywhere; its numbers seem to be those of "
            "another mesh than the one that `meshdeform convert` writes"
        )
    return SurfaceData(points, displacement, np.empty((0, 3), dtype=np.int64), label)


def by_place(data: SurfaceData, grid: Grid, topology: Topology) -> SurfaceData:
    """The table itself; or what it means, if its first column numbers the points and positions follow.

    These are three columns, or four for a grid in space, which without names are read as x, y, dx and dy of a plane.

    Raises
    ------
    MotionError
        As above, and for three columns that are not a number, x and y in a plane grid.
    """
    first = data.points[:, 0]
    whole = bool((first == np.round(first)).all())
    if data.numbered and not (whole and grid.dimension == 2):
        raise MotionError(
            f"{data.label} has three columns: for a plane grid the number of a point, x and y; expected "
            "x y z dx dy dz (or x y dx dy), or the number of each point and all its new coordinates"
        )
    distinct = whole and len(first) > COUNTED and len(np.unique(first)) == len(first)
    if not data.numbered and not (data.plane and distinct and grid.dimension == 3):
        return data
    positions = np.column_stack([data.points[:, 1], data.displacement])[:, : grid.dimension]
    return positions_by_number(first.astype(np.int64), positions, data.label, grid, topology)
