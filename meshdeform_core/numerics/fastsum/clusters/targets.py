"""Target nodes of fast weighted sums in bricks and regions of these, built once per undeformed grid, and where the
accuracy of each brick is judged; :mod:`.tree` does the same for sources."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ....parallel import Nodes
from ...arrays import FloatArray, IntArray, Shapes
from ..tuned import REGION
from .boxes import Boxes, extents, fit_boxes, make_boxes
from .target_tree import halve

_SAMPLES = 9


class Bricks(NamedTuple):
    """Target nodes in compact groups that follow the grid's own order.

    Attributes
    ----------
    start : (b + 1,) start of each brick in ``targets``
    targets : (n,) flat node indices
    boxes : around the targets of each brick
    """

    start: np.ndarray
    targets: np.ndarray
    boxes: Boxes


class Regions(NamedTuple):
    """Groups of neighbouring bricks for which the same clusters of sources are far.

    Attributes
    ----------
    first : (g + 1,) number of each region's first brick
    boxes : around the targets and the interpolation points of the bricks of each region
    """

    first: np.ndarray
    boxes: Boxes


def build_bricks(
    points: FloatArray, shapes: IntArray, offsets: IntArray, flat: IntArray, order: int, capacity: int
) -> tuple[Bricks, IntArray]:
    """Bricks of at most about ``capacity`` of the nodes ``flat``, leaves of the trees that :func:`.target_tree.halve`
    makes, and the number (g + 1,) of the first brick of each region of about ``REGION`` bricks."""
    halves = halve(points, shapes, offsets, flat, capacity, REGION)
    start = np.append(halves.span[halves.leaves, 0], len(halves.targets))
    first = np.searchsorted(start, halves.span[halves.region[:-1], 0])
    # Regions without targets have no bricks.
    first = np.append(first, len(start) - 1)[np.append(np.diff(np.append(first, len(start) - 1)) > 0, True)]
    boxes = make_boxes(*fit_boxes(points, halves.targets, spans(start)), order)
    return Bricks(start, halves.targets, boxes), first


def make_regions(points: FloatArray, bricks: Bricks, first: IntArray, order: int) -> Regions:
    """Regions that begin with the bricks ``first`` (g + 1,)."""
    inner = bricks.boxes
    center, axes, half = fit_boxes(inner.proxies, np.arange(len(inner.proxies)), spans(inner.proxy[first]))
    # The boxes enclose the targets too.
    low, high = extents(points, bricks.targets, spans(bricks.start[first]), center, axes)
    return Regions(first, make_boxes(center, axes, np.maximum(half, np.maximum(-low, high)), order))


def spans(start: IntArray) -> IntArray:
    """Rows (m, 2) of the first and one past the last index of groups that begin at ``start`` (m + 1,)."""
    return np.stack([start[:-1], start[1:]], axis=1)


def node_sizes(points: FloatArray, shapes: IntArray, offsets: IntArray, flat: IntArray) -> FloatArray:
    """Length (n,) of the shortest edge at the nodes ``flat`` of a grid; edges of zero length, at poles, are ignored."""
    block = np.searchsorted(offsets, flat, side="right") - 1
    rest, shape = flat - offsets[block], shapes[block]
    nodes, size = Nodes.of(points), np.full(len(flat), np.inf)
    for axis, step in enumerate((shape[:, 1] * shape[:, 2], shape[:, 2], np.ones_like(rest))):
        at = rest // step % shape[:, axis]
        for way in (-1, 1):
            inside = (at + way >= 0) & (at + way < shape[:, axis])
            one = flat[inside]
            edge = np.linalg.norm(nodes.at(one + way * step[inside]) - nodes.at(one), axis=1)
            size[inside] = np.minimum(size[inside], np.where(edge > 0.0, edge, np.inf))
    return size


class Rows(NamedTuple):
    """Positions of samples (b, 9) and of all targets (n,) in a list of targets."""

    samples: np.ndarray
    every: np.ndarray


class Targets(NamedTuple):
    """Target nodes in bricks, and where the accuracy of each brick is judged.

    Attributes
    ----------
    points : (n_nodes, 3)
    bricks, regions : :class:`.bricks.Bricks` and :class:`.bricks.Regions`
    samples : (b, 9) targets spread over each brick, in the grid's order
    sizes : (b, 9) length of the shortest edge at each sample
    """

    points: np.ndarray
    bricks: Bricks
    regions: Regions
    samples: np.ndarray
    sizes: np.ndarray

    @property
    def every(self) -> IntArray:
        """Flat indices of all targets."""
        return self.bricks.targets

    @property
    def n_regions(self) -> int:
        return len(self.regions.first) - 1

    def places(self, first: int, last: int) -> slice:
        """Slice of the list of targets that lies in the regions first <= g < last."""
        start, stop = self.bricks.start[self.regions.first[[first, last]]]
        return slice(start, stop)

    def flat(self, first: int, last: int) -> IntArray:
        """Flat indices of the targets in the regions first <= g < last."""
        return self.bricks.targets[self.places(first, last)]

    @property
    def numbered(self) -> Rows:
        """The samples and all targets as positions in the list of targets."""
        return Rows(sample_places(self.bricks.start), np.arange(len(self.every)))

    def numbers(self, first: int, last: int) -> range:
        """Numbers of the bricks in the regions first <= g < last."""
        return range(self.regions.first[first], self.regions.first[last])


def interpolation_order(tolerance: float) -> int:
    """Interpolation points per side of a cube for a relative tolerance: 4 for 1e-2, 5 for 1e-4, 7 for 1e-8."""
    return 3 + math.ceil(-0.5 * math.log10(tolerance) - 1e-9)


def shape_table(shapes: Shapes) -> IntArray:
    """Block shapes (n_blocks, 3) as the int64 array that the loops expect."""
    return np.asarray(shapes, dtype=np.int64).reshape(-1, 3)


def make_targets(
    points: FloatArray,
    shapes: Shapes,
    offsets: IntArray,
    flat: IntArray,
    order: int,
    per_point: int = 8,
) -> Targets:
    """Targets ``flat``, ascending, in bricks that hold about ``per_point`` targets per interpolation point."""
    shapes = shape_table(shapes)
    bricks, first = build_bricks(points, shapes, offsets, flat, order, per_point * order**3)
    samples = bricks.targets[sample_places(bricks.start)]
    sizes = node_sizes(points, shapes, offsets, samples.ravel()).reshape(samples.shape)
    return Targets(points, bricks, make_regions(points, bricks, first, order), samples, sizes)


def sample_places(start: IntArray) -> IntArray:
    """Nine positions (b, 9) in the list of targets, spread over each of the bricks that begin at ``start`` (b + 1,)."""
    count = np.diff(start)
    return start[:-1, None] + (np.arange(_SAMPLES) * (count[:, None] - 1)) // (_SAMPLES - 1)
