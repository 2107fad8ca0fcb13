"""What samples are made of: nodes along lines, blocks in parts, and patches by the position of faces."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq

from meshdeform_core.grid import BoolArray, FloatArray, Grid, Patch, Side, Window
from meshdeform_core.grid.connections import find_interfaces
from meshdeform_core.grid.topology import find_topology
from meshdeform_core.grid.windows import windows_of_quads

Rule = tuple[str, str, Callable[[FloatArray, Side], BoolArray]]
"""Patch name, CGNS boundary condition type, and a function of face centres (n, 3) and side that selects the faces."""


def with_patches(grid: Grid, rules: list[Rule]) -> Grid:
    """``grid`` with its interfaces declared and its external faces named by the first rule that applies."""
    topology = find_topology(grid)
    windows: dict[str, list[Window]] = {name: [] for name, _, _ in rules}
    centers = grid.points[topology.first[topology.quads.corners]].mean(axis=1)
    for block in range(grid.n_blocks):
        for side in Side:
            quads = topology.quads.of_side(block, side)
            left, counts = topology.external[quads], tuple(topology.quads.counts[block, side])
            for name, _, holds in rules if left.any() else ():
                chosen = left & holds(centers[quads], side)
                windows[name] += windows_of_quads(grid.shapes[block], block, side, chosen.reshape(counts))
                left = left & ~chosen
    patches = tuple(Patch(name, tuple(windows[name]), name, bc) for name, bc, _ in rules if windows[name])
    return dataclasses.replace(grid, patches=patches, connections=find_interfaces(grid, topology))


def even(span: tuple[float, float], size: int) -> FloatArray:
    """Nodes over ``span``, ``size`` cells per unit: whole multiples of a cell, so that neighbouring blocks agree to the
    last bit."""
    return np.arange(round(span[0] * size), round(span[1] * size) + 1) / size


def geometric(first: float, cells: int, length: float) -> FloatArray:
    """``cells`` + 1 nodes from 0 to ``length`` in geometric progression, the first cell of size ``first``."""

    def length_beyond(log_ratio: float) -> float:
        # At the far end of the bracket the sum may be infinite, which counts as too long.
        with np.errstate(over="ignore"):
            return float(first * np.exp(log_ratio * np.arange(cells)).sum() - length)

    ratio = brentq(length_beyond, -5.0, 5.0)
    nodes = np.concatenate([[0.0], np.cumsum(first * np.exp(ratio * np.arange(cells)))])
    return np.asarray(nodes * (length / nodes[-1]))


def around(x: Sequence[FloatArray], y: Sequence[FloatArray], z: ArrayLike, names: Sequence[str] | None = None) -> Grid:
    """Eight blocks around a body: nodes along x and along y in three parts each, without the block in the middle."""
    blocks = [np.stack(np.meshgrid(a, b, z, indexing="ij"), axis=-1) for a in x for b in y]
    return Grid.from_blocks(blocks[:4] + blocks[5:], names)


def columns(body: str) -> list[str]:
    """Names of the blocks around a body in a flow along x."""
    names = [f"{row}-{column}" for column in ("upstream", body, "downstream") for row in ("lower", "middle", "upper")]
    return names[:4] + names[5:]


def tanh_law(first: float, cells: int, length: float) -> FloatArray:
    """``cells`` + 1 nodes from 0 to ``length`` by the one-sided hyperbolic tangent law, first cell ``first``."""
    s = np.arange(cells + 1) / cells

    def nodes(beta: float) -> FloatArray:
        return np.asarray(length * (1.0 + np.tanh(beta * (s - 1.0)) / np.tanh(beta)))

    beta = brentq(lambda b: float(nodes(b)[1] - first), 1e-3, 50.0)
    return nodes(beta)


def split(grid: Grid, max_cells: int) -> Grid:
    """Every block split into equal parts of at most ``max_cells`` cells per direction; coordinates only."""
    blocks, names = [], []
    for b in range(grid.n_blocks):
        parts = []
        for nodes in grid.shapes[b]:
            count = -(-(nodes - 1) // max_cells)
            cuts = np.round(np.linspace(0, nodes - 1, count + 1)).astype(int).tolist()
            parts.append(list(itertools.pairwise(cuts)) or [(0, 0)])
        for number, window in enumerate(itertools.product(*parts), 1):
            blocks.append(grid.block(b)[tuple(slice(lo, hi + 1) for lo, hi in window)])
            names.append(f"{grid.names[b]}-{number}")
    return Grid.from_blocks(blocks, names)
