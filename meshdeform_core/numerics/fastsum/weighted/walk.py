"""Which clusters act where: the tree of sources is traversed for every region of bricks, and then for its bricks.

A cluster far enough away for the required accuracy of its part of the sum is replaced by its interpolation points,
which act on those of the region. Nearer clusters are passed on to the bricks of the region: they act on a brick's
interpolation points or on its nodes; the nearest act on the nodes by their sources.

An entry of a list is 2 c for the interpolation points of cluster c, and 2 c + 1 for its sources. The lists are valid
for every displacement that moves no cluster further than the one they were made for.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...arrays import FloatArray, IntArray, spans
from ..clusters.acceptance import Kernel
from ..clusters.boxes import Boxes
from ..clusters.bricks import Bricks, Regions
from ..clusters.tree import SourceTree


class Reach(NamedTuple):
    """Bounds of each cluster's effect: strength * (shift + turn * distance + mean displacement of the brick).

    Attributes
    ----------
    strength : (m,) total strength of each cluster
    shift, turn : (m,) largest displacement and rotation angle (radians) of its sources; 1 and 0 for plain sums
    """

    strength: np.ndarray
    shift: np.ndarray
    turn: np.ndarray


class Lists(NamedTuple):
    """The clusters that act in some neighbouring regions.

    Attributes
    ----------
    codes : (n,) int32, all lists, with entries as above
    stop : end of each list; a region has one list for its interpolation points, followed by two for each of its bricks,
        for the brick's interpolation points and for its nodes
    """

    codes: np.ndarray
    stop: np.ndarray


def list_clusters(
    first: int,
    last: int,
    regions: Regions,
    bricks: Bricks,
    tree: SourceTree,
    reach: Reach,
    function: Kernel,
    allowed: FloatArray,
    mean: FloatArray,
    risk: FloatArray,
) -> Lists:
    """:class:`Lists` of the regions first <= g < last.

    Parameters
    ----------
    allowed : (b,) error of the sums that one cluster may cause in a brick
    mean : (b,) bound of the mean displacement in a brick
    risk : (b,), added to: the sum of the error bounds of all clusters, relative to ``allowed``
    """
    ends = regions.first[first : last + 1]
    low, high = int(ends[0]), int(ends[-1])
    sizes, start = np.diff(ends), ends[:-1] - low
    of_brick, _ = spans(sizes)
    walk = _Walk(tree, reach, function)
    least, most = np.minimum.reduceat(allowed[low:high], start), np.maximum.reduceat(mean[low:high], start)
    every, never = np.arange(first, last), np.zeros(last - first, dtype=bool)
    root = np.zeros(last - first, dtype=np.int64)
    whole = _Box(regions.boxes, every, least, most, never, region=True)
    # What the bricks of each region inherit.
    (far, codes), (left, clusters), bound = walk.of(whole, np.arange(last - first), root)
    order = np.argsort(left, kind="stable")
    left, clusters = left[order], clusters[order]
    begin, end = np.searchsorted(left, of_brick), np.searchsorted(left, of_brick, side="right")
    brick, place = spans(end - begin)
    few = few_nodes(bricks, low, high)
    parts = _Box(bricks.boxes, np.arange(low, high), allowed[low:high], mean[low:high], few, region=False)
    (on_points, some), (on_nodes, others), more = walk.of(parts, brick, clusters[begin[brick] + place])
    risk[low:high] += bound[of_brick] + more
    # The list of a region precedes the two lists of each of its bricks.
    item = np.arange(high - low) * 2 + of_brick + 1
    items = np.concatenate([(np.arange(last - first) + 2 * start)[far], item[on_points], item[on_nodes] + 1])
    entries = np.concatenate([codes, some, others])
    order = np.lexsort((entries, items))
    stop = np.cumsum(np.bincount(items, minlength=last - first + 2 * (high - low)))
    return Lists(entries[order].astype(np.int32), stop)


def few_nodes(bricks: Bricks, first: int, last: int) -> np.ndarray:
    """Whether the bricks first <= b < last have so few nodes that they need no interpolation points of their own."""
    nodes, points = np.diff(bricks.start[first : last + 1]), np.diff(bricks.boxes.proxy[first : last + 1])
    return np.asarray(nodes <= 2 * points)


class _Box(NamedTuple):
    """Regions or bricks: their numbers among ``boxes``, the error that one cluster may cause, the mean displacement,
    and whether no cluster may act on their interpolation points."""

    boxes: Boxes
    number: IntArray
    allowed: FloatArray
    mean: FloatArray
    few: np.ndarray
    region: bool


class _Walk(NamedTuple):
    """A traversal of the tree."""

    tree: SourceTree
    reach: Reach
    function: Kernel

    def of(
        self, where: _Box, box: IntArray, cluster: IntArray
    ) -> tuple[tuple[IntArray, IntArray], tuple[IntArray, IntArray], FloatArray]:
        """Traverse the tree from pairs of a box (n,), counted among those of ``where``, and a cluster (n,).

        Returns pairs of box and entry that act on the interpolation points of boxes, pairs of region and cluster left
        to the bricks of the region or of brick and entry that acts on its nodes, and the bound of each box's error.
        """
        inner, extents = self.tree.boxes, np.sqrt(np.einsum("md,md->m", self.tree.boxes.half, self.tree.boxes.half))
        without = np.diff(inner.proxy) == 0
        half = where.boxes.half[where.number]
        radii = np.sqrt(np.einsum("md,md->m", half, half))
        bound, far, other = np.zeros(len(where.number)), [(box[:0], box[:0])], [(box[:0], box[:0])]
        while len(box):
            arm = where.boxes.center[where.number[box]] - inner.center[cluster]
            distance, extent = np.sqrt(np.einsum("nd,nd->n", arm, arm)), extents[cluster]
            raw, radius = without[cluster], radii[box]
            # Effect of a cluster on the mean if its weights are wrong by 100 %, relative to its allowed error.
            pull = self.reach.shift[cluster] + self.reach.turn[cluster] * distance + where.mean[box]
            pull *= self.reach.strength[cluster] / where.allowed[box]
            error = np.full(len(box), np.inf)
            some = np.flatnonzero(~where.few[box] & (distance > extent) & (raw | (distance > radius)))
            error[some] = self._error_over(
                where.boxes, where.number[box[some]], distance[some] - extent[some], distance[some]
            )
            both = some[~raw[some]]
            error[both] = np.maximum(
                error[both], self._error_over(inner, cluster[both], distance[both], distance[both])
            )
            cost = _product(pull, error)
            near = cost >= 0.5
            far.append((box[~near], 2 * cluster[~near] + raw[~near]))
            bound += np.bincount(box[~near], cost[~near], len(bound))
            box, cluster, raw = box[near], cluster[near], raw[near]
            distance, extent, radius, pull = (each[near] for each in (distance, extent, radius, pull))
            if not where.region:
                error = np.full(len(box), np.inf)
                some = np.flatnonzero(~raw & (distance > radius))
                gap = distance[some] - radius[some]
                error[some] = self._error_over(inner, cluster[some], gap, gap)
                cost = _product(pull, error)
                near = cost >= 0.5
                other.append((box[~near], 2 * cluster[~near]))
                bound += np.bincount(box[~near], cost[~near], len(bound))
                box, cluster, raw = box[near], cluster[near], raw[near]
                extent, radius = extent[near], radius[near]
            split = (self.tree.child[cluster] >= 0) & ~raw & ((extent > radius) | (not where.region))
            other.append((box[~split], cluster[~split] if where.region else 2 * cluster[~split] + 1))
            box = np.repeat(box[split], 2)
            cluster = np.stack([self.tree.child[cluster[split]], self.tree.child[cluster[split]] + 1], axis=1).ravel()
        (one, codes), (two, others) = (tuple(map(np.concatenate, zip(*pairs, strict=True))) for pairs in (far, other))
        return (one, codes), (two, others), bound

    def _error_over(self, boxes: Boxes, number: IntArray, gap: FloatArray, distance: FloatArray) -> FloatArray:
        return self.function.box_error(boxes.half[number], boxes.per_side[number], gap, distance)


def _product(pull: FloatArray, error: FloatArray) -> FloatArray:
    """The bound of the error; infinite where the interpolation has no bound, even without effect on the mean."""
    return np.multiply(pull, error, out=np.full(len(pull), np.inf), where=np.isfinite(error))
