"""Which clusters act where: the tree of sources is traversed for every region of bricks, and then for its bricks.

A cluster far enough away for the required accuracy of its part of the sum is replaced by its interpolation points,
which act on those of the region. Nearer clusters are passed on to the bricks of the region: they act on a brick's
interpolation points or on its nodes; the nearest act on the nodes by their sources.

An entry of a list is 2 c for the interpolation points of cluster c, and 2 c + 1 for its sources. The lists are valid
for every displacement that moves no cluster further than the one they were made for.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ...arrays import FloatArray
from ...jit import inlined, kernel
from ..clusters.acceptance import Kernel, box_error, distance2, square
from ..clusters.bricks import Bricks, Regions
from ..clusters.tree import SourceTree

_STACK = 256


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
    stop = np.empty(len(ends) - 1 + 2 * int(ends[-1] - ends[0]), dtype=np.int64)
    found = risk[ends[0] : ends[-1]]
    m = len(tree.child)
    length = 2048 + 4 * m
    while True:
        codes, bounds = np.empty(length, dtype=np.int32), np.zeros(len(found))
        used = _look(first, last, regions, bricks, tree, reach, function, allowed, mean, codes, stop, bounds)
        if used >= 0:
            found += bounds
            return Lists(codes[:used].copy(), stop)
        length *= 4


@kernel
def _look(first, last, regions, bricks, tree, reach, function, allowed, mean, codes, stop, risk):
    """Fill ``codes`` and ``stop``; return the number of codes, or -1 if the array is too short for them."""
    m = tree.child.size
    stack, root = np.empty(_STACK, np.int64), np.empty(1, np.int64)
    left, near = np.empty(m, np.int64), np.empty(m, np.int64)
    root[0] = 0
    at = item = n_left = 0
    start = regions.first[first]
    for g in range(first, last):
        least, most, bound = np.inf, 0.0, 0.0
        for b in range(regions.first[g], regions.first[g + 1]):
            least, most = min(least, allowed[b]), max(most, mean[b])
        # The region, then its bricks: one loop for both is compiled once.
        for b in range(regions.first[g] - 1, regions.first[g + 1]):
            if at + 2 * m > codes.size:
                return -1
            region = b < regions.first[g]
            tops, n_tops, other = (root, 1, left) if region else (left, n_left, near)
            boxes, box = (regions.boxes, g) if region else (bricks.boxes, b)
            limit, moved = (least, most) if region else (allowed[b], mean[b])
            few = not region and few_nodes(bricks, b)
            at, n_other, more = _walk(
                tops, n_tops, region, few, boxes, box, tree, reach, function, limit, moved, stack, codes,
                at, other,
            )  # fmt: skip
            stop[item] = at
            item += 1
            if region:
                n_left, bound = n_other, more
            else:
                for n in range(n_other):
                    codes[at + n] = near[n]
                at += n_other
                stop[item] = at
                item += 1
                risk[b - start] += bound + more
    return at


@inlined
def few_nodes(bricks, b):
    """Whether a brick has so few nodes that it needs no interpolation points of its own."""
    return bricks.start[b + 1] - bricks.start[b] <= 2 * (bricks.boxes.proxy[b + 1] - bricks.boxes.proxy[b])


@inlined
def _walk(tops, n_tops, region, few, boxes, b, tree, reach, function, allowed, mean, stack, codes, at, other):
    """Traverse the tree from the clusters ``tops`` on for box ``b``, a ``region`` or a brick.

    Entries that act on the box's interpolation points go into ``codes`` from ``at`` on; ``other`` gets the clusters
    left to the bricks of a region, or the entries that act on the nodes of a brick. Returns the ends of both and the
    bound of the error.
    """
    bound = 0.0
    n_other = 0
    center, half, count = boxes.center, boxes.half, boxes.per_side
    radius = math.sqrt(square(half, b))
    for top in range(n_tops):
        stack[0] = tops[top]
        depth = 1
        while depth:
            depth -= 1
            c = stack[depth]
            d2 = distance2(center, b, tree.boxes.center, c)
            distance, extent = math.sqrt(d2), math.sqrt(square(tree.boxes.half, c))
            raw = tree.boxes.proxy[c + 1] == tree.boxes.proxy[c]
            # Effect of a cluster on the mean if its weights are wrong by 100 %, relative to its allowed error.
            pull = reach.strength[c] * (reach.shift[c] + reach.turn[c] * distance + mean) / allowed
            if not few and distance > extent and (raw or distance > radius):
                error = box_error(half, count, b, distance - extent, distance, function)
                if not raw:
                    error = max(error, box_error(tree.boxes.half, tree.boxes.per_side, c, distance, distance, function))
                if pull * error < 0.5:
                    bound += pull * error
                    codes[at] = 2 * c + (1 if raw else 0)
                    at += 1
                    continue
            if not region and not raw and distance > radius:
                gap = distance - radius
                error = box_error(tree.boxes.half, tree.boxes.per_side, c, gap, gap, function)
                if pull * error < 0.5:
                    bound += pull * error
                    other[n_other] = 2 * c
                    n_other += 1
                    continue
            if tree.child[c] >= 0 and not raw and (not region or extent > radius):
                stack[depth], stack[depth + 1] = tree.child[c], tree.child[c] + 1
                depth += 2
            else:
                other[n_other] = c if region else 2 * c + 1
                n_other += 1
    return at, n_other, bound
