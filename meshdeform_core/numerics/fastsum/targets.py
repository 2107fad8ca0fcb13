"""Target nodes in trees, built once per undeformed grid by halving ranges of block indices instead of sorting nodes in
space; for weighted sums in bricks and regions of these, and where the accuracy of each brick is judged."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...parallel import Nodes, for_chunks
from ..arrays import BoolArray, FloatArray, IntArray, Shapes
from ..jit import record
from ..pieces import pieces
from .clusters import Boxes, extents, fit_boxes, make_boxes
from .tuned import RADIAL_REGION, REGION

_SAMPLES = 9


class Halves(NamedTuple):
    """Parts of blocks as binary trees: index ranges, halved until they hold at most a number of targets.

    Tree nodes are numbered so that parents come before their children.

    Attributes
    ----------
    targets : (n,) flat node indices of the grid; those below a tree node are contiguous
    span : (m, 2) first and one past the last target below each tree node
    child : (m, 2) children of each tree node, -1 for leaves and for parts without targets
    region : (g,) root of the tree of each region, in the order of the targets
    """

    targets: np.ndarray
    span: np.ndarray
    child: np.ndarray
    region: np.ndarray


def halve(
    points: FloatArray, shapes: IntArray, offsets: IntArray, flat: IntArray, capacity: float, region: int
) -> Halves:
    """Trees of the nodes ``flat`` (n,), ascending, of a grid, with leaves of at most about ``capacity`` targets.

    Index ranges are halved along the direction in which they are longest in space, so that leaves are compact although
    cells are stretched. A region is a range with about ``region`` leaves. No tree extends beyond a piece of a block
    (:mod:`..pieces`), so trees do not depend on which other parts of the grid are evaluated, or held by this rank.
    """
    block, low, high = pieces(shapes).T
    rows = offsets[block] + np.stack([low, high]) * shapes[block, 1:].prod(axis=1)
    ends = np.searchsorted(flat, rows)
    some = np.flatnonzero(ends[1] > ends[0])
    none, pairs = np.empty(0, np.int64), np.empty((0, 2), np.int64)
    parts = [Halves(none, pairs, pairs, none)] * (1 + len(some))

    def cut(number: int, _: int) -> None:
        piece = some[number]
        (lo, hi), own = rows[:, piece], flat[slice(*ends[:, piece])]
        shape = (high[piece] - low[piece], *shapes[block[piece], 1:])
        mask = np.zeros(hi - lo, dtype=bool)
        mask[own - lo] = True
        volume = capacity * mask.size / len(own)
        found = _cut(points[lo:hi].reshape(*shape, 3), mask.reshape(shape), volume, region)
        parts[1 + number] = found._replace(targets=found.targets + lo)

    for_chunks(cut, len(some), 1)
    used = nodes = 0
    for number, (targets, span, child, roots) in enumerate(parts):
        parts[number] = Halves(targets, span + used, np.where(child >= 0, child + nodes, -1), roots + nodes)
        used, nodes = used + len(targets), nodes + len(span)
    return Halves(*(np.concatenate(each) for each in zip(*parts, strict=True)))


def _cut(x: FloatArray, mask: BoolArray, capacity: float, region: int) -> Halves:
    """The trees of one piece, its targets counted from 0; all index ranges of a level are halved together."""
    # First and one past the last index along each axis, the path from the whole piece as a binary number (the lower
    # half comes first), and whether the range lies in a region.
    box, path, inside = np.array([[[0, n] for n in mask.shape]]), np.zeros(1, dtype=np.int64), np.zeros(1, dtype=bool)
    levels, used, bit = [], 0, 1 << 61
    while len(box):
        size = np.diff(box, axis=2).prod(axis=(1, 2))
        root, split = ~inside & (size <= region * capacity), np.flatnonzero(size > capacity)
        used, inside, child = used + len(box), inside | root, np.full((len(box), 2), -1)
        child[split] = used + np.arange(2 * len(split)).reshape(-1, 2)
        levels.append((box, path, inside, root, child))
        axis, every = _longest_sides(x, box[split]), np.arange(len(split))
        halves = np.stack([box[split], box[split]], axis=1)
        halves[every, 0, axis, 1] = halves[every, 1, axis, 0] = box[split, axis].sum(axis=1) // 2
        box, path, bit = halves.reshape(-1, 3, 2), np.stack([path[split], path[split] + bit], axis=1).ravel(), bit >> 1
        inside = np.repeat(inside[split], 2)
    box, path, inside, root, child = (np.concatenate(each) for each in zip(*levels, strict=True))
    order, numbers = np.argsort(path, kind="stable"), np.arange(mask.size).reshape(mask.shape)
    targets, span, used = [], np.zeros_like(child), 0
    for leaf in order[child[order, 0] < 0]:
        (i0, i1), (j0, j1), (k0, k1) = box[leaf].tolist()
        targets.append(numbers[i0:i1, j0:j1, k0:k1][mask[i0:i1, j0:j1, k0:k1]])
        span[leaf] = used, used + len(targets[-1])
        used += len(targets[-1])
    for n in np.flatnonzero(child[:, 0] >= 0)[::-1]:
        span[n] = span[child[n, 0], 0], span[child[n, 1], 1]
    # Ranges above regions are left out.
    number = np.cumsum(inside) - 1
    child = np.where(child >= 0, number[child], -1)[inside]
    return Halves(np.concatenate(targets), span[inside], child, number[order[root[order]]])


def _longest_sides(x: FloatArray, box: IntArray) -> IntArray:
    """Index axis (n,) along which each index range (n, 3, 2) is longest: mean length of its edges, taken through their
    quarter points."""
    low, reach = box[:, :, 0], box[:, :, 1] - box[:, :, 0] - 1
    points, step = x.reshape(-1, 3), np.array([x.shape[1] * x.shape[2], x.shape[2], 1])
    length = np.full((len(box), 3), -1.0)
    for axis in range(3):
        one, two = (d for d in range(3) if d != axis)
        at = (low @ step)[:, None, None] + (reach[:, axis, None] * np.arange(5) // 4 * step[axis])[:, None]
        corners = [a * reach[:, one] * step[one] + b * reach[:, two] * step[two] for a in (0, 1) for b in (0, 1)]
        edges = np.diff(points[at + np.stack(corners, axis=1)[:, :, None]], axis=2)
        length[:, axis] = np.where(reach[:, axis] > 0, np.linalg.norm(edges, axis=3).sum(axis=(1, 2)), -1.0)
    return np.asarray(np.argmax(length, axis=1))


@record("i8[::1], i8[:, ::1], i8[:, ::1], i8[::1], f8[:, ::1], f8[:, :, ::1], f8[:, ::1]")
class TargetTree(NamedTuple):
    """:class:`Halves` with boxes along principal axes: ``center, axes, half`` (m, 3), (m, 3, 3), (m, 3)."""

    targets: np.ndarray
    span: np.ndarray
    child: np.ndarray
    region: np.ndarray
    center: np.ndarray
    axes: np.ndarray
    half: np.ndarray


def build_target_tree(
    points: FloatArray, shapes: IntArray, offsets: IntArray, flat: IntArray, capacity: int
) -> TargetTree:
    """Trees of the nodes ``flat``, as :func:`halve` makes them, with a box for every tree node: around the targets of
    leaves, and around the boxes of the children of others."""
    halves = halve(points, shapes, offsets, flat, capacity, RADIAL_REGION)
    child, filled = halves.child, halves.span[:, 1] > halves.span[:, 0]
    center, axes, half = fit_boxes(points, halves.targets, np.where(child[:, :1] < 0, halves.span, 0))
    # Tree nodes by level, the roots first.
    levels = [np.setdiff1d(np.arange(len(child)), child[child[:, 0] >= 0])]
    while len(levels[-1]):
        levels.append(child[levels[-1][child[levels[-1], 0] >= 0]].ravel())
    for level in reversed(levels[:-1]):
        parents = level[child[level, 0] >= 0]
        one, two = child[parents].T
        # A child without targets has no box.
        one, two = np.where(filled[one], one, two), np.where(filled[two], two, one)
        # The eight corners of both boxes.
        signs = 2.0 * (np.arange(8)[:, None] >> np.arange(3) & 1) - 1.0
        corners = [center[n, None] + (signs * half[n, None]) @ axes[n] for n in (one, two)]
        starts = 16 * np.arange(len(parents))
        places = np.arange(16 * len(parents))
        boxes = fit_boxes(
            np.concatenate(corners, axis=1).reshape(-1, 3), places, np.stack([starts, starts + 16], axis=1)
        )
        center[parents], axes[parents], half[parents] = boxes
    center[~filled], half[~filled] = 0.0, 0.0
    return TargetTree(*halves, center, axes, half)


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


class Targets(NamedTuple):
    """Target nodes in bricks, compact groups that follow the grid's own order, and where each one's accuracy is judged.

    Regions are groups of neighbouring bricks for which the same clusters of sources are far.

    Attributes
    ----------
    points : (n_nodes, 3)
    start : (b + 1,) start of each brick in ``every``
    every : (n,) flat indices of all targets
    bricks : boxes around the targets of each brick
    few : (b,) whether a brick has so few nodes that it needs no interpolation points of its own
    first : (g + 1,) number of each region's first brick
    regions : boxes around the targets and the interpolation points of the bricks of each region
    samples : (b, 9) targets spread over each brick, in the grid's order
    sizes : (b, 9) length of the shortest edge at each sample
    """

    points: np.ndarray
    start: np.ndarray
    every: np.ndarray
    bricks: Boxes
    few: np.ndarray
    first: np.ndarray
    regions: Boxes
    samples: np.ndarray
    sizes: np.ndarray

    @property
    def n_regions(self) -> int:
        return len(self.first) - 1

    def places(self, first: int, last: int) -> slice:
        """Slice of the list of targets that lies in the regions first <= g < last."""
        start, stop = self.start[self.first[[first, last]]]
        return slice(start, stop)

    def flat(self, first: int, last: int) -> IntArray:
        """Flat indices of the targets in the regions first <= g < last."""
        return self.every[self.places(first, last)]


def shape_table(shapes: Shapes) -> IntArray:
    """Block shapes (n_blocks, 3) as the int64 array that the loops expect."""
    return np.asarray(shapes, dtype=np.int64).reshape(-1, 3)


def make_targets(
    points: FloatArray, shapes: Shapes, offsets: IntArray, flat: IntArray, order: int, per_point: int = 8
) -> Targets:
    """Targets ``flat``, ascending, in bricks that hold about ``per_point`` targets per interpolation point, the leaves
    of the trees that :func:`halve` makes, and in regions of about ``REGION`` bricks."""
    shapes = shape_table(shapes)
    halves = halve(points, shapes, offsets, flat, per_point * order**3, REGION)
    every, (_, start, places, sizes) = halves.targets, leaves_of(halves, points, shapes, offsets)
    first = np.searchsorted(start, np.append(halves.span[halves.region, 0], len(every)))
    # Regions without targets have no bricks.
    first = first[np.append(np.diff(first) > 0, True)]
    bricks = make_boxes(*fit_boxes(points, every, spans(start)), order)
    few = np.diff(start) <= 2 * np.diff(bricks.proxy)
    center, axes, half = fit_boxes(bricks.proxies, np.arange(len(bricks.proxies)), spans(bricks.proxy[first]))
    # The boxes enclose the targets too.
    low, high = extents(points, every, spans(start[first]), center, axes)
    regions = make_boxes(center, axes, np.maximum(half, np.maximum(-low, high)), order)
    return Targets(points, start, every, bricks, few, first, regions, every[places], sizes)


def leaves_of(
    tree: Halves | TargetTree, points: FloatArray, shapes: IntArray, offsets: IntArray
) -> tuple[IntArray, IntArray, IntArray, FloatArray]:
    """Leaves (b,) of a tree that hold targets, in the order of these, the start (b + 1,) of each in the list of
    targets, nine positions (b, 9) in that list, spread over each leaf, and the length (b, 9) of the shortest edge at
    the targets there."""
    leaves = np.flatnonzero((tree.child[:, 0] < 0) & (tree.span[:, 1] > tree.span[:, 0]))
    leaves = leaves[np.argsort(tree.span[leaves, 0])]
    start = np.append(tree.span[leaves, 0], len(tree.targets))
    places = start[:-1, None] + (np.arange(_SAMPLES) * (np.diff(start)[:, None] - 1)) // (_SAMPLES - 1)
    sizes = node_sizes(points, shapes, offsets, tree.targets[places].ravel()).reshape(places.shape)
    return leaves, start, places, sizes
