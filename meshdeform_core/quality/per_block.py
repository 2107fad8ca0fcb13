"""Quality of every block, from the tallies made for the whole grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..grid import Grid
from .measures.cells import slabs
from .measures.tally import Tally
from .verdict.comparison import Comparison
from .verdict.original import Original


@dataclass(frozen=True)
class BlockSkew:
    """Smallest and mean f_skew and smallest scaled Jacobian of one block."""

    f_skew_min: float
    f_skew_mean: float
    min_scaled_jacobian: float


@dataclass(frozen=True)
class BlockQuality:
    """One block before and after; ``cells`` and ``invalid_cells`` are counts."""

    name: str
    cells: int
    invalid_cells: int
    before: BlockSkew
    after: BlockSkew


def per_block(original: Original, cells: Comparison) -> tuple[BlockQuality, ...]:
    """The blocks of the grid in its order."""
    grid = original.grid
    counts = np.diff(grid.cell_offsets).tolist()
    invalid = np.diff(np.searchsorted(cells.verdict.invalid, grid.cell_offsets)).tolist()
    rows = zip(grid.names, counts, invalid, _skews(grid, original.tally), _skews(grid, cells.after), strict=True)
    return tuple(BlockQuality(*row) for row in rows)


def _skews(grid: Grid, tally: Tally) -> list[BlockSkew]:
    """The rows of a tally, one per slab, combined by block."""
    block_of = np.array([slab.block for slab in slabs(grid)])
    starts = np.searchsorted(block_of, np.arange(grid.n_blocks))
    lows = np.minimum.reduceat(tally.lows, starts, axis=0)
    means = np.add.reduceat(tally.sums[:, 1], starts) / np.diff(grid.cell_offsets)
    return [BlockSkew(float(low), float(mean), float(scaled)) for (low, scaled), mean in zip(lows, means, strict=True)]
