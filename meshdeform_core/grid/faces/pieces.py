"""Pieces of block faces, with the position, size and first-cell heights of each.

A piece is a rectangle of face quads of one kind on one block side: part of a patch, part of an interface, or an
unnamed outside face. :mod:`meshdeform_core.grid.faces.roles` guesses the role of each.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ...numerics.arrays import batches, medians, spans, spread
from ...numerics.geometry.vectors import doubled_areas, unit
from ...parallel import empty
from ..blocks import FloatArray, Grid, IntArray
from ..parts import Patch, Window
from ..planes import Plane, plane_normal, planes_of
from ..topology import FaceQuads, Topology, quads_of_patches
from ..windows import Rectangles, rectangles

_SAMPLED_LINES = 12
_TOGETHER = 100_000
"""Nodes of pieces processed at a time, which bounds the memory."""
_QUADS = 1 << 14
"""Quads processed at a time: half a kilobyte of intermediate values for each."""


@dataclass(frozen=True)
class QuadGeometry:
    """Geometry of all face quads (in 2-D of the cell edges on block edges).

    Attributes
    ----------
    area : (n_quads,) area (length unit squared; in 2-D length)
    height : (n_quads,) distance of the next layer of nodes along the inward normal
    outside : (n,) the quads that no other block shares, ascending; in many blocks these are few
    centers, outwards : (n, 3) mean of the corners, and area vector out of the block, of each of them
    """

    area: FloatArray
    height: FloatArray
    outside: IntArray
    centers: FloatArray
    outwards: FloatArray

    def center(self, quads: IntArray) -> FloatArray:
        """Mean of the corners (n, 3) of outside quads (n,)."""
        return np.asarray(self.centers[np.searchsorted(self.outside, quads)])

    def outward(self, quads: IntArray) -> FloatArray:
        """Area vectors (n, 3) of outside quads (n,)."""
        return np.asarray(self.outwards[np.searchsorted(self.outside, quads)])


@dataclass(frozen=True)
class Face:
    """A piece of one block side.

    Attributes
    ----------
    window : its nodes
    quads : (n,) its face quads
    patch : the patch that it belongs to, if any
    outside : whether no other block shares it
    box : (2, 3) lowest and highest coordinates
    area : in 2-D the length
    first_height, median_height : smallest and median height of the first cells (grid length unit)
    stretching : ratio of mean to first spacing of the grid lines that begin here: large at walls, small at far fields
    finest : ratio of smallest to first spacing of these lines: 1 where the first cell is the smallest
    plane : the plane (in 2-D the line) that contains it, ``None`` if it is curved
    """

    window: Window
    quads: IntArray = field(repr=False)
    patch: Patch | None
    outside: bool
    box: FloatArray
    area: float
    first_height: float
    median_height: float
    stretching: float
    finest: float
    plane: Plane | None

    def label(self, grid: Grid) -> str:
        """See :meth:`.Grid.window_label`."""
        return grid.window_label(self.window)


def quad_geometry(grid: Grid, topology: Topology) -> QuadGeometry:
    """Centres, area vectors and first-cell heights of all face quads."""
    count, outside = len(topology.partner), np.flatnonzero(topology.partner < 0)
    found = QuadGeometry(empty((count,)), empty((count,)), outside, *(empty((len(outside), 3)) for _ in range(2)))
    normal = plane_normal(grid)
    if normal is not None:
        normal = normal * np.sign(normal[int(np.argmax(np.abs(normal)))])
    for lo in range(0, count, _QUADS):
        some = slice(lo, min(lo + _QUADS, count))
        corners = grid.points[topology.first[topology.quads.corners[some]]]
        outward = _outward(corners, normal)
        arm = _mean_first_edges(grid, topology.quads, np.arange(some.start, some.stop))
        found.area[some] = np.linalg.norm(outward, axis=1)
        found.height[some] = -np.einsum("ni,ni->n", unit(outward), arm)
        few = slice(*np.searchsorted(outside, [some.start, some.stop]).tolist())
        own = outside[few] - lo
        found.centers[few], found.outwards[few] = corners[own].mean(axis=1), outward[own]
    return found


def _outward(corners: FloatArray, normal: FloatArray | None) -> FloatArray:
    """Area vectors (n, 3) of quads with ``corners`` (n, 4, 3), or of edges (n, 2, 3) in a plane with a ``normal``."""
    if normal is None:
        return 0.5 * doubled_areas(corners)
    # The outside lies to the right of the corner order, looking against the plane's positive normal.
    return np.cross(corners[:, 1] - corners[:, 0], normal)


def _mean_first_edges(grid: Grid, faces: FaceQuads, quads: IntArray) -> FloatArray:
    """Mean over the corners of face quads (n,) of the first edges into the block (n, 3)."""
    side, u, v = faces.places(quads)
    du, dv = grid.sides.corner_steps[side].T
    inward = grid.sides.inward[side]
    ends = []
    for more in (0 * dv, dv):
        corners = (grid.sides.at(side, at, v + more) for at in (u, u + du))
        low, high = (grid.points[nodes + inward] - grid.points[nodes] for nodes in corners)
        ends.append(0.5 * (low + high))
    return np.asarray(0.5 * (ends[0] + ends[1]))


def find_faces(grid: Grid, topology: Topology, geometry: QuadGeometry | None = None) -> list[Face]:
    """All block sides divided into pieces: patches, interfaces and unnamed outside faces; without collapsed quads."""
    geometry = geometry or quad_geometry(grid, topology)
    pieces = _pieces(grid, topology)
    if len(pieces) == 0:
        return []
    owner, shared = np.divmod(pieces.label, 2)
    run = np.repeat(np.arange(len(pieces)), np.diff(pieces.start))
    height, area = geometry.height[pieces.quads], geometry.area[pieces.quads]
    bounds = list(zip(pieces.start[:-1].tolist(), pieces.start[1:].tolist(), strict=True))
    rows = zip(
        pieces.windows(),
        [pieces.quads[lo:hi] for lo, hi in bounds],
        [grid.patches[number - 1] if number else None for number in owner.tolist()],
        (shared == 0).tolist(),
        _boxes(grid, topology.quads, pieces),
        [float(area[lo:hi].sum()) for lo, hi in bounds],
        np.minimum.reduceat(height, pieces.start[:-1]).tolist(),
        medians(height, run, len(pieces), np.nan).tolist(),
        *(ratio.tolist() for ratio in _spacing(grid, pieces)),
        _planes(grid, pieces),
        strict=True,
    )
    return [Face(*row) for row in rows]


def _pieces(grid: Grid, topology: Topology) -> Rectangles:
    """The pieces; their label is twice the number of the patch (from 1), plus one where blocks share the quads."""
    label = np.zeros(len(topology.partner), dtype=np.int64)
    quads, patch = quads_of_patches(topology.quads, grid.patches)
    label[quads] = 2 * (patch + 1)
    shared = topology.partner >= 0
    label[shared] += 1
    label[~(shared | topology.external)] = -1
    return rectangles(grid, topology.quads, label)


def _boxes(grid: Grid, faces: FaceQuads, pieces: Rectangles) -> FloatArray:
    """Lowest and highest coordinates (n, 2, 3) of the nodes of every piece."""
    found = np.empty((len(pieces), 2, 3))
    for lo, hi in batches(np.diff(pieces.start), _TOGETHER):
        start = pieces.start[lo : hi + 1]
        side, u, v = faces.places(pieces.quads[start[0] : start[-1]])
        du, dv = grid.sides.corner_steps[side].T
        corners = [(u, v), (u + du, v), (u, v + dv), (u + du, v + dv)]
        for which, extreme in enumerate((np.minimum, np.maximum)):
            whole = grid.points[grid.sides.at(side, *corners[0])]
            for corner in corners[1:]:
                extreme(whole, grid.points[grid.sides.at(side, *corner)], out=whole)
            found[lo:hi, which] = extreme.reduceat(whole, start[:-1] - start[0], axis=0)
    return found


def _spacing(grid: Grid, pieces: Rectangles) -> tuple[FloatArray, FloatArray]:
    """Ratios of mean and smallest to first spacing: medians over some of the grid lines that begin in each piece."""
    sizes = pieces.high - pieces.low + 1
    picks = [spread(sizes[:, axis], _SAMPLED_LINES, pieces.low[:, axis])[1] for axis in (0, 1)]
    taken = np.minimum(sizes, _SAMPLED_LINES)
    first = np.cumsum(taken, axis=0) - taken
    run, place = spans(taken.prod(axis=1))
    a, b = np.divmod(place, taken[run, 1])
    side = pieces.side[run]
    start = grid.sides.at(side, picks[0][first[run, 0] + a], picks[1][first[run, 1] + b])
    mean, least = np.full(len(run), np.nan), np.full(len(run), np.nan)
    for depth in np.unique(grid.sides.depth[side]).tolist():
        alike = np.flatnonzero(grid.sides.depth[side] == depth)
        for lo, hi in batches(np.full(len(alike), depth), _TOGETHER):
            some = alike[lo:hi]
            lines = grid.points[start[some] + np.arange(depth)[:, None] * grid.sides.inward[side[some]]]
            spacing = np.linalg.norm(np.diff(lines, axis=0), axis=-1)
            sound = spacing[0] > 0
            spacing, some = spacing[:, sound], some[sound]
            mean[some], least[some] = spacing.mean(axis=0) / spacing[0], spacing.min(axis=0) / spacing[0]
    sound = ~np.isnan(mean)
    found = (medians(ratio[sound], run[sound], len(pieces), 1.0) for ratio in (mean, least))
    return next(found), next(found)


def _planes(grid: Grid, pieces: Rectangles) -> list[Plane | None]:
    """The plane (in 2-D the line) that contains each piece, if there is one."""
    flat, sizes = plane_normal(grid), pieces.high - pieces.low + 1
    numbers = sizes.prod(axis=1)
    planes: list[Plane | None] = [None] * len(pieces)
    for count in np.unique(numbers).tolist():
        alike = np.flatnonzero(numbers == count)
        for lo, hi in batches(np.full(len(alike), count), _TOGETHER):
            some = alike[lo:hi, None]
            a, b = np.divmod(np.arange(count), sizes[some, 1])
            nodes = grid.sides.at(pieces.side[some], pieces.low[some, 0] + a, pieces.low[some, 1] + b)
            for number, plane in zip(alike[lo:hi].tolist(), planes_of(grid.points[nodes], flat), strict=True):
                planes[number] = plane
    return planes
