"""Sets of boundary nodes or faces as rectangles of nodes on block faces."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.grid import IntArray, Shape, Side, Window
from meshdeform_core.grid.windows import windows_of_quads


def window_of_range(shape: Shape, block: int, low: Sequence[int], high: Sequence[int]) -> Window | None:
    """The window of the nodes ``low`` .. ``high`` (i, j, k, 0-based, inclusive), or ``None`` if not on a block face.

    The range must be constant along one index axis of more than one node, at its first or last node.
    """
    constant = [axis for axis in range(3) if low[axis] == high[axis] and shape[axis] > 1]
    if len(constant) != 1 or low[constant[0]] not in (0, shape[constant[0]] - 1):
        return None
    axis = constant[0]
    side = Side(2 * axis + (low[axis] > 0))
    a, b = side.tangential
    return Window(block, side, (low[a], low[b]), (high[a], high[b]))


def windows_of_nodes(shape: Shape, block: int, nodes: IntArray) -> tuple[list[Window], int]:
    """Windows of the block faces' quads whose corners are all among ``nodes`` ``(n, 3)`` (0-based), as rectangles.

    Also returns the number of nodes that belong to none of them.
    """
    windows: list[Window] = []
    unused = np.ones(len(nodes), bool)
    for side in _sides(shape):
        a, b = side.tangential
        on_side = nodes[:, side.axis] == side.layer(shape)
        member = np.zeros((shape[a], shape[b]), bool)
        member[nodes[on_side, a], nodes[on_side, b]] = True
        quads = _quads(member)
        windows += windows_of_quads(shape, block, side, quads)
        unused[on_side] &= ~_corners(quads, member.shape)[nodes[on_side, a], nodes[on_side, b]]
    return windows, int(unused.sum())


def _sides(shape: Shape) -> list[Side]:
    return [side for side in Side if shape[side.axis] > 1]


def _quads(member: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Quads (edges in a 2-D grid) all of whose corners are members."""
    for axis in (0, 1):
        if member.shape[axis] > 1:
            member = member.take(range(1, member.shape[axis]), axis) & member.take(range(member.shape[axis] - 1), axis)
    return member


def _corners(quads: NDArray[np.bool_], shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Nodes that are a corner of a marked quad."""
    corners = np.zeros(shape, bool)
    more = [range(n - m + 1) for n, m in zip(shape, quads.shape, strict=True)]
    for i in more[0]:
        for j in more[1]:
            corners[i : i + quads.shape[0], j : j + quads.shape[1]] |= quads
    return corners
