"""Which of many faces have overlapping boxes: a tree along a space-filling curve.

The tree is built once, from the undeformed faces. For every displacement only the boxes are recomputed, from the leaves
to the root, and the tree is traversed against itself.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..arrays import BoolArray, FloatArray, IntArray, KeyArray
from ..jit import kernel

_LEAF = 8
# Stack of node pairs, sufficient for a tree of 2^60 leaves.
_DEPTH = 256

ORDINARY, BESIDE, SLIDING = 0, 1, 2
"""Roles of faces. Faces beside a sliding face touch it; they are not tested against sliding faces."""


class FaceTree:
    """A balanced tree over faces.

    Parameters
    ----------
    points : (n, 3) undeformed nodes; the tree remains efficient as long as neighbours in space remain neighbours
    faces : (m, 4) int64 nodes, m >= 1; triangles repeat a node
    role : (m,) int8, ``ORDINARY``, ``BESIDE`` or ``SLIDING``
    """

    def __init__(self, points: FloatArray, faces: IntArray, role: NDArray[np.int8]):
        center = points[faces[:, 0]]
        for corner in faces.T[1:]:
            center += points[corner]
        center /= 4.0
        self._order = _curve(center)
        self._faces, self._role = faces[self._order], role[self._order]
        self._leaves = 1 << max(0, int(len(faces) - 1).bit_length() - (_LEAF.bit_length() - 1))

    def overlapping(self, points: FloatArray, asked: BoolArray, margin: FloatArray | None = None) -> IntArray:
        """Pairs of faces with overlapping boxes and no common node, at least one of which is ``asked``.

        Parameters
        ----------
        points : (n, 3) nodes
        asked : (m,) bool
        margin : (m,) by which the box of a face is larger than the face; none by default

        Returns
        -------
        pairs : (c, 2) int64, the smaller number first; rows are not sorted
        """
        count, some = len(self._faces), asked[self._order]
        wider = np.zeros(count) if margin is None else margin[self._order]
        box, tree = np.empty((count, 6)), np.empty((2 * self._leaves, 6))
        active = np.zeros(2 * self._leaves, dtype=np.bool_)
        _fit(points, self._faces, some, wider, box, tree, active)
        capacity = count
        while True:
            pairs = np.empty((capacity, 2), dtype=np.int64)
            found = _descend(self._faces, self._role, self._order, some, box, tree, active, pairs)
            if found <= capacity:
                return pairs[:found]
            capacity = found


def _curve(center: FloatArray) -> IntArray:
    """Order of points along a space-filling (Morton) curve, on a lattice refined where points are dense.

    Overwrites ``center``.
    """
    key = center
    key -= np.median(center, axis=0)
    key /= 1e-3 * max(float(np.median(np.maximum(key.max(axis=1), -key.min(axis=1)))), 1e-300)
    np.arcsinh(key, out=key)
    key -= key.min(axis=0)
    most = max(float(key.max()), 1e-300)
    key *= (1 << 21) - 1
    key /= most
    return np.argsort(_morton(key.astype(np.uint64)))


def _morton(index: KeyArray) -> KeyArray:
    """Bits of three numbers (n, 3) below 2^21 interleaved."""
    key = np.zeros(len(index), dtype=np.uint64)
    for axis in range(3):
        x = index[:, axis]
        for shift, mask in (
            (32, 0x1F00000000FFFF), (16, 0x1F0000FF0000FF), (8, 0x100F00F00F00F00F), (4, 0x10C30C30C30C30C3),
            (2, 0x1249249249249249),
        ):  # fmt: skip
            x = (x | x << np.uint64(shift)) & np.uint64(mask)
        key |= x << np.uint64(axis)
    return key


@kernel
def _fit(points, faces, asked, margin, box, tree, active):
    """Fill the boxes (low x, y, z, high x, y, z) of faces and tree nodes; mark the nodes with a face that is asked."""
    leaves = tree.shape[0] // 2
    for node in range(tree.shape[0]):
        for axis in range(3):
            tree[node, axis], tree[node, 3 + axis] = np.inf, -np.inf
    for face in range(faces.shape[0]):
        leaf = leaves + face // _LEAF
        active[leaf] |= asked[face]
        for axis in range(3):
            low = high = points[faces[face, 0], axis]
            for corner in range(1, 4):
                x = points[faces[face, corner], axis]
                low, high = min(low, x), max(high, x)
            low, high = low - margin[face], high + margin[face]
            box[face, axis], box[face, 3 + axis] = low, high
            tree[leaf, axis], tree[leaf, 3 + axis] = min(tree[leaf, axis], low), max(tree[leaf, 3 + axis], high)
    for node in range(leaves - 1, 0, -1):
        one, two = 2 * node, 2 * node + 1
        active[node] = active[one] or active[two]
        for axis in range(3):
            tree[node, axis] = min(tree[one, axis], tree[two, axis])
            tree[node, 3 + axis] = max(tree[one, 3 + axis], tree[two, 3 + axis])


@kernel
def _descend(faces, role, order, asked, box, tree, active, pairs):
    """Find pairs of leaves by descending through pairs of tree nodes, from the root with itself."""
    leaves = tree.shape[0] // 2
    stack = np.empty((_DEPTH, 2), dtype=np.int64)
    stack[0, 0] = stack[0, 1] = 1
    # Typed: a literal would compile a second signature of the leaf.
    depth, count = 1, np.int64(0)
    while depth:
        depth -= 1
        a, b = stack[depth, 0], stack[depth, 1]
        if not (active[a] or active[b]) or _apart(tree, a, tree, b):
            continue
        if a >= leaves:
            count = _leaf(faces, role, order, asked, box, tree, a - leaves, b - leaves, count, pairs)
            continue
        for one in range(2 * a, 2 * a + 2):
            for two in range(max(one, 2 * b), 2 * b + 2):
                stack[depth, 0], stack[depth, 1] = one, two
                depth += 1
    return count


@kernel
def _leaf(faces, role, order, asked, box, tree, a, b, count, pairs):
    """Pairs of faces of two leaves, or within one leaf."""
    leaves, last = tree.shape[0] // 2, min((b + 1) * _LEAF, faces.shape[0])
    for i in range(a * _LEAF, min((a + 1) * _LEAF, faces.shape[0])):
        if _apart(box, i, tree, leaves + b):
            continue
        for j in range(i + 1 if a == b else b * _LEAF, last):
            if not (asked[i] or asked[j]) or _apart(box, i, box, j) or role[i] + role[j] == BESIDE + SLIDING:
                continue
            if _share(faces[i], faces[j]):
                continue
            if count < pairs.shape[0]:
                one, two = order[i], order[j]
                pairs[count, 0], pairs[count, 1] = min(one, two), max(one, two)
            count += 1
    return count


@kernel
def _apart(some, one, others, two):
    apart = False
    for axis in range(3):
        apart |= some[one, axis] > others[two, 3 + axis] or others[two, axis] > some[one, 3 + axis]
    return apart


@kernel
def _share(one, two):
    for a in range(4):
        for b in range(4):
            if one[a] == two[b]:
                return True
    return False
