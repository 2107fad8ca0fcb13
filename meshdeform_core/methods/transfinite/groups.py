"""Lines, faces and sub-blocks of nodes with the arc-length coordinates of the nodes inside them, blended from their
ends, edges and faces; sub-blocks are filled in groups."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...grid import BoolArray, FloatArray, IntArray
from ...numerics.arrays import portions
from ...numerics.transfinite.arcs import arc_coordinates, arc_numbers, arc_parts
from ...numerics.transfinite.blend import blend_slabs
from ...numerics.transfinite.boxes import apart, box_nodes, box_numbers
from ...numerics.transfinite.faces import blend_faces, blend_lines, face_coordinates
from ...numerics.transfinite.transposed import blend_transposed, faces_transposed, lines_transposed
from ...parallel import for_chunks

# Planes and nodes per chunk, and chunks per group: enough chunks to balance the load at negligible cost.
_PLANES, _NODES, _CHUNKS = (8, 32), 65536, 64


@dataclass(frozen=True)
class Lines:
    """Lines of nodes with their arc coordinates.

    Attributes
    ----------
    start : (n + 1,) index at which each line begins in the other arrays
    nodes, arc : node numbers and coordinates from 0 to 1, ends included
    """

    start: IntArray
    nodes: IntArray
    arc: FloatArray

    @classmethod
    def on(cls, points: FloatArray, start: IntArray, nodes: IntArray) -> Lines:
        """Lines from ``start`` and ``nodes``, with their arc coordinates."""
        arc, across = np.empty(len(nodes)), np.empty(len(nodes))
        face_coordinates(points, start, np.ones(len(start) - 1, dtype=np.int64), nodes, arc, across)
        return cls(start, nodes, arc)

    def blend(self, displacement: FloatArray) -> None:
        """Compute the displacement inside the lines from that of their ends, in place, line by line."""
        blend_lines(displacement, self.start, self.nodes, self.arc)

    def pull(self, gradient: FloatArray) -> None:
        """Transpose of :meth:`blend`: pass gradients on from inside the lines to their ends, in place."""
        lines_transposed(gradient, self.start, self.nodes, self.arc)


@dataclass(frozen=True)
class Faces:
    """Rectangles of nodes with their arc coordinates.

    Attributes
    ----------
    start : (n + 1,) index at which each rectangle begins in the other arrays
    width : (n,) nodes along its second index
    nodes : node numbers, C-ordered
    wanted : which interior nodes are to be moved
    s, t : coordinates from 0 to 1 along the first and second index
    """

    start: IntArray
    width: IntArray
    nodes: IntArray
    wanted: BoolArray
    s: FloatArray
    t: FloatArray

    @classmethod
    def of(cls, points: FloatArray, nodes: Sequence[IntArray], wanted: Sequence[BoolArray]) -> Faces:
        """Faces from one array (na, nb) of node numbers (rows of ``points``) per rectangle."""
        width = np.array([part.shape[1] for part in nodes], dtype=np.int64)
        return cls.on(
            points, np.cumsum([0, *(part.size for part in nodes)], dtype=np.int64), width,
            np.concatenate([np.empty(0, dtype=np.int64), *(part.ravel() for part in nodes)]),
            np.concatenate([np.empty(0, dtype=bool), *(part.ravel() for part in wanted)]),
        )  # fmt: skip

    @classmethod
    def on(cls, points: FloatArray, start: IntArray, width: IntArray, nodes: IntArray, wanted: BoolArray) -> Faces:
        """Faces from ``start``, ``width`` and ``nodes``, with their arc coordinates."""
        s, t = np.empty(len(nodes)), np.empty(len(nodes))
        face_coordinates(points, start, width, nodes, s, t)
        return cls(start, width, nodes, wanted, s, t)

    def blend(self, displacement: FloatArray) -> None:
        """Compute the displacement inside the rectangles from that of their edges, in place, one by one."""
        blend_faces(displacement, self.start, self.width, self.nodes, self.wanted, self.s, self.t)

    def pull(self, gradient: FloatArray) -> None:
        """Transpose of :meth:`blend`: pass gradients on from inside the rectangles to their edges, in place."""
        faces_transposed(gradient, self.start, self.width, self.nodes, self.wanted, self.s, self.t)


@dataclass(frozen=True, eq=False)
class Group:
    """Neighbouring sub-blocks and the arc coordinates of the nodes inside them; in 2-D, sub-blocks are ``faces``.

    Attributes
    ----------
    points : (n_nodes, 3)
    subs : (n, 11) sub-blocks, and ``arc`` the coordinates, see :mod:`...numerics.transfinite.arcs`
    """

    points: FloatArray
    subs: IntArray
    arc: FloatArray
    faces: Faces | None = None

    @classmethod
    def of(cls, points: FloatArray, rows: IntArray) -> Group:
        """The sub-blocks ``rows`` (n, 11), whose last column is not used, of a grid with these coordinates."""
        subs = rows.copy()
        if (subs[:1, 1:4] == 1).any():
            return cls(points, subs, np.empty(0), _faces(points, subs))
        numbers = arc_numbers(subs)
        subs[:, 10] = np.cumsum(numbers) - numbers
        arc, parts = np.empty(int(numbers.sum())), arc_parts(subs)

        def work(lo: int, hi: int) -> None:
            arc_coordinates(points, subs, parts[lo:hi], arc)

        for_chunks(work, len(parts), 1 + len(parts) // _CHUNKS)
        return cls(points, subs, arc)

    def apart(self, rows: IntArray) -> Group:
        """Some of the sub-blocks, copied to separate arrays."""
        copies, table = apart(self.points, self.subs[rows])
        return Group(copies, table, self.arc, self.faces and _faces(copies, table))

    def blend(self, values: FloatArray, slabs: IntArray | None = None) -> None:
        """Compute ``values`` (n_nodes, 3) inside the sub-blocks from those on their faces, in place.

        ``slabs`` (m, 3): only these planes, given as row of ``subs``, first plane, end; ignored in 2-D grids.
        """
        if self.faces:
            self.faces.blend(values)
            return
        chosen = self.slabs if slabs is None else slabs

        def work(lo: int, hi: int) -> None:
            blend_slabs(values, self.arc, self.subs, chosen[lo:hi])

        for_chunks(work, len(chosen), 1 + len(chosen) // _CHUNKS)

    def pull(self, gradient: FloatArray) -> None:
        """Transpose of :meth:`blend` of all planes: pass gradients (n_nodes, 3) from inside the sub-blocks on to their
        faces, in place."""
        if self.faces:
            self.faces.pull(gradient)
        else:
            blend_transposed(gradient, self.arc, self.subs)

    @property
    def slabs(self) -> IntArray:
        """All interior planes, a few per row, so that threads can share the work."""
        low, high = self.subs[:, 4:7], self.subs[:, 7:10]
        planes = np.clip(_NODES // np.prod(high[:, 1:] - low[:, 1:], axis=1), *_PLANES)
        found = portions(np.maximum(high[:, 0] - low[:, 0] - 1, 0), planes)
        return np.asarray(found + low[found[:, 0], :1] * [0, 1, 1] + [0, 1, 1])


def _faces(points: FloatArray, subs: IntArray) -> Faces:
    """Sub-blocks of a 2-D grid as rectangles."""
    shapes = subs[:, 7:10] - subs[:, 4:7] + 1
    width = np.where(subs[:, 3] > 1, shapes[:, 2], shapes[:, 1])
    start, nodes = np.append(0, np.cumsum(box_numbers(subs))), box_nodes(subs)
    return Faces.on(points, start, width, nodes, np.ones(len(nodes), dtype=bool))
