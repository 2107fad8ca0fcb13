"""Sample points of cells, at which their energy is summed, and the maps there from the undeformed cells."""

from __future__ import annotations

import itertools
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ...arrays import BoolArray, FloatArray, IntArray


@lru_cache
def sample_slopes(dimension: int) -> FloatArray:
    """Derivatives (27, 8, 3) of the shape functions of a hexahedron's nodes at its sample points along the index axes;
    node a of it is the corner (a >> 2, a >> 1 & 1, a & 1). The corners come first. Those (4, 4, 2) of a quadrilateral's
    nodes at its corners."""
    corners = list(itertools.product((0.0, 1.0), repeat=dimension))
    middles = [p for p in itertools.product((0.0, 0.5, 1.0), repeat=dimension) if 0.5 in p and dimension == 3]
    slope = np.empty((len(corners) + len(middles), len(corners), dimension))
    for s, point in enumerate(corners + middles):
        for a, corner in enumerate(corners):
            factor = [x if c else 1.0 - x for c, x in zip(corner, point, strict=True)]
            for axis in range(dimension):
                rest = np.prod(factor[:axis] + factor[axis + 1 :])
                slope[s, a, axis] = rest if corner[axis] else -rest
    return slope


def sound_samples(start: FloatArray, cells: IntArray, sign: FloatArray, tolerance: float, moves: BoolArray) -> IntArray:
    """Sample points at which undeformed ``cells`` are sound and that depend on a node that ``moves`` (n,): (m,) int64,
    bit s for sample point s.

    Sound means that the determinant has the ``sign`` (m,) of the cell and exceeds ``tolerance`` times the product of
    the lengths of the vectors along the index axes.
    """
    mask, corners = np.zeros(len(cells), dtype=np.int64), np.ascontiguousarray(cells.T)
    for s, slope in enumerate(sample_slopes(start.shape[1])):
        edges = sums_of_slopes(start, corners, slope[:, :, None])
        size = np.sqrt((edges * edges).sum(axis=0).prod(axis=0))
        sound = sign * (edges[0] * cofactors(edges)[0]).sum(axis=0) > tolerance * size
        mask |= (sound & moves[cells[:, slope.any(axis=1)]].any(axis=1)).astype(np.int64) << s
    return mask


class Maps(NamedTuple):
    """Maps from undeformed cells at m samples.

    Attributes
    ----------
    nodes : (k, m) nodes of which they are functions
    slope : (k, d, m) gradients of the shape functions of these nodes in the undeformed grid
    cell : (m,) the cell of each, ascending
    at_corners : whether the samples are corners
    """

    nodes: IntArray
    slope: FloatArray
    cell: IntArray
    at_corners: bool = True

    def jacobians(self, x: FloatArray) -> FloatArray:
        """Jacobian matrices (d, d, m) for coordinates ``x`` (n, d)."""
        return sums_of_slopes(x, self.nodes, self.slope)

    def on_nodes(self, force: FloatArray, n: int) -> FloatArray:
        """Forces (n, d) on the nodes for those on the matrices (d, d, m): the transpose of :meth:`jacobians`."""
        parts = ((row * self.slope).sum(axis=1) for row in force)
        return np.stack([np.bincount(self.nodes.ravel(), part.ravel(), n) for part in parts], axis=1)


def maps_at_sample(start: FloatArray, nodes: IntArray, slope: FloatArray, sample: int, cell: IntArray) -> Maps:
    """The maps of the cells with numbers ``cell`` (m,) at a sample point, where all must be sound; ``nodes``: the rows
    of the corners of all cells in ``start`` (n, d)."""
    used = slope[sample].any(axis=1)
    along = slope[sample][used, :, None]
    corners = np.ascontiguousarray(nodes[cell][:, used].T)
    edges = sums_of_slopes(start, corners, along)
    areas = cofactors(edges)
    # The rows of the inverse of the matrix of the edges.
    dual = (areas / (edges[0] * areas[0]).sum(axis=0)).transpose(1, 0, 2)
    in_space = np.asarray(sum(along[:, k, None] * row for k, row in enumerate(dual)))
    return Maps(corners, in_space, cell, sample < nodes.shape[1])


def sums_of_slopes(x: FloatArray, nodes: IntArray, slope: FloatArray) -> FloatArray:
    """Sums (d, d, m) over nodes (k, m) of their coordinates ``x`` (n, d) times ``slope`` (k, d, m) or (k, d, 1)."""
    total = np.zeros((x.shape[1], *np.broadcast_shapes(slope.shape[1:], (1, nodes.shape[1]))))
    for node, along in zip(nodes, slope, strict=True):
        # Indexing with arrays takes seven times as long as np.take, products of columns of rows twice as long.
        total += np.ascontiguousarray(np.take(x, node, axis=0).T)[:, None] * along
    return total


def inner(a: FloatArray, b: FloatArray) -> FloatArray:
    """The sums (m,) of the products of the entries of matrices (d, d, m)."""
    return np.asarray((a * b).sum(axis=(0, 1)))


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


def cell_edges(start: FloatArray, cells: IntArray) -> tuple[IntArray, FloatArray]:
    """Both end nodes (m, e, 2) and the lengths (m, e) of the edges of ``cells`` (m, 2^d) with coordinates (n, d)."""
    n = cells.shape[1]
    ends = cells[:, [(one, one | bit) for one in range(n) for bit in (1, 2, 4) if not one & bit and bit < n]]
    return ends, np.sqrt(((start[ends[..., 1]] - start[ends[..., 0]]) ** 2).sum(axis=2))
