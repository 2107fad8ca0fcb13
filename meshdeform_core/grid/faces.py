"""The block faces in pieces: position, size and first cell heights of each.

A piece is a rectangle of face quads of one kind on one block side: part of a patch, part of an interface, or an
unnamed outside face. :mod:`meshdeform_core.grid.roles` guesses the role of each.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from .blocks import FloatArray, Grid, IntArray, Patch, Side, Window
from .planes import Plane, plane_normal, plane_of
from .selection import quads_of_patch, quads_of_window
from .topology import Topology, inward_step, side_nodes
from .windows import windows_of_quads

_SAMPLED_LINES = 12


@dataclass(frozen=True)
class QuadGeometry:
    """Geometry of all face quads (in 2-D of the cell edges on block edges).

    Attributes
    ----------
    center : (n_quads, 3) mean of the corners
    outward : (n_quads, 3) area vector out of the block (area: length unit squared; in 2-D length)
    height : (n_quads,) distance of the next layer of nodes along the inward normal
    """

    center: FloatArray
    outward: FloatArray
    height: FloatArray

    @cached_property
    def area(self) -> FloatArray:
        """(n_quads,) area, in 2-D length."""
        return np.asarray(np.linalg.norm(self.outward, axis=1))


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
        """``block1.jmin``, with a window of nodes (1-based) if the piece is not the whole side."""
        side = self.window.side
        a, b = side.tangential
        shape = grid.shapes[self.window.block]
        name = f"{grid.names[self.window.block]}.{side.label}"
        whole = self.window.low == (0, 0) and self.window.high == (shape[a] - 1, shape[b] - 1)
        return name if whole else f"{name}[{self.range_text}]"

    @property
    def range_text(self) -> str:
        """Window as in a case file, 1-based and inclusive: ``1:65,1:33``."""
        return ",".join(f"{a + 1}:{b + 1}" for a, b in zip(self.window.low, self.window.high, strict=True))


def quad_geometry(grid: Grid, topology: Topology) -> QuadGeometry:
    """Centres, area vectors and first-cell heights of all face quads."""
    corners = grid.points[topology.first[topology.quads.corners]]
    if grid.dimension == 2:
        normal = plane_normal(grid)
        assert normal is not None
        # The outside lies to the right of the corner order, looking against the plane's positive normal.
        outward = np.cross(corners[:, 1] - corners[:, 0], normal * np.sign(normal[int(np.argmax(np.abs(normal)))]))
    else:
        outward = 0.5 * np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    area = np.linalg.norm(outward, axis=1, keepdims=True)
    unit = np.divide(outward, area, out=np.zeros_like(outward), where=area > 0)
    height = np.zeros(len(outward))
    for block in range(grid.n_blocks):
        for side in Side:
            quads = topology.quads.of_side(block, side)
            if quads.start < quads.stop:
                step = inward_step(grid.shapes[block], side)
                arm = _quad_means(_first_edges(grid, side_nodes(grid, block, side), step))
                height[quads] = -np.einsum("ni,ni->n", unit[quads], arm)
    return QuadGeometry(corners.mean(axis=1), outward, height)


def _first_edges(grid: Grid, nodes: IntArray, step: int) -> FloatArray:
    return grid.points[nodes + step] - grid.points[nodes]


def _quad_means(x: FloatArray) -> FloatArray:
    """Mean over the corners of every quad of node values (na, nb, 3); (n_quads, 3)."""
    for axis in (0, 1):
        if x.shape[axis] > 1:
            low, high = (np.take(x, np.arange(x.shape[axis] - 1) + shift, axis=axis) for shift in (0, 1))
            x = 0.5 * (low + high)
    return x.reshape(-1, 3)


def find_faces(grid: Grid, topology: Topology, geometry: QuadGeometry | None = None) -> list[Face]:
    """All block sides as pieces: of patches, of interfaces, and the rest; without collapsed quads."""
    geometry = geometry or quad_geometry(grid, topology)
    flat = plane_normal(grid)
    return [
        _face(grid, topology, geometry, flat, window, patch, outside)
        for window, patch, outside in _windows(grid, topology)
    ]


def _windows(grid: Grid, topology: Topology) -> Iterator[tuple[Window, Patch | None, bool]]:
    owner = np.full(len(topology.partner), -1, dtype=np.int64)
    for number, patch in enumerate(grid.patches):
        owner[quads_of_patch(topology.quads, patch)] = number
    for block, shape in enumerate(grid.shapes):
        for side in Side:
            quads = topology.quads.of_side(block, side)
            counts = tuple(topology.quads.counts[block, side].tolist())
            outside = topology.external[quads]
            shared = topology.partner[quads] >= 0
            for number in np.unique(owner[quads]).tolist():
                name = grid.patches[number] if number >= 0 else None
                mine = owner[quads] == number
                for kind, is_outside in ((outside, True), (shared, False)):
                    for window in windows_of_quads(shape, block, side, (mine & kind).reshape(counts)):
                        yield window, name, is_outside


def _face(
    grid: Grid,
    topology: Topology,
    geometry: QuadGeometry,
    flat: FloatArray | None,
    window: Window,
    patch: Patch | None,
    outside: bool,
) -> Face:
    quads = quads_of_window(topology.quads, window)
    nodes = side_nodes(grid, window.block, window.side)[_slices(window)]
    points = grid.points[nodes.ravel()]
    height = geometry.height[quads]
    return Face(
        window,
        quads,
        patch,
        outside,
        np.stack([points.min(axis=0), points.max(axis=0)]),
        float(geometry.area[quads].sum()),
        float(height.min()),
        float(np.median(height)),
        *_spacing(grid, window),
        plane_of(points, flat),
    )


def _slices(window: Window) -> tuple[slice, slice]:
    (low_a, low_b), (high_a, high_b) = window.low, window.high
    return slice(low_a, high_a + 1), slice(low_b, high_b + 1)


def _spacing(grid: Grid, window: Window) -> tuple[float, float]:
    """Ratios of mean and smallest to first spacing; medians over a sample of the grid lines that begin in a window."""
    x = np.moveaxis(grid.block(window.block), window.side.axis, 0)
    if window.side % 2:
        x = x[::-1]
    picks = (
        np.unique(np.linspace(low, high, min(high - low + 1, _SAMPLED_LINES)).astype(int))
        for low, high in zip(window.low, window.high, strict=True)
    )
    rows, columns = np.ix_(*picks)
    lines = x[:, rows, columns]
    spacing = np.linalg.norm(np.diff(lines, axis=0), axis=-1).reshape(len(lines) - 1, -1)
    spacing = spacing[:, spacing[0] > 0]
    if spacing.size == 0:
        return 1.0, 1.0
    return float(np.median(spacing.mean(axis=0) / spacing[0])), float(np.median(spacing.min(axis=0) / spacing[0]))
