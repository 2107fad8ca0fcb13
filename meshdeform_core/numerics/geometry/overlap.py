"""Which of many boxes overlap: a tree of boxes in the order of a space-filling curve."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..arrays import BoolArray, FloatArray, IntArray, KeyArray
from ..jit import kernel

_LEAF, _DEPTH = 8, 64

ORDINARY, BESIDE, SLIDING = 0, 1, 2
"""Roles of faces: those beside a sliding face touch it and are not tested against any sliding one."""


def close_pairs(
    faces: IntArray, low: FloatArray, high: FloatArray, asked: BoolArray, role: NDArray[np.int8]
) -> IntArray:
    """Pairs of faces, at least one of them ``asked``, whose boxes overlap and that have no node in common.

    Parameters
    ----------
    faces : (m, 4) int64 nodes
    low, high : (m, 3) corners of the boxes
    asked : (m,) bool
    role : (m,) int8, ``ORDINARY``, ``BESIDE`` or ``SLIDING``

    Returns
    -------
    pairs : (c, 2) int64, the smaller number first, in no order
    """
    order, box = _box_tree(low, high)
    capacity = 4 * len(faces)
    while True:
        pairs = np.empty((capacity, 2), dtype=np.int64)
        count = _search(faces, asked, role, low, high, order, box, pairs)
        if count <= capacity:
            return pairs[:count]
        capacity = count


def _box_tree(low: FloatArray, high: FloatArray) -> tuple[IntArray, FloatArray]:
    """Balanced tree over boxes: their order (padded with -1), and the boxes (2 p, 6) of its nodes.

    Node 1 is the root, 2 n and 2 n + 1 are the children of n, and leaf p + l holds the boxes ``_LEAF`` l and following.
    The order is that of a space-filling (Morton) curve, with coordinates that are finer where most faces are.
    """
    center = 0.5 * (low + high)
    away = center - np.median(center, axis=0)
    fine = 1e-3 * max(float(np.median(np.abs(away).max(axis=1))), 1e-300)
    key = np.arcsinh(away / fine)
    key -= key.min(axis=0)
    order = np.argsort(_morton((key * ((1 << 21) - 1) / max(float(key.max()), 1e-300)).astype(np.uint64)))
    leaves = 1 << max(0, int(len(order) - 1).bit_length() - (_LEAF.bit_length() - 1))
    padded = np.full(leaves * _LEAF, -1, dtype=np.int64)
    padded[: len(order)] = order
    box = np.empty((2 * leaves, 6))
    box[leaves:] = np.repeat([[np.inf] * 3 + [-np.inf] * 3], leaves, axis=0)
    leaf = np.where(padded >= 0, padded, 0).reshape(leaves, _LEAF)
    empty = (padded < 0).reshape(leaves, _LEAF, 1)
    box[leaves:, :3] = np.where(empty, np.inf, low[leaf]).min(axis=1)
    box[leaves:, 3:] = np.where(empty, -np.inf, high[leaf]).max(axis=1)
    while leaves > 1:
        children = box[leaves : 2 * leaves].reshape(-1, 2, 6)
        leaves //= 2
        box[leaves : 2 * leaves, :3] = children[:, :, :3].min(axis=1)
        box[leaves : 2 * leaves, 3:] = children[:, :, 3:].max(axis=1)
    return padded, box


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
def _search(faces, asked, role, low, high, order, box, pairs):
    count = 0
    leaves = box.shape[0] // 2
    stack = np.empty(_DEPTH, dtype=np.int64)
    for one in range(faces.shape[0]):
        if not asked[one]:
            continue
        stack[0] = 1
        depth = 1
        while depth:
            depth -= 1
            current = stack[depth]
            if _apart(low[one], high[one], box[current, :3], box[current, 3:]):
                continue
            if current < leaves:
                stack[depth], stack[depth + 1] = 2 * current, 2 * current + 1
                depth += 2
                continue
            for slot in range((current - leaves) * _LEAF, (current - leaves + 1) * _LEAF):
                two = order[slot]
                if two < 0 or two == one or (asked[two] and two < one) or role[one] + role[two] == BESIDE + SLIDING:
                    continue
                if _apart(low[one], high[one], low[two], high[two]) or _share(faces[one], faces[two]):
                    continue
                if count < pairs.shape[0]:
                    pairs[count, 0], pairs[count, 1] = min(one, two), max(one, two)
                count += 1
    return count


@kernel
def _apart(low, high, other_low, other_high):
    apart = False
    for axis in range(3):
        apart |= low[axis] > other_high[axis] or other_low[axis] > high[axis]
    return apart


@kernel
def _share(one, two):
    for a in range(4):
        for b in range(4):
            if one[a] == two[b]:
                return True
    return False
