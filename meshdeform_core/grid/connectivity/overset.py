"""Outside faces that lie inside another block: overset grids, and blocks that overlap by mistake.

A solver for overset grids interpolates at such a face. Here it would count as a fixed boundary within the other block,
and a motion would pull the two blocks apart, unless they belong to different components.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ...numerics.arrays import BoolArray, batches, runs, spans, spread
from ...numerics.geometry.boxes import overlapping_boxes
from ...numerics.geometry.vectors import distance_to_faces, plane_winding, winding
from ...wording import counted
from ..blocks import FloatArray, Grid, IntArray
from ..extent import block_extents
from ..parts import Side, Window
from ..planes import FLATNESS, plane_normal
from ..topology import Topology, side_nodes
from ..windows import largest_rectangles

_SAMPLES = 24
_FEWEST = 2
_PART = 0.1
"""Smallest fraction of a face's samples inside another block that counts as an overlap."""
_DEEP = 0.1
"""A quad is inside if its centre is farther from the other block's surface than this fraction of its longest edge."""
_COARSE = 12
"""Cells per direction of the coarse surface that rules out most blocks."""
_SOME, _SURE = 0.1, 0.9
_TOGETHER = 300_000
"""Samples compared at a time, which bounds the memory."""


@dataclass(frozen=True)
class Overlap:
    """Outside faces of one block side that lie inside another block.

    Attributes
    ----------
    quads : (n,) face quads of the side that are outside
    window : their nodes
    block, side, other : which side lies in which block
    share : fraction of the sampled quads that lies inside
    depth : largest distance of these from the surface of the other block (grid length unit)
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
        face = f"{grid.names[self.block]}.{self.side.label}[{self.window.ranges}] ({counted(len(self.quads), 'quad')})"
        return (
            f"{face} lies inside {grid.names[self.other]}, {self.share:.0%} of it up to {self.depth:.3g} deep "
            f"(overset or overlapping blocks)"
        )


def find_overlaps(grid: Grid, topology: Topology) -> list[Overlap]:
    """Outside faces inside other blocks, found from samples of the quads of each block side."""
    outside = np.flatnonzero(topology.external)
    side = topology.quads.block_side[outside]
    first, last = runs(side)
    run, place = spread(last - first, _SAMPLES)
    corners = grid.points[topology.first[topology.quads.corners[outside[first[run] + place]]]]
    middle, start = corners.mean(axis=1), np.append(0, np.cumsum(np.bincount(run, minlength=len(first))))
    pieces: dict[int, tuple[Window, IntArray]] = {}
    surfaces: dict[int, _Surface] = {}
    normal, found = plane_normal(grid), []
    for own, other, within in _candidates(grid, middle, start, side[first] // 6):
        sample = slice(start[own], start[own + 1])
        if other not in surfaces:
            surfaces[other] = _Surface(grid, other, normal)
        depth = surfaces[other].depth(corners[sample][within], middle[sample][within])
        deep = int((depth > 0).sum())
        if deep >= _enough(len(within)):
            pieces = pieces or largest_rectangles(grid, topology.quads, outside)
            window, quads = pieces[int(side[first[own]])]
            share = float(deep / len(within))
            found.append(Overlap(quads, window, window.block, window.side, other, share, float(depth.max())))
    return found


def _enough(samples: int) -> float:
    return max(_FEWEST, _PART * samples)


def coincident_blocks(grid: Grid, topology: Topology) -> list[str]:
    """A message for each block all of whose face nodes are those of an earlier one: both lie in the same place."""
    if grid.n_blocks == 1:
        return []
    corners, first = topology.quads.corners, topology.quads.start[:, 0]
    # Equal sums and sums of squares of their unique numbers rule out nearly all other pairs.
    sums = np.zeros((2, grid.n_blocks), dtype=np.int64)
    for column in corners.T:
        sums[0] += np.add.reduceat(column, first, dtype=np.int64)
        sums[1] += np.add.reduceat(np.multiply(column, column, dtype=np.int64), first)
    _, group = np.unique(sums.T, axis=0, return_inverse=True)
    earlier: dict[int, list[int]] = {}
    pairs = []
    for block in np.flatnonzero(np.bincount(group.ravel())[group.ravel()] > 1).tolist():
        nodes = _face_numbers(topology, block)
        candidates = earlier.setdefault(int(group.ravel()[block]), [])
        pairs += [(one, block) for one in candidates if np.array_equal(_face_numbers(topology, one), nodes)][:1]
        candidates.append(block)
    return [
        f"blocks {grid.names[one]!r} and {grid.names[two]!r} lie in the same place: all their faces coincide, so that "
        f"none of them is an outside face; remove one of the blocks, or assign them to components ([grid] components)"
        for one, two in pairs
    ]


def _face_numbers(topology: Topology, block: int) -> IntArray:
    """Unique numbers of the nodes on the faces of a block, ascending."""
    first = topology.quads.start[block, 0]
    count = int(topology.quads.counts[block].prod(axis=1).sum())
    return np.unique(topology.quads.corners[first : first + count])


def _candidates(
    grid: Grid, middle: FloatArray, start: IntArray, block: IntArray
) -> Iterator[tuple[int, int, BoolArray]]:
    """Sides, blocks whose bounding box contains enough samples ``middle`` of the side, and which samples those are.

    ``start``: first sample of each side; ``block``: the block of each side.
    """
    if len(block) == 0:
        return
    low, high = block_extents(grid)
    # A 2-D grid is plane only up to the precision of its file.
    slack = FLATNESS * float((high.max(axis=0) - low.min(axis=0)).max())
    own = np.minimum.reduceat(middle, start[:-1]), np.maximum.reduceat(middle, start[:-1])
    pairs = overlapping_boxes(own, (low - slack, high + slack))
    component = grid.component_numbers
    same = component[block[pairs[:, 0]]] == component[pairs[:, 1]]
    pairs = pairs[same & (block[pairs[:, 0]] != pairs[:, 1])]
    counts = np.diff(start)[pairs[:, 0]]
    for lo, hi in batches(counts, _TOGETHER):
        some, (run, place) = pairs[lo:hi], spans(counts[lo:hi])
        x, other = middle[start[some[run, 0]] + place], some[run, 1]
        inside = ((x > low[other]) & (x < high[other]) | (low[other] == high[other])).all(axis=1)
        ends = np.append(0, np.cumsum(counts[lo:hi]))
        for number in np.flatnonzero(np.bincount(run, weights=inside) >= np.maximum(_FEWEST, _PART * counts[lo:hi])):
            yield int(some[number, 0]), int(some[number, 1]), inside[ends[number] : ends[number + 1]]


class _Surface:
    """The closed surface of a block: a coarse one for a first test, and the exact one."""

    def __init__(self, grid: Grid, block: int, normal: FloatArray | None):
        self._grid, self._block, self._normal = grid, block, normal
        # The sides of this axis are wound the other way round; see _turned.
        shape = grid.shapes[block]
        self._second = 1 if self._normal is None else max(axis for axis in range(3) if shape[axis] > 1)
        self._coarse = self._faces(_COARSE)
        self._fine: FloatArray | None = None

    def depth(self, corners: FloatArray, middle: FloatArray) -> FloatArray:
        """Depth (k,) of the centres of quads below the block's surface; 0 outside and close to it."""
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
        """Corners (m, 4, 3) of the faces, in 2-D (m, 2, 3), all wound alike; at most ``cells`` per direction."""
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
    """Corners of the quads of a side (na, nb, 3), wound so that all sides have outward normals, or all inward ones.

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
