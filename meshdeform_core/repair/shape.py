"""The shape of cells: f_skew, over the corners that a repair can change."""

from __future__ import annotations

import numpy as np

from ..grid import FloatArray, IntArray

# Elements above this part of their undeformed f_skew have nearly kept their shape.
_KEPT = 0.9


def hexahedron_shapes(x: FloatArray, nodes: IntArray, mask: IntArray) -> FloatArray:
    """f_skew (m,) of hexahedra over some of their corners; 1 without any.

    Parameters
    ----------
    x : (n, 3) coordinates
    nodes : (m, 8), node a of a cell is the corner (a >> 2, a >> 1 & 1, a & 1)
    mask : (m,) int64, bit a set where corner a counts; the cell is valid there
    """
    total, count = np.zeros(len(nodes)), np.zeros(len(nodes))
    for corner in range(8):
        which = np.flatnonzero(mask >> corner & 1)
        here = x[nodes[which, corner]]
        edges = [x[nodes[which, corner ^ step]] - here for step in (4, 2, 1)]
        squares = np.prod([np.einsum("md,md->m", e, e) for e in edges], axis=0)
        jacobian = np.einsum("md,md->m", edges[0], np.cross(edges[1], edges[2]))
        total[which] += np.cbrt(squares / jacobian**2)
        count[which] += 1.0
    return np.divide(count, total, out=np.ones(len(nodes)), where=count > 0.0)


def triangle_shapes(x: FloatArray, nodes: IntArray) -> FloatArray:
    """The sine (m,) of the angle at the first node of triangles (m, 3), between nodes ``x`` (n, 2)."""
    u, v = (x[nodes[:, k]] - x[nodes[:, 0]] for k in (1, 2))
    area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    return np.asarray(np.abs(area) / np.sqrt(np.einsum("md,md->m", u, u) * np.einsum("md,md->m", v, v)))


def lost(shapes: FloatArray, undeformed: FloatArray) -> FloatArray:
    """``shapes`` (m,), but 1 for elements that have nearly kept those of the undeformed grid."""
    return np.where(shapes < _KEPT * undeformed, shapes, 1.0)
