"""Bricks and regions of target nodes, built once per undeformed grid; :mod:`.tree` does the same for sources."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ....parallel import Nodes
from ...arrays import FloatArray, IntArray
from ..tuned import REGION
from .boxes import Boxes, extents, fit_boxes, make_boxes
from .target_tree import halve


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
    return make_bricks(points, start, halves.targets, order), first


def make_bricks(points: FloatArray, start: IntArray, targets: IntArray, order: int) -> Bricks:
    """Bricks of ``targets`` that begin at ``start`` (b + 1,), with up to ``order`` interpolation points per side."""
    return Bricks(start, targets, make_boxes(*fit_boxes(points, targets, spans(start)), order))


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
