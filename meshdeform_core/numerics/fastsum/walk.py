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

from ..arrays import FloatArray, IntArray
from ..jit import kernel
from .clusters import Boxes, SourceTree
from .targets import Targets


class Kernel(NamedTuple):
    """The weight r^-a + kappa r^-b of inverse distance weighting.

    ``single``: sums of weights may be computed in single precision.
    """

    a: float
    b: float
    kappa: float
    single: bool

    @classmethod
    def of(cls, a: float, b: float, kappa: float, single: bool = False) -> Kernel:
        """The weight function, in ``single`` precision if there is a loop for it."""
        return cls(float(a), float(b), float(kappa), single and a in (3.0, 4.0) and b == 5.0)


Lists = tuple[np.ndarray, np.ndarray]
"""The clusters that act in some neighbouring regions: int32 codes (n,) of all lists, with entries as above, and the end
of each list. A region has one list for its interpolation points, followed by two for each of its bricks, for the
brick's interpolation points and for its nodes."""


def list_clusters(
    first: int,
    last: int,
    targets: Targets,
    tree: SourceTree,
    clusters: tuple[FloatArray, IntArray],
    reach: FloatArray,
    function: Kernel,
    allowed: FloatArray,
    mean: FloatArray,
    risk: FloatArray,
) -> Lists:
    """:data:`Lists` of the regions first <= g < last; adds to ``risk`` the sum of the error bounds of all clusters,
    relative to the error ``allowed`` to one of them.

    Of each cluster, its extents and ``reach`` (m, 3): strength, largest displacement and rotation of its sources, which
    bound its effect, strength * (shift + turn * distance + mean displacement of the brick). Of each brick (b,): the
    error of the sums that one cluster may cause, a bound of the mean displacement, the risk.
    """
    ends = targets.first[first : last + 1]
    low, high = int(ends[0]), int(ends[-1])
    start = ends[:-1] - low
    # Each region is followed by its bricks.
    order = np.insert(np.arange(last - first, last - first + high - low), start, np.arange(last - first))
    state = np.concatenate([np.full(last - first, _REGION), np.where(targets.few[low:high], _FEW, _BRICK)])
    limits = np.stack(
        [
            np.append(np.minimum.reduceat(allowed[low:high], start), allowed[low:high]),
            np.append(np.maximum.reduceat(mean[low:high], start), mean[low:high]),
        ],
        axis=1,
    )
    places, counts = (
        np.concatenate([one, two])
        for one, two in zip(_extents(targets.regions, first, last), _extents(targets.bricks, low, high), strict=True)
    )
    m = len(tree.child)
    stop, length = np.empty(last - first + 2 * (high - low), dtype=np.int64), 2048 + 4 * m
    while True:
        codes, bounds = np.empty(length, dtype=np.int32), np.empty(len(order))
        used = _list(
            places[order], counts[order], state[order], limits[order], *clusters, tree.child, reach,
            np.array(function[:3]), codes, stop, bounds, np.empty((3, m), dtype=np.int64),
        )  # fmt: skip
        if used >= 0:
            risk[low:high] += bounds[state[order] != _REGION]
            return codes[:used].copy(), stop
        length *= 4


_REGION, _BRICK, _FEW = 0, 1, 2
"""Places: a region, a brick, a brick of few nodes."""


def extents_of(tree: SourceTree) -> tuple[FloatArray, IntArray]:
    """Extents of all clusters, as :func:`_extents`; clusters without interpolation points have 0 per side."""
    found, inner = _extents(tree.boxes, 0, len(tree.child))
    inner[np.diff(tree.boxes.proxy) == 0] = 0
    return found, inner


def _extents(boxes: Boxes, first: int, last: int) -> tuple[FloatArray, IntArray]:
    """Of some boxes: middles, half widths, the largest of these and half the diagonal (m, 8); interpolation points per
    side (m, 3)."""
    some = slice(first, last)
    half = boxes.half[some]
    radius = np.sqrt(np.einsum("md,md->m", half, half))
    return np.column_stack([boxes.center[some], half, half.max(axis=1), radius]), boxes.per_side[some].copy()


