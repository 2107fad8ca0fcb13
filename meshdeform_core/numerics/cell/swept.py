"""Volumes that cell faces sweep while their nodes move along straight lines."""

from __future__ import annotations

from ..jit import inlined, kernel
from .volume import triple, twelve_volumes


@kernel("f8[:, ::1], f8[:, ::1], i8, UniTuple(i8, 3), UniTuple(i8, 2), UniTuple(i8, 3), f8, f8[:, :, ::1]")
def sweep_faces(before, after, first, counts, along, across, weight, out):
    """Volumes swept by the faces of a block that lie across one index axis.

    The nodes of a face before and after span a trilinear hexahedron, whose volume is computed exactly (Grandy 1997).
    The volume of a cell changes by the sum of the volumes that its faces sweep outwards.

    Parameters
    ----------
    before, after : (n_nodes, 3)
    first : node of the block's first face
    counts : (3,) faces along the three index axes
    along, across : (2,) steps between the nodes of a face; (3,) steps between neighbouring faces
    weight : sign of the volume
    out : (counts[0], counts[1], counts[2])
    """
    u, v = along
    for i in range(counts[0]):
        for j in range(counts[1]):
            for k in range(counts[2]):
                a = first + i * across[0] + j * across[1] + k * across[2]
                b, c, d = a + v, a + u, a + u + v
                # Diagonals of the hexahedron and of its faces, towards its last corner and from its first one.
                a0, a1, a2 = _difference(after, d, before, c)
                b0, b1, b2 = _difference(after, d, before, b)
                c0, c1, c2 = _difference(after, d, after, a)
                d0, d1, d2 = _difference(after, b, before, a)
                e0, e1, e2 = _difference(after, c, before, a)
                f0, f1, f2 = _difference(before, d, before, a)
                volume = twelve_volumes(a0, a1, a2, b0, b1, b2, c0, c1, c2, d0, d1, d2, e0, e1, e2, f0, f1, f2)
                out[i, j, k] = (weight / 12.0) * volume


@kernel("f8[:, ::1], f8[:, ::1], i8, UniTuple(i8, 3), i8, UniTuple(i8, 3), f8[::1], f8[:, :, ::1]")
def sweep_edges(before, after, first, counts, step, across, normal, out):
    """As :func:`sweep_faces`, for edges of a 2-D block: areas of bilinear quadrilaterals seen along ``normal`` (3,).

    ``step`` is the step between the nodes of an edge; one of the ``counts`` is that of the flat axis.
    """
    for i in range(counts[0]):
        for j in range(counts[1]):
            for k in range(counts[2]):
                a = first + i * across[0] + j * across[1] + k * across[2]
                u0, u1, u2 = _difference(after, a + step, before, a)
                v0, v1, v2 = _difference(after, a, before, a + step)
                out[i, j, k] = 0.5 * triple(normal[0], normal[1], normal[2], u0, u1, u2, v0, v1, v2)


@inlined
def _difference(p, one, q, other):
    return p[one, 0] - q[other, 0], p[one, 1] - q[other, 1], p[one, 2] - q[other, 2]
