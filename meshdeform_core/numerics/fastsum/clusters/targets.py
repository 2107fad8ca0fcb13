"""Target nodes of fast weighted sums in bricks, and where the accuracy of each brick is judged."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ...arrays import FloatArray, IntArray, Shapes
from .bricks import Bricks, Regions, build_bricks, make_regions, node_sizes

_SAMPLES = 9


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


def shape_table(
    shapes: Shapes,
) -> IntArray:
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
    shapes, capacity = shape_table(shapes), per_point * order**3
    return Targets(points, *_sorted(points, shapes, offsets, flat, order, capacity))


def _sorted(
    points: FloatArray, shapes: IntArray, offsets: IntArray, flat: IntArray, order: int, capacity: int
) -> tuple[Bricks, Regions, IntArray, FloatArray]:
    """All fields of :class:`Targets` except ``points``."""
    bricks, first = build_bricks(points, shapes, offsets, flat, order, capacity)
    samples = bricks.targets[sample_places(bricks.start)]
    return bricks, make_regions(points, bricks, first, order), samples, _edges(points, shapes, offsets, samples)


def _edges(points: FloatArray, shapes: IntArray, offsets: IntArray, samples: IntArray) -> FloatArray:
    """Length (b, 9) of the shortest edge at the ``samples`` (b, 9)."""
    return node_sizes(points, shapes, offsets, samples.ravel()).reshape(samples.shape)


def sample_places(start: IntArray) -> IntArray:
    """Nine positions (b, 9) in the list of targets, spread over each of the bricks that begin at ``start`` (b + 1,)."""
    count = np.diff(start)
    return start[:-1, None] + (np.arange(_SAMPLES) * (count[:, None] - 1)) // (_SAMPLES - 1)