@kernel(
    "f8[:, ::1], i8[:, ::1], i8[::1], f8[:, ::1], f8[:, ::1], i8[:, ::1], i8[::1], f8[:, ::1], f8[::1], i4[::1],"
    "i8[::1], f8[::1], i8[:, ::1]"
)
def _list(places, counts, state, limits, clusters, inner, child, reach, powers, codes, stop, risk, lists):
    """Fill ``codes`` and ``stop``; return the number of codes, or -1 if the array is too short for them.

    Clusters are visited in the order of their numbers, which are those of the tree's levels: the next is the first of
    those left by the region and of the children waiting.

    Parameters
    ----------
    places, counts : (p, 8), (p, 3) as :func:`_extents`, of each region, followed by its bricks
    state : (p,) kind of place
    limits : (p, 2) error that one cluster may cause, mean displacement
    clusters, inner : (m, 8), (m, 3) of the tree; ``inner`` is 0 for clusters without interpolation points
    child : (m,) first child of each cluster, or -1
    reach : (m, 3) as of :func:`list_clusters`
    powers : (3,) a, b, kappa
    risk : (p,) bound of the error in each brick, that of its region included
    lists : (3, m) scratch: clusters left to bricks, entries that act on nodes (these two change places), children
    """
    n_left = at = item = left = 0
    above = 0.0
    for p in range(state.size):
        if at + 2 * child.size > codes.size:
            return -1
        region, few = state[p] == _REGION, state[p] == _FEW
        if region:
            lists[left, 0], n_left, above = 0, 1, 0.0
        radius = places[p, 7]
        bound, n_other, taken, served, n_waiting = above, 0, 0, 0, 0
        while taken < n_left or served < n_waiting:
            if served == n_waiting or (taken < n_left and lists[left, taken] < lists[2, served]):
                c = lists[left, taken]
                taken += 1
            else:
                c = lists[2, served]
                served += 1
            dx, dy, dz = places[p, 0] - clusters[c, 0], places[p, 1] - clusters[c, 1], places[p, 2] - clusters[c, 2]
            distance, extent, raw = math.sqrt(dx * dx + dy * dy + dz * dz), clusters[c, 7], inner[c, 0] == 0
            # Effect of a cluster on the mean if its weights are wrong by 100 %, relative to its allowed error.
            pull = reach[c, 0] * (reach[c, 1] + reach[c, 2] * distance + limits[p, 1]) / limits[p, 0]
            # First through the interpolation points of the place, then those of the cluster alone.
            acts, error = 0, np.inf
            if not few and distance > extent and (raw or distance > radius):
                error = _error(places, counts, p, distance - extent, distance, powers)
                if not raw:
                    of_cluster = _error(clusters, inner, c, distance, distance, powers)
                    if of_cluster > error:
                        error = of_cluster
                acts = 1 if pull * error < 0.5 else 0
            if acts == 0 and not region and not raw and distance > radius:
                error = _error(clusters, inner, c, distance - radius, distance - radius, powers)
                acts = 2 if pull * error < 0.5 else 0
            if acts:
                bound += pull * error
            if acts == 1:
                codes[at] = 2 * c + raw
                at += 1
            elif acts == 2:
                lists[1 - left, n_other] = 2 * c
                n_other += 1
            elif child[c] >= 0 and not raw and (not region or extent > radius):
                lists[2, n_waiting] = child[c]
                lists[2, n_waiting + 1] = child[c] + 1
                n_waiting += 2
            else:
                lists[1 - left, n_other] = c if region else 2 * c + 1
                n_other += 1
        risk[p] = bound
        stop[item] = at
        item += 1
        if region:
            left, n_left, above = 1 - left, n_other, bound
            continue
        for n in range(n_other):
            codes[at + n] = lists[1 - left, n]
        at += n_other
        stop[item] = at
        item += 1
    return at


@kernel
def _error(boxes, counts, i, gap, distance, powers):
    """Error of interpolating the weight function over a box: the relative error at the distance ``gap`` from its middle
    times the function's value at ``distance``; infinite where there is no bound.

    The leading Taylor term beyond the interpolation order in each direction, times its growth towards the nearest side.
    Calibrated against computed errors: typically 1 to 3 times too large, at worst 2 times too small.
    """
    longest = boxes[i, 6]
    # Distance from the sides plus the longest half width: smaller for a source off a corner.
    reach = gap - (boxes[i, 7] - longest)
    if reach <= longest * 1.05:
        return np.inf
    ratio = powers[2] * gap ** (powers[0] - powers[1])
    steep, error = ratio / (1.0 + ratio), 0.0
    for part in range(2):
        power, share = powers[part], steep if part else 1.0 - steep
        if share > 0.01:
            total = 0.0
            for d in range(3):
                n, k = float(counts[i, d]), 1.0
                term = 2.0 * (boxes[i, 3 + d] / reach * 0.5) ** n
                # Binomial coefficient (n + power - 1 choose n).
                while k <= power - 1.0:
                    term *= (n + k) / k
                    k += 1.0
                total += term
            error += share * total / (1.0 - longest / reach) ** power
    return error * (distance ** -powers[0] + powers[2] * distance ** -powers[1])
