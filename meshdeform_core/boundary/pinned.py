"""Cells and faces all of whose nodes are prescribed: their shape follows from the boundary's motion, whatever the
method."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..grid import BoolArray, FloatArray, Grid, IntArray
from ..grid.planes import plane_normal
from ..grid.topology import Topology
from ..notices import Notice
from ..parallel import rows_at
from ..wording import vector
from .classification import UNSELECTED, Boundary, Kind

# Corners of undeformed cells flatter than this, relative to the product of their edges, are collapsed and not judged.
_COLLAPSED = 1e-10
_TORN = 0.5
"""Faces are torn where their nodes move apart by more than this share of their distance."""


@dataclass(frozen=True)
class PinnedCells:
    """Cells that the prescribed displacements of all of their nodes invert.

    Attributes
    ----------
    count : number of cells
    block, ijk : location of the first one, indices from 1
    center : mean of its corners after the motion (grid length unit)
    """

    count: int
    block: str
    ijk: tuple[int, int, int]
    center: tuple[float, float, float]

    @property
    def message(self) -> Notice:
        """Warning: what is wrong and where."""
        place = ", ".join(f"{x:.6g}" for x in self.center)
        cells = (
            "1 cell, whose nodes are all prescribed, is"
            if self.count == 1
            else f"{self.count} cells, whose nodes are all prescribed, are"
        )
        text = (
            f"{cells} inverted by the motion of the boundary itself, so no valid grid exists: first in {self.block} at "
            f"{self.ijk}, around ({place})"
        )
        return Notice(text, f"prescribed cells inverted in {self.block}")


def find_pinned(grid: Grid, topology: Topology, boundary: Boundary, displacement: FloatArray) -> PinnedCells | None:
    """Cells with only prescribed nodes that a displacement (n_unique, 3) of the boundary inverts, or ``None``.

    Inverted means that the Jacobian at a corner that was not collapsed changes sign or vanishes.
    """
    known = np.zeros(grid.n_nodes, dtype=bool)
    known[topology.face_nodes] = boundary.known[topology.number]
    normal = plane_normal(grid)
    count, first = 0, None
    for block in range(grid.n_blocks):
        cells = _cells_of(grid.block(block, known))
        corners = _corners(grid, block, cells)
        before = rows_at(grid.points, corners)
        after = before + displacement[topology.numbers_of(corners.ravel())].reshape(before.shape)
        bad = _inverted(before, after, normal)
        count += int(bad.sum())
        if first is None and bad.any():
            index = int(np.argmax(bad))
            i, j, k = (int(n) + 1 for n in cells[index])
            x, y, z = after[index].reshape(-1, 3).mean(axis=0)
            first = (grid.names[block], (i, j, k), (float(x), float(y), float(z)))
    return PinnedCells(count, *first) if first else None


def torn_faces(grid: Grid, topology: Topology, boundary: Boundary, displacement: FloatArray) -> list[Notice]:
    """Warnings about fixed patches whose faces a displacement (n_unique, 3) tears at the edges of moving ones."""
    notices = []
    for patch in boundary.patches:
        corners = topology.quads.corners[patch.quads]
        moves = boundary.kind[corners] == Kind.MOVING
        corners = corners[moves.any(axis=1) & ~moves.all(axis=1)]
        if patch.kind is not Kind.FIXED or patch.name == UNSELECTED or not corners.size:
            continue
        x, moved = rows_at(grid.points, topology.first[corners]), displacement[corners]
        edge, apart = (np.linalg.norm(each - np.roll(each, 1, axis=1), axis=-1) for each in (x, moved))
        torn = apart > _TORN * edge
        if torn.any():
            worst = np.unravel_index(np.argmax(np.where(torn, apart, 0.0)), torn.shape)
            text = (
                f"the fixed boundary {patch.name!r} is torn where it touches moving nodes: they leave their neighbours "
                f"by up to {apart[worst]:.3g} where its faces are {edge[worst]:.3g} long, near {vector(x[worst])}; let "
                f'the motion vanish there (`meshdeform init` proposes one that does), or give it kind = "slip"'
            )
            notices.append(Notice(text, f"fixed boundary {patch.name} torn"))
    return notices


def _cells_of(known: np.ndarray) -> IntArray:
    """Cells (c, 3) of a block (ni, nj, nk) with only known nodes; a 2-D block counts as one layer of cells."""
    for axis in range(3):
        if known.shape[axis] > 1:
            low, high = (np.take(known, range(n, known.shape[axis] - 1 + n), axis=axis) for n in (0, 1))
            known = low & high
    return np.argwhere(known)


def _corners(grid: Grid, block: int, cells: IntArray) -> IntArray:
    """Flat indices (c, 2, 2, 2) of the corners; (c, 2, 2) in 2-D."""
    shape = grid.shapes[block]
    steps = np.array([(0,) if n == 1 else (0, 1) for n in shape], dtype=object)
    offsets = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).astype(np.int64)
    at = cells.reshape(-1, 1, 1, 1, 3) + offsets
    flat = grid.offsets[block] + (at[..., 0] * shape[1] + at[..., 1]) * shape[2] + at[..., 2]
    return np.asarray(flat.squeeze(axis=tuple(1 + n for n in range(3) if shape[n] == 1)))


def _inverted(before: FloatArray, after: FloatArray, normal: FloatArray | None) -> BoolArray:
    """Which cells (c, 2, 2, 2, 3) have a corner whose Jacobian changes sign."""
    old, size = _jacobians(before, normal)
    new, _ = _jacobians(after, normal)
    sound = np.abs(old) > _COLLAPSED * size
    return np.asarray((sound & (new * np.sign(old) <= 0.0)).any(axis=tuple(range(1, old.ndim))))


def _jacobians(x: FloatArray, normal: FloatArray | None) -> tuple[FloatArray, FloatArray]:
    """Corner Jacobians of cells, and the products of the lengths of their edges."""
    edges = [np.repeat(np.diff(x, axis=axis), 2, axis=axis) for axis in range(1, x.ndim - 1)]
    if normal is not None:
        edges.append(np.broadcast_to(normal, x.shape))
    value = np.einsum("...i,...i->...", edges[0], np.cross(edges[1], edges[2]))
    size = np.prod([np.linalg.norm(edge, axis=-1) for edge in edges], axis=0)
    return np.asarray(value), np.asarray(size)
