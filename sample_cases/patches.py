"""Named patches for generated grids, by the position of their faces."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from meshdeform_core.grid import BoolArray, FloatArray, Grid, Patch, Side, Window
from meshdeform_core.grid.connectivity.interfaces import find_interfaces
from meshdeform_core.grid.topology import find_topology, side_nodes
from meshdeform_core.grid.windows import windows_of_quads

Rule = tuple[str, str, Callable[[FloatArray, Side], BoolArray]]
"""Patch name, CGNS boundary condition type, and a function of face centres (n, 3) and side that selects the faces."""


def with_patches(grid: Grid, rules: list[Rule]) -> Grid:
    """``grid`` with its interfaces declared and its external faces named by the first rule that applies."""
    topology = find_topology(grid)
    windows: dict[str, list[Window]] = {name: [] for name, _, _ in rules}
    for block in range(grid.n_blocks):
        for side in Side:
            quads = topology.quads.of_side(block, side)
            if quads.start == quads.stop:
                continue
            counts = tuple(topology.quads.counts[block, side])
            left = topology.external[quads].reshape(counts)
            centers = _centers(grid.points[side_nodes(grid, block, side)])
            for name, _, holds in rules:
                chosen = left & holds(centers.reshape(-1, 3), side).reshape(counts)
                windows[name] += windows_of_quads(grid.shapes[block], block, side, chosen)
                left = left & ~chosen
    patches = tuple(Patch(name, tuple(windows[name]), name, bc) for name, bc, _ in rules if windows[name])
    return dataclasses.replace(grid, patches=patches, connections=find_interfaces(grid, topology))


def _centers(x: FloatArray) -> FloatArray:
    for axis in (0, 1):
        if x.shape[axis] > 1:
            x = 0.5 * (np.take(x, range(x.shape[axis] - 1), axis) + np.take(x, range(1, x.shape[axis]), axis))
    return x
