"""Which pairs of clusters of a tree interact by their skeletons (far), and which leaves directly (near)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...arrays import FloatArray
from ...jit import kernel
from ..clusters.tree import SourceTree
from ..tuned import REACH

_STACK = 4096


class Interactions(NamedTuple):
    """Which clusters act on which: ``far[far_start[t] : far_start[t + 1]]`` on cluster ``t``; likewise ``near``."""

    far_start: np.ndarray
    far: np.ndarray
    near_start: np.ndarray
    near: np.ndarray


def find_interactions(tree: SourceTree, radius: FloatArray, compact: bool) -> Interactions:
    """:class:`Interactions` of all clusters."""
    none = np.empty(0, dtype=np.int64)
    counts = np.zeros((2, len(radius)), dtype=np.int64)
    _meet(tree.boxes.center, radius, tree.child, REACH, compact, counts, False, none, none)
    starts = [np.append(0, np.cumsum(count)) for count in counts]
    far, near = (np.empty(start[-1], dtype=np.int64) for start in starts)
    places = np.stack([start[:-1] for start in starts])
    _meet(tree.boxes.center, radius, tree.child, REACH, compact, places, True, far, near)
    return Interactions(starts[0], far, starts[1], near)


@kernel("f8[:, ::1], f8[::1], i8[::1], f8, b1, i8[:, ::1], b1, i8[::1], i8[::1]")
def _meet(center, radius, child, reach, compact, places, fill, far, near):
    """Traverse pairs of clusters from the root; count the partners of each in ``places`` (2, m), or with ``fill`` store
    them from these positions on."""
    stack = np.empty((_STACK, 2), dtype=np.int64)
    stack[0] = 0
    depth = 1
    while depth:
        depth -= 1
        a, b = stack[depth]
        if a == b:
            if child[a] < 0:
                _join(1, a, b, places, fill, near)
                continue
            c = child[a]
            stack[depth], stack[depth + 1] = c, c + 1
            stack[depth + 2, 0], stack[depth + 2, 1] = c, c + 1
            depth += 3
            continue
        d = np.sqrt(((center[a] - center[b]) ** 2).sum())
        if compact and d - radius[a] - radius[b] >= 1.0:
            continue
        apart = d - radius[b] >= reach * radius[a] and d - radius[a] >= reach * radius[b]
        if apart and not (compact and d + radius[a] + radius[b] > 1.0):
            _join(0, a, b, places, fill, far)
        elif child[a] < 0 and child[b] < 0:
            _join(1, a, b, places, fill, near)
        else:
            if child[a] < 0 or (child[b] >= 0 and radius[b] > radius[a]):
                a, b = b, a
            for k in range(2):
                stack[depth, 0], stack[depth, 1] = child[a] + k, b
                depth += 1


@kernel
def _join(which, a, b, places, fill, partners):
    if fill:
        partners[places[which, a]] = b
    places[which, a] += 1
    if a != b:
        if fill:
            partners[places[which, b]] = a
        places[which, b] += 1
