"""Distances between the nodes of two grids."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import GridError
from ..grid import Grid
from ..parallel import Nodes, empty
from ..wording import counted


@dataclass(frozen=True)
class BlockDifference:
    """Largest and root mean square distance of corresponding nodes of one block (grid length unit)."""

    name: str
    largest: float
    rms: float


@dataclass(frozen=True)
class Difference:
    """Distance of corresponding nodes of two grids (grid length unit).

    ``where`` is the node with the largest distance: block and 1-based i, j, k.
    """

    largest: float
    rms: float
    where: str
    differing_nodes: int
    nodes: int
    blocks: tuple[BlockDifference, ...]


def compare_points(a: Grid, b: Grid) -> Difference:
    """Compare the coordinates of two grids with the same blocks."""
    require_same_blocks(a, b)
    distance = empty([a.n_nodes])

    def fill(rows: slice) -> None:
        distance[rows] = np.linalg.norm(a.points[rows] - b.points[rows], axis=1)

    Nodes.of(distance).each(fill)
    worst, differing = int(np.argmax(distance)), int(np.count_nonzero(distance))
    largest = float(distance[worst])
    parts = [distance[a.offsets[n] : a.offsets[n + 1]] for n in range(a.n_blocks)]
    most = [float(part.max()) for part in parts]
    np.square(distance, out=distance)
    *means, mean = (float(np.sqrt(np.mean(part))) for part in (*parts, distance))
    blocks = tuple(BlockDifference(*each) for each in zip(a.names, most, means, strict=True))
    return Difference(largest, mean, a.node_label(worst), differing, a.n_nodes, blocks)


def require_same_blocks(a: Grid, b: Grid) -> None:
    """Refuse two grids whose nodes do not correspond, naming the first block that differs."""
    first, second = (str(grid.path or name) for grid, name in ((a, "the first grid"), (b, "the second grid")))
    if a.n_blocks != b.n_blocks:
        difference = f"{first} has {counted(a.n_blocks, 'block')}, {second} has {b.n_blocks}"
    elif a.shapes != b.shapes:
        n = next(n for n, shapes in enumerate(zip(a.shapes, b.shapes, strict=True)) if shapes[0] != shapes[1])
        one, two = (" x ".join(map(str, grid.shapes[n])) for grid in (a, b))
        difference = f"{a.names[n]} of {first} has {one} nodes, block {n + 1} of {second} has {two}"
    else:
        return
    raise GridError(f"{difference}; expected the same blocks in the same order")
