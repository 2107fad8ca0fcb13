"""Sample points of hexahedra, at which their energy is summed, and maps of elements at samples."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from ...arrays import FloatArray, IntArray

CORNERS, SAMPLES = 8, 27
"""Numbers of sample points of a hexahedron: the corners come first."""


def sample_slopes() -> FloatArray:
    """Derivatives (27, 8, 3) of the shape functions of a hexahedron's nodes at its sample points along the index axes;
    node a of it is the corner (a >> 2, a >> 1 & 1, a & 1)."""
    corners = list(itertools.product((0.0, 1.0), repeat=3))
    points = corners + [p for p in itertools.product((0.0, 0.5, 1.0), repeat=3) if 0.5 in p]
    slope = np.empty((SAMPLES, CORNERS, 3))
    for s, point in enumerate(points):
        for a, corner in enumerate(corners):
            factor = [x if c else 1.0 - x for c, x in zip(corner, point, strict=True)]
            for axis in range(3):
                rest = np.prod(factor[:axis] + factor[axis + 1 :])
                slope[s, a, axis] = rest if corner[axis] else -rest
    return slope


def samples_with_any(chosen: np.ndarray, slope: FloatArray) -> np.ndarray:
    """Sample points that depend on any ``chosen`` (m, 8) corner of their cell: (m,) int64, bit s for sample point s."""
    mask = np.zeros(len(chosen), dtype=np.int64)
    for s in range(SAMPLES):
        mask |= chosen[:, slope[s].any(axis=1)].any(axis=1).astype(np.int64) << s
    return mask


def sound_samples(
    start: FloatArray, cells: IntArray, slope: FloatArray, sign: FloatArray, tolerance: float
) -> IntArray:
    """Sample points at which undeformed cells are sound: (m,) int64, bit s for sample point s.

    Sound means that the determinant has the ``sign`` (m,) of the cell and exceeds ``tolerance`` times the product of
    the lengths of the vectors along the index axes.
    """
    mask, corners = np.zeros(len(cells), dtype=np.int64), np.ascontiguousarray(cells.T)
    for s in range(SAMPLES):
        edges = sums_of_slopes(start, corners, slope[s][:, :, None])
        size = np.sqrt((edges * edges).sum(axis=0).prod(axis=0))
        mask |= (sign * determinants(edges) > tolerance * size).astype(np.int64) << s
    return mask


class Maps(NamedTuple):
    """Maps from undeformed elements at m samples.

    Attributes
    ----------
    nodes : (k, m) nodes of which they are functions
    slope : (k, d, m) gradients of the shape functions of these nodes in the undeformed grid
    element : (m,) the element of each, at most once
    at_corners : whether the samples are corners
    """

    nodes: IntArray
    slope: FloatArray
    element: IntArray
    at_corners: bool = True

    def jacobians(self, x: FloatArray) -> FloatArray:
        """Jacobian matrices (d, d, m) for coordinates ``x`` (n, d)."""
        return sums_of_slopes(x, self.nodes, self.slope)

    def on_nodes(self, force: FloatArray, n: int) -> FloatArray:
        """Forces (n, d) on the nodes for those on the matrices (d, d, m): the transpose of :meth:`jacobians`."""
        parts = ((row * self.slope).sum(axis=1) for row in force)
        return np.stack([np.bincount(self.nodes.ravel(), part.ravel(), n) for part in parts], axis=1)


def maps_at_sample(start: FloatArray, nodes: IntArray, slope: FloatArray, sample: int, element: IntArray) -> Maps:
    """The maps of hexahedra ``element`` (m,) at a sample point, where all must be sound; ``nodes`` (m, 8): the
    rows of their corners in ``start`` (n, 3)."""
    used = slope[sample].any(axis=1)
    along = slope[sample][used, :, None]
    corners = np.ascontiguousarray(nodes[element][:, used].T)
    edges = sums_of_slopes(start, corners, along)
    areas = cofactors(edges)
    # The rows of the inverse of the matrix of the edges.
    dual = (areas / (edges[0] * areas[0]).sum(axis=0)).transpose(1, 0, 2)
    in_space = along[:, 0, None] * dual[0] + along[:, 1, None] * dual[1] + along[:, 2, None] * dual[2]
    return Maps(corners, in_space, element, sample < CORNERS)


def sums_of_slopes(x: FloatArray, nodes: IntArray, slope: FloatArray) -> FloatArray:
    """Sums (d, d, m) over nodes (k, m) of their coordinates ``x`` (n, d) times ``slope`` (k, d, m) or (k, d, 1)."""
    # Indexing with arrays takes seven times as long as np.take.
    total = np.take(x, nodes[0], axis=0).T[:, None] * slope[0]
    for node, along in zip(nodes[1:], slope[1:], strict=True):
        total += np.take(x, node, axis=0).T[:, None] * along
    return np.asarray(total)


def inner(a: FloatArray, b: FloatArray) -> FloatArray:
    """The sums (m,) of the products of the entries of matrices (d, d, m)."""
    return np.asarray((a * b).sum(axis=(0, 1)))


def determinants(a: FloatArray) -> FloatArray:
    """Determinants (m,) of matrices (d, d, m)."""
    return np.asarray((a[0] * cofactors(a)[0]).sum(axis=0))


def cofactors(a: FloatArray) -> FloatArray:
    """Cofactors of matrices (d, d, m): the derivative of the determinant."""
    if len(a) == 2:
        return np.array([[a[1, 1], -a[1, 0]], [-a[0, 1], a[0, 0]]])
    return _cross_products(a, a)


def turned_cofactors(a: FloatArray, change: FloatArray) -> FloatArray:
    """The change of the cofactors of matrices (d, d, m) for a ``change`` of them."""
    if len(a) == 2:
        return cofactors(change)
    return _cross_products(change, a) + _cross_products(a, change)


def _cross_products(a: FloatArray, b: FloatArray) -> FloatArray:
    """The cross products of the rows (2, 3), (3, 1) and (1, 2) of ``a`` and ``b`` (3, 3, m), as rows."""
    found = np.empty_like(a)
    for i, m, n in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        for j, p, q in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            np.subtract(a[m, p] * b[n, q], a[m, q] * b[n, p], out=found[i, j])
    return found


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
