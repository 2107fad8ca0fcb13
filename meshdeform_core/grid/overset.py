"""Outside faces that lie inside another block: overset grids, and blocks that overlap by mistake.

A solver for overset grids interpolates at such a face. Here it would be a fixed wall in the middle of the other block,
and what moves would pull the two apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..numerics.arrays import extent
from ..numerics.geometry.distance import distance_to_faces
from ..numerics.geometry.solid_angle import plane_winding, winding
from .blocks import FloatArray, Grid, IntArray, Side, Window
from .planes import plane_normal
from .topology import Topology, side_nodes
from .windows import windows_of_quads

_SAMPLES = 24
_FEWEST = 2
_PART = 0.1
"""Of the samples of a face that lie inside."""
_DEEP = 0.1
"""A face is inside when its middle is farther from the other block's surface than this part of its longest edge."""
_COARSE = 12
"""Cells per direction of the surface by which most blocks are ruled out."""
_SOME, _SURE = 0.1, 0.9


@dataclass(frozen=True)
class Overlap:
    """Outside faces of one block side that lie inside another block.

    Attributes
    ----------
    quads : (n,) face quads of the side that are outside
    window : their nodes
    block, side, other : which side lies in which block
    share : part of the sampled quads that does
    depth : the farthest of these from the surface of the other block (grid length unit)
    """

    quads: IntArray
    window: Window
    block: int
    side: Side
    other: int
    share: float
    depth: float
    matching: bool = False

    def describe(self, grid: Grid) -> str:
        """One line: where, how much of it, how deep."""
        ranges = ",".join(f"{a + 1}:{b + 1}" for a, b in zip(self.window.low, self.window.high, strict=True))
        return (
            f"{grid.names[self.block]}.{self.side.label}[{ranges}] ({len(self.quads)} quads) lies inside "
            f"{grid.names[self.other]}, {self.share:.0%} of it up to {self.depth:.3g} deep (overset or overlapping "
            f"blocks)"
        )


def find_overlaps(grid: Grid, topology: Topology) -> list[Overlap]:
    """Outside faces inside other blocks, found from samples of the quads of each block side."""
    quads = topology.quads
    boxes = [extent(grid.block(b)) for b in range(grid.n_blocks)]
    surfaces: dict[int, _Surface] = {}
    found = []
    for own in np.unique(quads.block_side[topology.external]):
        block, side = int(own) // 6, Side(int(own) % 6)
        span = quads.of_side(block, side)
        outside = topology.external[span]
        chosen = np.flatnonzero(outside) + span.start
        sample = chosen[np.unique(np.linspace(0, len(chosen) - 1, min(len(chosen), _SAMPLES)).astype(int))]
        corners = grid.points[topology.first[quads.corners[sample]]]
        middle = corners.mean(axis=1)
        for other, (low, high) in enumerate(boxes):
            within = ((middle > low) & (middle < high) | (low == high)).all(axis=1) & (other != block)
            if within.sum() < max(_FEWEST, _PART * len(sample)):
                continue
            if other not in surfaces:
                surfaces[other] = _Surface(grid, other)
            depth = surfaces[other].depth(corners[within], middle[within])
            if (depth > 0).sum() >= max(_FEWEST, _PART * len(sample)):
                window, part = _largest(grid, topology, block, side, outside)
                share = float((depth > 0).sum() / len(sample))
                found.append(Overlap(part, window, block, side, other, share, float(depth.max())))
    return found


def _largest(grid: Grid, topology: Topology, block: int, side: Side, mine: np.ndarray) -> tuple[Window, IntArray]:
    """The largest rectangle of marked quads of a side, and their numbers."""
    counts = tuple(int(n) for n in topology.quads.counts[block, side])
    windows = windows_of_quads(grid.shapes[block], block, side, mine.reshape(counts))
    sizes = [np.prod([max(d - a, 1) for a, d in zip(w.low, w.high, strict=True)]) for w in windows]
    window = windows[int(np.argmax(sizes))]
    inside = np.zeros(counts, dtype=bool)
    (a, b), (c, d) = window.low, window.high
    inside[a : max(c, a + 1), b : max(d, b + 1)] = True
    return window, np.flatnonzero(inside.ravel() & mine) + topology.quads.start[block, side]


class _Surface:
    """The closed surface of a block, coarse for a first look and as it is."""

    def __init__(self, grid: Grid, block: int):
        self._grid, self._block = grid, block
        self._normal = plane_normal(grid)
        # Of the two axes beside the first one, the sides of this one are wound the other way round; see _turned.
        shape = grid.shapes[block]
        self._second = 1 if self._normal is None else max(axis for axis in range(3) if shape[axis] > 1)
        self._coarse = self._faces(_COARSE)
        self._fine: FloatArray | None = None

    def depth(self, corners: FloatArray, middle: FloatArray) -> FloatArray:
        """How deep (k,) the middles of quads lie inside the block; 0 outside and close to its surface."""
        depth = np.zeros(len(middle))
        some = np.flatnonzero(self._winding(self._coarse, middle) > _SOME)
        if some.size == 0:
            return depth
        if self._fine is None:
            self._fine = self._faces(None)
        sure = some[self._winding(self._fine, middle[some]) > _SURE]
        if sure.size:
            distance = distance_to_faces(middle[sure], self._fine)
            longest = np.linalg.norm(corners[sure] - np.roll(corners[sure], 1, axis=1), axis=2).max(axis=1)
            depth[sure] = np.where(distance > _DEEP * longest, distance, 0.0)
        return depth

    def _winding(self, faces: FloatArray, places: FloatArray) -> FloatArray:
        if self._normal is not None:
            return np.abs(plane_winding(faces[:, 0], faces[:, 1], self._normal, places))
        points = faces.reshape(-1, 3)
        at = np.arange(0, len(points), 4)[:, None]
        return np.abs(winding(points, np.concatenate([at + [0, 1, 2], at + [2, 3, 0]]), places))

    def _faces(self, cells: int | None) -> FloatArray:
        """Corners (m, 4, 3) of the faces, in 2-D (m, 2, 3); all sides turned alike. At most ``cells`` per direction."""
        grid, found = self._grid, []
        for side in Side:
            if grid.shapes[self._block][side.axis] == 1:
                continue
            nodes = side_nodes(grid, self._block, side)
            for axis in (0, 1):
                n = nodes.shape[axis]
                if cells is not None and n > cells + 1:
                    nodes = np.take(nodes, np.unique(np.linspace(0, n - 1, cells + 1).round().astype(int)), axis=axis)
            found.append(_turned(grid.points[nodes], side, self._second))
        return np.concatenate(found)


def _turned(x: FloatArray, side: Side, second: int) -> FloatArray:
    """Corners of the quads of a side (na, nb, 3) in an order that shows outwards on all sides, or inwards on all.

    The tangential axes ascend: (j, k), (i, k), (i, j); the second pair is not cyclic. In 2-D the sides of the first
    axis and those of the second are wound differently.
    """
    if 1 in x.shape[:2]:
        line = x.reshape(-1, 3)
        faces = np.stack([line[:-1], line[1:]], axis=1)
    else:
        faces = np.stack([x[:-1, :-1], x[1:, :-1], x[1:, 1:], x[:-1, 1:]], axis=2).reshape(-1, 4, 3)
    reverse = (side % 2 == 0) != (side.axis == second)
    return faces[:, ::-1] if reverse else faces
