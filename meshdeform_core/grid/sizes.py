"""Sizes of block-structured grids, which follow from the shapes of their blocks."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from ..numerics.arrays import IntArray
from .parts import FileFormat, Shape


def strides_of(shapes: IntArray) -> IntArray:
    """Steps in flat index along i, j, k (n, 3) in blocks of these shapes (n, 3)."""
    return np.stack([shapes[:, 1] * shapes[:, 2], shapes[:, 2], np.ones(len(shapes), dtype=np.int64)], axis=1)


class BlockSizes:
    """Numbers that follow from the shapes of blocks, ``(ni, nj, nk)`` in nodes, and from the format of their file."""

    shapes: tuple[Shape, ...]
    format: FileFormat | None

    @cached_property
    def offsets(self) -> IntArray:
        """Flat index of each block's first node; one more entry than blocks."""
        return np.concatenate([[0], np.cumsum(np.prod(self.shapes, axis=1, dtype=np.int64))]).astype(np.int64)

    @property
    def n_blocks(self) -> int:
        return len(self.shapes)

    @property
    def n_nodes(self) -> int:
        """Block nodes; coincident nodes of different blocks count once per block."""
        return int(self.offsets[-1])

    @property
    def n_face_nodes(self) -> int:
        """Nodes on block faces; coincident nodes count as in :attr:`n_nodes`."""
        inside = np.maximum(np.array(self.shapes, dtype=np.int64) - 2, 0)
        return self.n_nodes - int(inside.prod(axis=1).sum())

    @cached_property
    def cell_shapes(self) -> tuple[Shape, ...]:
        """Cells of each block along i, j, k; the single plane of a 2-D block counts as one."""
        return tuple((max(a - 1, 1), max(b - 1, 1), max(c - 1, 1)) for a, b, c in self.shapes)

    @property
    def n_cells(self) -> int:
        return int(self.cell_offsets[-1])

    @cached_property
    def cell_offsets(self) -> IntArray:
        """Number of each block's first cell; one more entry than blocks."""
        return np.concatenate([[0], np.cumsum(np.prod(self.cell_shapes, axis=1, dtype=np.int64))])

    @property
    def dimension(self) -> int:
        """2 if every block is one plane of nodes, else 3."""
        return 2 if 1 in self.shapes[0] else 3

    @property
    def precision(self) -> str:
        """Floating point type of the grid's file; float64 for grids made in memory."""
        return self.format.precision if self.format else "float64"
