"""Distances in cells, over block interfaces and periodic boundaries."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..grid import IntArray
from ..numerics.cell.layers import spread_layers
from ..parallel import Nodes
from .constraints import Constraints


class Reach:
    """Distances in cells between nodes of a grid; coincident nodes and periodic images count as one node."""

    def __init__(self, constraints: Constraints) -> None:
        self._grid, topology = constraints.grid, constraints.topology
        self._nodes, self._classes = topology.face_nodes, constraints.root[topology.number]
        self._ends = np.searchsorted(self._nodes, self._grid.offsets)
        self._shapes = np.array(self._grid.shapes, dtype=np.int64)

    def layers(self, seeds: IntArray, most: int) -> tuple[Any, int]:
        """Distance (n_nodes,) int16, in cells, of every block node from the block nodes ``seeds``, ``most + 1`` where
        it exceeds ``most``, in parts if the grid is; and the largest distance up to ``most``."""
        nodes = self._grid.nodes
        (low, high), found = nodes.ends, nodes.like(dtype=np.int16)
        own = Nodes.of(found).own
        own[...] = most + 1
        own[seeds[(seeds >= low) & (seeds < high)] - low] = 0
        nearest = np.full(len(self._nodes), most + 1, dtype=np.int16)
        at = np.minimum(np.searchsorted(self._nodes, seeds), len(self._nodes) - 1)
        nearest[self._classes[at[self._nodes[at] == seeds]]] = 0
        self._spread(found, nearest, most)
        largest = int(own[own <= most].max(initial=0))
        return found, max(nodes.gather(largest))

    def _spread(self, found: Any, nearest: np.ndarray, most: int) -> None:
        """Lower the distances of this rank's nodes until no rank finds any that is too large."""
        grid, nodes = self._grid, Nodes.of(found)
        own = [grid.planes(block) for block in range(grid.n_blocks)]
        planes = np.array([
            (max(each.start - 1, 0), min(each.stop + 1, ni)) if each.stop > each.start else (0, 0)
            for each, ni in zip(own, self._shapes[:, 0].tolist(), strict=True)
        ])  # fmt: skip
        again = True
        while again:
            grid.hold_neighbours(found)
            before = nearest.copy()
            lowered = self._lower(nodes.rows, nearest, most, planes)
            changed = np.flatnonzero(nearest < before)
            for numbers, values in nodes.gather((changed, nearest[changed])):
                nearest[numbers] = np.minimum(nearest[numbers], values)
            again = nodes.divided and any(nodes.gather(lowered > 0))

    def _lower(self, layers: np.ndarray, nearest: np.ndarray, most: int, planes: IntArray) -> int:
        rest = self._shapes, self._grid.offsets, self._nodes, self._ends, self._classes, nearest
        return int(spread_layers(layers, most, planes, *rest))
