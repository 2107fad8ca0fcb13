"""Sample points of hexahedra, at which their energy is summed."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from ...arrays import FloatArray, IntArray
from ...jit import kernel, record
from .jacobian import determinant, jacobian


@record("i8[::1], i8[:, ::1], f8[:, :, ::1]")
class Samples(NamedTuple):
    """Sample points of the reference cell.

    ``used`` (s,): number of nodes on which the Jacobian matrix there depends; ``node`` (s, m): these nodes; ``slope``
    (s, m, 3): derivatives of their shape functions. The corners come first.
    """

    used: np.ndarray
    node: np.ndarray
    slope: np.ndarray


def cell_samples() -> Samples:
    """The 27 sample points of a hexahedron; node a of it is the corner (a >> 2, a >> 1 & 1, a & 1)."""
    corners = list(itertools.product((0.0, 1.0), repeat=3))
    points = corners + [p for p in itertools.product((0.0, 0.5, 1.0), repeat=3) if 0.5 in p]
    shape = len(points), len(corners)
    count, node, slope = np.zeros(shape[0], np.int64), np.zeros(shape, np.int64), np.zeros((*shape, 3))
    for s, point in enumerate(points):
        slopes = np.zeros((len(corners), 3))
        for a, corner in enumerate(corners):
            factor = [x if c else 1.0 - x for c, x in zip(corner, point, strict=True)]
            for axis in range(3):
                rest = np.prod([f for other, f in enumerate(factor) if other != axis])
                slopes[a, axis] = rest if corner[axis] else -rest
        used = np.flatnonzero(slopes.any(axis=1))
        count[s], node[s, : used.size], slope[s, : used.size] = used.size, used, slopes[used]
    return Samples(count, node, slope)


def samples_with_any(chosen: np.ndarray, samples: Samples) -> np.ndarray:
    """Sample points that depend on any ``chosen`` (m, 8) corner of their cell: (m,) int64, bit s for sample point s."""
    mask = np.zeros(len(chosen), dtype=np.int64)
    for s, (used, node) in enumerate(zip(samples.used, samples.node, strict=True)):
        mask |= chosen[:, node[:used]].any(axis=1).astype(np.int64) << s
    return mask


@kernel("f8[:, ::1], i8[:, ::1], Samples, f8[::1], f8", Samples)
def sound_samples(start, cells, samples, sign, tolerance):
    """Sample points at which undeformed cells are sound: (m,) int64, bit s for sample point s.

    Sound means that the determinant has the ``sign`` (m,) of the cell and exceeds ``tolerance`` times the product of
    the edges.
    """
    count, node, slope = samples
    e = np.empty((3, 3))
    mask = np.zeros(len(cells), dtype=np.int64)
    for c in range(len(cells)):
        for s in range(count.size):
            jacobian(start, cells[c], count[s], node[s], slope[s], e)
            size = 1.0
            for k in range(3):
                size *= np.sqrt(e[0, k] * e[0, k] + e[1, k] * e[1, k] + e[2, k] * e[2, k])
            if sign[c] * determinant(e) > tolerance * size:
                mask[c] |= 1 << s
    return mask


def shortest_edges(start: FloatArray, cells: IntArray, pairs: IntArray) -> FloatArray:
    """Length (n,) of the shortest edge at every node of ``start`` (n, d), edges of zero length ignored.

    The edges join the ``pairs`` (p, 2) of corners of each of the ``cells`` (m, k).
    """
    one, two = np.moveaxis(cells[:, pairs], -1, 0)
    length = np.sqrt(((start[one] - start[two]) ** 2).sum(axis=-1))
    result = np.full(len(start), np.inf)
    for ends in (one, two):
        np.minimum.at(result, ends, np.where(length > 0.0, length, np.inf))
    return result
