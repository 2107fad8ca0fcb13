"""Which clusters act where, which all displacements with the same key share; the points and charges that this takes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ...parallel import for_chunks
from ..arrays import BoolArray, FloatArray, IntArray
from ..exact.direct import SINGLE, sum_groups, sum_whole
from ..jit import fast_kernel, kernel
from .clusters import CHARGES, SourceTree, interpolate, place_points
from .targets import Targets, spans
from .walk import Kernel, Lists, extents_of, list_clusters

# Portions into which the clusters of a tree are divided among threads.
_PORTIONS = 64
_SAMPLES = 2048


def cluster_reach(groups: Sequence[tuple[IntArray, SourceTree]], sources: FloatArray) -> list[FloatArray]:
    """Strength (sum), displacement and rotation (largest) of the clusters (m, 3) of each group, from those of
    ``sources`` (n, 3).

    All clusters that move have one bound, the largest, rounded up to a power of four: so coarsely that the steps of a
    growing or oscillating motion share a few bounds.
    """
    found = []
    for group, tree in groups:
        # reduceat takes the spans as pairs of positions; the results between spans are discarded.
        places, own = tree.span.ravel(), np.append(sources[group][tree.order], np.zeros((1, 3)), axis=0)
        parts = np.add.reduceat(own[:, 0], places), np.maximum.reduceat(own[:, 1:], places)
        found.append(np.column_stack([part[::2] for part in parts]))
    most = np.max([each[:, 1:].max(axis=0) for each in found], axis=0)
    common = np.ldexp(1.0, 2 * -(-np.frexp(most)[1] // 2))
    for each in found:
        each[:, 1:] = np.where(each[:, 1:] > 0.0, common, 0.0)
    return found


class Charges(NamedTuple):
    """Charges (strength, strength times values) of sources and of the interpolation points of clusters.

    Attributes
    ----------
    points, values : (n + k, 3), (n + k, 8) of the sources in tree order, then of the interpolation points
    rows : (2 m, 2) for each entry of a list (:mod:`.walk`), the first row, and one past the last, of what acts
    all : whether the first or the last charge can be nonzero; the first, the strength, is omitted once the weights are
        known, and the last is needed by few kinds of rotation only
    """

    points: np.ndarray
    values: np.ndarray
    rows: np.ndarray
    all: bool

    @classmethod
    def none(cls) -> Charges:
        """Those of a group that does not act."""
        return cls(np.empty((0, 3)), np.empty((0, CHARGES)), np.empty((0, 2), np.int64), False)


def charge_points(tree: SourceTree, start: IntArray) -> tuple[FloatArray, IntArray]:
    """``points`` and ``rows`` of :class:`Charges`; after the sources, the interpolation points of cluster c: rows
    ``start[c]`` to ``start[c + 1]`` of those of all."""
    rows = np.stack([len(tree.order) + spans(start), tree.span], axis=1).reshape(-1, 2)
    return np.concatenate([tree.points, place_points(tree.boxes, start)]), rows


def gather(tree: SourceTree, start: IntArray, values: FloatArray) -> Charges:
    """:class:`Charges` from ``values`` (n + k, 8) with those of the sources; each cluster's are shared out among its
    interpolation points, rows ``start[c]`` to ``start[c + 1]`` of those of all."""
    n, (points, rows) = len(tree.order), charge_points(tree, start)
    charged = np.append(0, np.cumsum(values[:n].any(axis=1)))
    active = (charged[tree.span[:, 1]] > charged[tree.span[:, 0]]) & (np.diff(start) > 0)
    tasks = np.column_stack([np.arange(len(tree.child)), rows[::2, 0], tree.span])[active]
    # Portions of about equal cost; clusters near the root cost most.
    work = np.append(0, np.cumsum(np.diff(tree.span, axis=1)[active, 0] * np.diff(start)[active]))
    cut = np.unique(np.searchsorted(work, np.linspace(0, work[-1], _PORTIONS + 1)))

    def share_out(lo: int, hi: int) -> None:
        interpolate(tree.boxes, tasks[cut[lo] : cut[hi]], points, values, 0, CHARGES, True)

    for_chunks(share_out, len(cut) - 1, 1)
    return Charges(points, values, rows, bool(values[:n, [0, -1]].any()))


@fast_kernel("f8[:, ::1], i8[:, ::1], f8[:, ::1], f8[:, ::1], i8[:, ::1], i8[:, ::1], f8, f8, b1, f8[:, ::1]")
def sum_single(targets, target_span, sources, charges, pieces, piece_span, a, kappa, all_charges, out):
    """:func:`..exact.direct.sum_groups` for a = 3 or 4 with b = 5 in single precision, which exact sums never need."""
    sum_whole(targets, target_span, sources, charges, pieces, piece_span, a, kappa, all_charges, SINGLE, out)


class Places(NamedTuple):
    """Points at which the sums for some neighbouring regions are taken.

    Attributes
    ----------
    points : (n, 3) coordinates: the nodes of the bricks, then the interpolation points of bricks and regions
    span : (items, 2) int64, rows of ``points`` that belong to each list of :data:`.walk.Lists`
    region, brick : (b,) region and number of each brick
    item : (b,) number of the list of each brick's interpolation points; that of its nodes follows
    above : (b,) number of the list of each brick's region
    few : (b,) whether the brick has no interpolation points of its own
    """

    points: np.ndarray
    span: np.ndarray
    region: np.ndarray
    brick: np.ndarray
    item: np.ndarray
    above: np.ndarray
    few: np.ndarray

    def tasks(self, filled: BoolArray) -> tuple[IntArray, IntArray]:
        """Tasks of :func:`.clusters.interpolate` for ``filled`` (items,) lists: from regions to the interpolation
        points of their bricks, or the nodes of those that have none, and from bricks to nodes."""
        to = self.span[self.item + self.few]
        down = filled[self.above]
        of_regions = np.column_stack([self.region, self.span[self.above, 0], to])[down]
        inside = ~self.few & (filled[self.item] | down)
        of_bricks = np.column_stack([self.brick, self.span[self.item, 0], self.span[self.item + 1]])[inside]
        return of_regions, of_bricks

    def add(self, charges: Charges, lists: Lists, function: Kernel, acting: BoolArray, out: FloatArray) -> BoolArray:
        """Add weighted sums over the ``acting`` (m,) clusters of a tree at all places to ``out`` (n, 8).

        Returns which lists (items,) hold any cluster.
        """
        codes, ends = lists
        active = acting[codes >> 1]
        stop, rows = np.append(0, np.cumsum(active))[np.append(0, ends)], charges.rows[codes[active]]
        groups = self.points, self.span, charges.points, charges.values, rows, spans(stop)
        if function.single:
            sum_single(*groups, function.a, function.kappa, charges.all, out)
        else:
            sum_groups(*groups, *function[:3], charges.all, out)
        return np.asarray(stop[1:] > stop[:-1])


def places_of(first: int, last: int, targets: Targets) -> Places:
    """:class:`Places` of the regions first <= g < last."""
    bricks, regions = targets.bricks, targets.regions
    ends = targets.first[first : last + 1]
    low, high = int(ends[0]), int(ends[-1])
    start, proxy = targets.start[low : high + 1], bricks.proxy[low : high + 1]
    region = regions.proxy[first : last + 1]
    x = [targets.points[targets.every[start[0] : start[-1]]], bricks.proxies[proxy[0] : proxy[-1]],
         regions.proxies[region[0] : region[-1]]]  # fmt: skip
    start, proxy = start - start[0], proxy - proxy[0] + start[-1] - start[0]
    region = region - region[0] + proxy[-1]
    # The list of a region precedes the two lists of each of its bricks.
    number = np.repeat(np.arange(last - first), np.diff(ends))
    above = (np.arange(last - first) + 2 * (ends[:-1] - low))[number]
    item = 2 * np.arange(high - low) + number + 1
    span = np.empty((last - first + 2 * (high - low), 2), dtype=np.int64)
    span[above] = np.stack([region[:-1], region[1:]], axis=1)[number]
    span[item], span[item + 1] = spans(proxy), spans(start)
    return Places(np.concatenate(x), span, first + number, np.arange(low, high), item, above, targets.few[low:high])


class Plan:
    """The lists of clusters for some weight functions and motions, made on demand and stored while there is room.

    Parameters
    ----------
    key : whatever differs between plans
    trees : the sources of each group and their tree
    kinds : weight function of each group
    reaches : bounds of the effect of each group's clusters, rounded up
    acting : (n,) which sources are summed separately from the others
    accuracy : :class:`.weighted.Accuracy`
    lasting : number of values per source whose sums are stored with the weights; ``None``: weights are not stored
    chunk : regions whose lists are stored together
    room : limit (bytes) for what is stored

    Attributes
    ----------
    risk : (b,) bound of each brick's error, in arbitrary units
    moving : for each tree, which clusters (m,) hold sources that move
    weight : (n, 1 + lasting) of every target in the order of the bricks, and its sums of values that never change,
        known once ``weighed``; ``None`` without room
    checked : total weight (m,) by exact sums at the nodes where fast ones are compared with them, once known
    used : for each tree, whether the interpolation points of a cluster (m,) act anywhere; beside few targets, few do
    """

    def __init__(
        self, key: Any, targets: Targets, trees: list[tuple[IntArray, SourceTree]], kinds: list[Kernel],
        reaches: list[FloatArray], acting: BoolArray, accuracy: Any, lasting: int | None, chunk: int, room: int,
    ) -> None:  # fmt: skip
        self.key, self.kinds, self.acting, self.lasting = key, kinds, acting, lasting or 0
        self._targets, self._trees, self._reaches = targets, [tree for _, tree in trees], reaches
        self._extents = [extents_of(tree) for tree in self._trees]
        self._allowed, self._mean = _allowance(targets, self._trees, kinds, reaches, accuracy)
        self.risk = np.zeros(len(self._allowed))
        counts = [np.append(0, np.cumsum(acting[group][tree.order])) for group, tree in trees]
        self.moving = [n[tree.span[:, 1]] > n[tree.span[:, 0]] for n, (_, tree) in zip(counts, trees, strict=True)]
        rows = len(targets.every)
        size = 8 * rows * (1 + self.lasting)
        self.weight = np.empty((rows, 1 + self.lasting)) if lasting is not None and size <= room else None
        self.weighed, self.checked = False, np.empty(0)
        self.used = [np.zeros(len(tree.child), dtype=bool) for tree in self._trees]
        self._room, self._kept = room if lasting is None else room - size, dict[int, list[Lists]]()

        def work(first: int, last: int) -> None:
            found = self._made(first, last)
            size = sum(part.nbytes for lists in found for part in lists)
            if size <= self._room:
                self._room -= size
                self._kept[first] = found

        for_chunks(work, targets.n_regions, chunk)

    def lists_of(self, first: int, last: int) -> list[Lists]:
        """:data:`.walk.Lists` of each group for the regions first <= g < last; called from several threads."""
        return self._kept[first] if first in self._kept else self._made(first, last)

    def _made(self, first: int, last: int) -> list[Lists]:
        targets = self._targets
        self.risk[targets.first[first] : targets.first[last]] = 0.0
        found = [
            list_clusters(first, last, targets, *of_tree, self._allowed, self._mean, self.risk)
            for of_tree in zip(self._trees, self._extents, self._reaches, self.kinds, strict=True)
        ]
        for used, (codes, _) in zip(self.used, found, strict=True):
            used[codes[codes & 1 == 0] >> 1] = True
        return found

    def sums(self, first: int, last: int, passes: Sequence[Sequence[Charges]], weighing: bool) -> list[FloatArray]:
        """Sums (m, 8) of every pass at the nodes of the regions first <= g < last; called from several threads.

        A pass consists of the charges of each tree. Clusters without moving sources count only in the first pass, when
        ``weighing``, and are summed separately, so the sums of the moving ones are the same to the last bit either way.
        """
        targets, lists, found = self._targets, self.lists_of(first, last), []
        places = places_of(first, last, targets)
        for number, charges in enumerate(passes):
            total, filled = np.zeros((len(places.points), CHARGES)), np.zeros(len(places.span), dtype=bool)
            for charge, kind, each, moving in zip(charges, self.kinds, lists, self.moving, strict=True):
                filled |= places.add(charge, each, kind, moving, total)
                if weighing and number == 0:
                    filled |= places.add(charge, each, kind, ~moving, total)
            columns = (0, CHARGES) if any(charge.all for charge in charges) else (1, CHARGES - 1)
            of_regions, of_bricks = places.tasks(filled)
            for boxes, tasks in ((targets.regions, of_regions), (targets.bricks, of_bricks)):
                interpolate(boxes, tasks, places.points, total, *columns, False)
            found.append(total[: len(targets.flat(first, last))])
        return found


def _allowance(
    targets: Targets, trees: Sequence[SourceTree], kinds: list[Kernel], reaches: list[FloatArray], accuracy: Any
) -> tuple[FloatArray, FloatArray]:
    """Weighted displacement error that one cluster may cause in each brick, and the mean displacement there.

    Both follow from the total weight at the samples of the brick, and from a bound of the weighted displacement.
    """
    shape, flat = targets.samples.shape, targets.samples.ravel()
    total, moved = np.zeros(flat.size), np.zeros(flat.size)

    def work(lo: int, hi: int) -> None:
        for tree, reach, kind in zip(trees, reaches, kinds, strict=True):
            boxes, powers = (tree.boxes.center, tree.boxes.half), (kind.a, kind.b, kind.kappa)
            _add_weights(targets.points, flat[lo:hi], boxes, tree.child, reach, powers, total[lo:hi], moved[lo:hi])

    for_chunks(work, flat.size, _SAMPLES)
    sizes = targets.sizes if accuracy.local else np.ones(shape)
    allowed = (total.reshape(shape) * sizes).min(axis=1) * accuracy.tolerance
    return allowed, (moved / total).reshape(shape).max(axis=1)


@kernel(
    "f8[:, ::1], i8[::1], Tuple((f8[:, ::1], f8[:, ::1],)), i8[::1], f8[:, ::1], Tuple((f8, f8, f8,)), f8[::1], f8[::1]"
)
def _add_weights(points, samples, boxes, child, reach, powers, total, moved):
    """Add to ``total`` (n,) the weight of all sources at ``points[samples]``, and to ``moved`` (n,) a bound of the
    weighted displacement there."""
    (center, half), (a, b, kappa) = boxes, powers
    stack = np.empty(128, np.int64)
    for s in range(len(samples)):
        stack[0], depth = 0, 1
        while depth:
            depth -= 1
            c = stack[depth]
            square = extent = 0.0
            for d in range(3):
                square += (points[samples[s], d] - center[c, d]) ** 2
                extent += half[c, d] ** 2
            if square > 2.0 * extent or child[c] < 0:
                # A leaf that may contain the sample: the weight at its rim is a lower bound.
                distance = math.sqrt(max(square, 0.25 * extent))
                weight = reach[c, 0] * (distance**-a + kappa * distance**-b)
                total[s] += weight
                moved[s] += weight * (reach[c, 1] + reach[c, 2] * math.sqrt(square))
            else:
                stack[depth], stack[depth + 1] = child[c], child[c] + 1
                depth += 2
