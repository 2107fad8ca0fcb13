"""Splitting blocks into smaller ones."""

import itertools

import numpy as np

from meshdeform_core.grid import Grid


def split(grid: Grid, max_cells: int) -> Grid:
    """Every block split into equal parts of at most ``max_cells`` cells per direction; coordinates only."""
    blocks, names = [], []
    for b in range(grid.n_blocks):
        parts = [_cuts(n, max_cells) for n in grid.shapes[b]]
        for number, window in enumerate(itertools.product(*parts), 1):
            blocks.append(grid.block(b)[tuple(slice(lo, hi + 1) for lo, hi in window)])
            names.append(f"{grid.names[b]}-{number}")
    return Grid.from_blocks(blocks, names)


def _cuts(nodes: int, max_cells: int) -> list[tuple[int, int]]:
    if nodes == 1:
        return [(0, 0)]
    parts = -(-(nodes - 1) // max_cells)
    cuts = np.round(np.linspace(0, nodes - 1, parts + 1)).astype(int).tolist()
    return list(itertools.pairwise(cuts))
