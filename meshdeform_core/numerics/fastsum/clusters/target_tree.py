"""Trees of target nodes, built by halving ranges of block indices instead of sorting nodes in space."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...arrays import FloatArray, IntArray
from ...jit import kernel
from ...pieces import pieces
from ..tuned import RADIAL_REGION
from .boxes import fit_boxes
from .bricks import list_targets, longest_side


class TargetTree(NamedTuple):
    """Binary trees over the targets of parts of the grid (regions).

    Nodes of the trees are numbered so that parents come before their children.

    Attributes
    ----------
    targets : (n,) flat node indices of the grid; those below a tree node are contiguous
    span : (m, 2) first and one past the last target below each tree node
    child : (m, 2) children of each tree node, -1 for leaves and for parts without targets
    region : (g + 1,) first tree node of each region, its root
    center, axes, half : (m, 3), (m, 3, 3), (m, 3) boxes along principal axes
    """

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
    """Trees of the nodes ``flat`` (n,), ascending, of a grid, with leaves of at most about ``capacity`` targets.

    Index ranges are halved along the direction in which they are longest in space, so that leaves are compact although
    cells are stretched. No tree extends beyond a piece of a block (:mod:`...pieces`), so trees do not depend on which
    other parts of the grid are evaluated, or held by this rank.
    """
    none, pairs = np.empty(0, np.int64), np.empty((0, 2), np.int64)
    parts = [(none, pairs, pairs, none)]
    used = nodes = 0
    block, low, high = pieces(shapes).T
    rows = offsets[block] + np.stack([low, high]) * shapes[block, 1:].prod(axis=1)
    ends = np.searchsorted(flat, rows)
    for number in np.flatnonzero(ends[1] > ends[0]).tolist():
        (lo, hi), own = rows[:, number], flat[slice(*ends[:, number])]
        shape = (high[number] - low[number], *shapes[block[number], 1:])
        mask = np.zeros(hi - lo, dtype=bool)
        mask[own - lo] = True
        volume = capacity * mask.size / len(own)
        x = points[lo:hi].reshape(*shape, 3)
        targets, span, child, roots = _cut(x, mask.reshape(shape), len(own), volume, RADIAL_REGION)
        parts.append((targets + lo, span + used, np.where(child >= 0, child + nodes, -1), roots + nodes))
        used, nodes = used + len(targets), nodes + len(span)
    targets, span, child, roots = (np.concatenate(each) for each in zip(*parts, strict=True))
    return TargetTree(targets, span, child, np.append(roots, nodes), *_fit(points, targets, span, child))


@kernel
def _cut(x, mask, count, capacity, region):
    """Targets, spans, children and roots of one block."""
    # Per box: first and last index along each axis, and its tree node, -1 outside regions.
    box = np.empty((4096, 7), dtype=np.int64)
    at, previous = np.empty(3, dtype=np.int64), np.empty(3)
    box[0, 0] = box[0, 2] = box[0, 4] = 0
    (box[0, 1], box[0, 3], box[0, 5]), box[0, 6] = mask.shape, -1
    depth, used, nodes, regions = 1, 0, 0, 0
    limit = 64 + int(4 * mask.size / max(capacity, 1.0)) * 2
    targets, roots = np.empty(count, dtype=np.int64), np.empty(limit, dtype=np.int64)
    span, child = np.zeros((limit, 2), dtype=np.int64), np.full((limit, 2), -1)
    while depth:
        depth -= 1
        b = box[depth].copy()
        size = (b[1] - b[0]) * (b[3] - b[2]) * (b[5] - b[4])
        if b[6] < 0 and size <= region * capacity:
            b[6] = roots[regions] = nodes
            nodes, regions = nodes + 1, regions + 1
        if size > capacity:
            axis = longest_side(x, b, at, previous)
            middle = (b[2 * axis] + b[2 * axis + 1]) // 2
            box[depth] = box[depth + 1] = b
            box[depth + 1, 2 * axis + 1] = middle
            box[depth, 2 * axis] = middle
            if b[6] >= 0:
                box[depth + 1, 6], box[depth, 6] = nodes, nodes + 1
                child[b[6]] = nodes, nodes + 1
                nodes += 2
            depth += 2
            continue
        span[b[6], 0] = used
        used = list_targets(mask, b, targets, used)
        span[b[6], 1] = used
    for n in range(nodes - 1, -1, -1):
        if child[n, 0] >= 0:
            span[n, 0], span[n, 1] = span[child[n, 0], 0], span[child[n, 1], 1]
    return targets, span[:nodes].copy(), child[:nodes].copy(), roots[:regions].copy()


def _fit(
    points: FloatArray, targets: IntArray, span: IntArray, child: IntArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Boxes of all tree nodes: around the targets of leaves, and around the boxes of the children of other nodes."""
    center, axes, half = fit_boxes(points, targets, np.where(child[:, :1] < 0, span, 0))
    filled = span[:, 1] > span[:, 0]
    for level in reversed(_levels(child)):
        one, two = child[level[child[level, 0] >= 0]].T
        parents = level[child[level, 0] >= 0]
        # A child without targets has no box.
        one, two = np.where(filled[one], one, two), np.where(filled[two], two, one)
        corners = np.concatenate([_corners(center[n], axes[n], half[n]) for n in (one, two)], axis=1)
        starts = 16 * np.arange(len(parents))
        places = np.arange(16 * len(parents))
        boxes = fit_boxes(corners.reshape(-1, 3), places, np.stack([starts, starts + 16], axis=1))
        center[parents], axes[parents], half[parents] = boxes
    center[~filled], half[~filled] = 0.0, 0.0
    return center, axes, half


def _levels(child: IntArray) -> list[IntArray]:
    """Tree nodes by level, the roots first."""
    inner = child[child[:, 0] >= 0]
    level = np.setdiff1d(np.arange(len(child)), inner)
    levels = []
    while len(level):
        levels.append(level)
        level = child[level[child[level, 0] >= 0]].ravel()
    return levels


def _corners(center: FloatArray, axes: FloatArray, half: FloatArray) -> FloatArray:
    """The eight corners (m, 8, 3) of boxes."""
    signs = 2.0 * (np.arange(8)[:, None] >> np.arange(3) & 1) - 1.0
    return center[:, None] + (signs * half[:, None]) @ axes
