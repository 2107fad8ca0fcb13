"""Cells and faces of a grid in the order that OpenFOAM requires.

Cells are numbered block after block. Internal faces are sorted by their owner, the adjacent cell with the smaller
number, then by their neighbour; their normals point from the owner to the neighbour. Source: the OpenFOAM user guide,
"Mesh description".
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Grid, IntArray, Side
from meshdeform_core.grid.topology import Topology, cells_behind


@dataclass(frozen=True)
class Faces:
    """Faces of cells.

    Attributes
    ----------
    corners : (n, 4) point numbers, right-handed about the normal; two successive equal ones in triangles
    owner, neighbour : (n,) cells; -1 for outside faces
    """

    corners: IntArray
    owner: IntArray
    neighbour: IntArray

    def __getitem__(self, rows: IntArray) -> Faces:
        return Faces(self.corners[rows], self.owner[rows], self.neighbour[rows])


def internal_faces(grid: Grid, topology: Topology, number: NDArray[Any]) -> Faces:
    """All faces between two cells, in order; ``number`` as from :func:`point_numbers`.

    Raises
    ------
    FormatError
        When more than two blocks share a face, or a cell is its own neighbour.
    """
    if topology.crowded:
        raise FormatError(
            f"{topology.crowded} cell faces are shared by more than two blocks; OpenFOAM has no such mesh"
        )
    first = grid.cell_offsets
    parts = [
        _between(grid.block(b, number), int(first[b]), axis, int(topology.handedness[b]))
        for b in range(grid.n_blocks)
        for axis in range(3)
    ]
    parts.append(_across(grid, topology))
    faces = Faces(*(np.concatenate([getattr(p, name) for p in parts]) for name in ("corners", "owner", "neighbour")))
    faces = faces[np.flatnonzero(~_degenerate(faces.corners))]
    return faces[np.argsort(faces.owner * int(first[-1]) + faces.neighbour, kind="stable")]


def _between(number: NDArray[Any], first: int, axis: int, handedness: int) -> Faces:
    """The faces inside a block between neighbours along ``axis``."""
    ni, nj, nk = number.shape
    cells = first + np.arange((ni - 1) * (nj - 1) * (nk - 1)).reshape(ni - 1, nj - 1, nk - 1)
    inside = np.moveaxis(number, axis, 0)[1:-1]
    # With the other two axes in cyclic order, going round their quads in index order turns about +axis.
    if axis == 1:
        inside = inside.swapaxes(1, 2)
    corners = np.stack([inside[:, :-1, :-1], inside[:, 1:, :-1], inside[:, 1:, 1:], inside[:, :-1, 1:]], axis=-1)
    if axis == 1:
        corners = corners.swapaxes(1, 2)
    corners = corners.reshape(-1, 4)
    low, high = (np.moveaxis(cells, axis, 0)[part].ravel() for part in (slice(None, -1), slice(1, None)))
    return Faces(corners if handedness > 0 else corners[:, ::-1], low, high)


def _across(grid: Grid, topology: Topology) -> Faces:
    """The faces between blocks; the corners of the owner's quad turn about the outward normal."""
    quads = np.flatnonzero(topology.partner >= 0)
    here, there = (cells_behind(grid, topology, own) for own in (quads, topology.partner[quads]))
    if (here == there).any():
        quad = int(quads[int(np.argmax(here == there))])
        block, side = divmod(int(topology.quads.block_side[quad]), 6)
        raise FormatError(
            f"{grid.names[block]}.{Side(side).label}: a cell is its own neighbour; OpenFOAM has no such mesh, use two "
            "cells"
        )
    own = here < there
    return Faces(topology.quads.corners[quads[own]], here[own], there[own])


def _degenerate(corners: IntArray) -> np.ndarray:
    """Faces (n,) that are lines or points."""
    rows = np.sort(corners, axis=1)
    return 1 + np.count_nonzero(np.diff(rows, axis=1), axis=1) < 3


def kept_corners(corners: IntArray) -> np.ndarray:
    """(n, 4) bool: corners that differ from the one before, which are those of the polygon.

    Raises
    ------
    FormatError
        When a face passes through one point twice.
    """
    kept = corners != np.roll(corners, 1, axis=1)
    folded = np.flatnonzero((corners[:, 0] == corners[:, 2]) | (corners[:, 1] == corners[:, 3]))
    if folded.size:
        raise FormatError(
            f"{folded.size} cell faces pass through one point twice, the first {corners[folded[0]].tolist()}; OpenFOAM "
            "has no such faces"
        )
    return kept
