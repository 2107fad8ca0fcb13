"""Lines, faces and sub-blocks of nodes with the arc-length coordinates of the nodes inside them, blended from their
ends, edges and faces; sub-blocks are filled in groups.

TFI, as an operator T, reproduces a linear map, such as a rotation, only where it would also generate the grid: T x = x.
Elsewhere, for example around leading edges, the image of the deviation x - T x is missing. With the gradient G of the
displacement of the sub-block, fitted to its corners, T d + G (x - T x) reproduces every linear map
(:class:`CurvedLines`). In grids that TFI generated there are no deviations, and no cost.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...grid import BoolArray, FloatArray, IntArray
from ...numerics.arrays import portions
from ...numerics.transfinite.arcs import (
    TILE,
    apart,
    arc_coordinates,
    arc_numbers,
    arc_parts,
    box_nodes,
    box_numbers,
    inner_numbers,
)
from ...numerics.transfinite.blend import blend_slabs
from ...numerics.transfinite.faces import blend_faces, face_coordinates
from ...parallel import for_chunks

# Planes and nodes per chunk, and chunks per group: enough chunks to balance the load at negligible cost.
_PLANES, _NODES, _CHUNKS = (8, 32), 65536, 64
# Deviations below this fraction of the size of a sub-block are round-off.
_ROUND_OFF = 1e-8
THINNEST = 1e-7
"""In sub-blocks thinner than this fraction of their length, the gradient across them is not determined."""


@dataclass(frozen=True)
class Faces:
    """Rectangles and lines of nodes with their arc coordinates.

    Attributes
    ----------
    start : (n + 1,) index at which each rectangle begins in the other arrays
    width : (n,) nodes along its second index, 1 for a line
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
    def on(cls, points: FloatArray, start: IntArray, width: IntArray, nodes: IntArray, wanted: BoolArray) -> Faces:
        """Faces from ``start``, ``width`` and ``nodes``, with their arc coordinates."""
        s, t = np.empty(len(nodes)), np.empty(len(nodes))
        face_coordinates(points, start, width, nodes, s, t)
        return cls(start, width, nodes, wanted, s, t)

    def blend(self, displacement: FloatArray) -> None:
        """Compute the displacement inside the rectangles from that of their edges, in place, one by one."""
        blend_faces(displacement, self.start, self.width, self.nodes, self.wanted, self.s, self.t, False)

    def pull(self, gradient: FloatArray) -> None:
        """Transpose of :meth:`blend`: pass gradients on from inside the rectangles to their edges, in place."""
        blend_faces(gradient, self.start, self.width, self.nodes, self.wanted, self.s, self.t, True)


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
        # Vectors extend beyond the last coordinates.
        arc, parts = np.empty(int(numbers.sum()) + TILE), arc_parts(subs)

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
            from ...numerics.transfinite.transposed import blend_transposed

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


@dataclass(frozen=True)
class Bent:
    """The sub-blocks of a group that have deviations.

    ``rows`` (m,): their rows in the group; ``corners`` (m, 8): their corner nodes; ``inverse`` (m, 3, 8): maps values
    at the corners to their least-squares gradient.
    """

    rows: IntArray
    corners: IntArray
    inverse: FloatArray


@dataclass(frozen=True)
class CurvedLines:
    """Deviations of the nodes inside the sub-blocks of a group.

    Attributes
    ----------
    bent : the sub-blocks with deviations
    nodes, sub : (n,) flat indices of the nodes inside these, and the row of ``bent`` to which each belongs
    deviation : (n, 3) their deviations
    """

    bent: Bent
    nodes: IntArray
    sub: IntArray
    deviation: FloatArray

    @classmethod
    def of(cls, group: Group, bent: Bent | None = None) -> CurvedLines:
        """The deviations of a group; the search for sub-blocks with deviations is skipped if ``bent`` is given."""
        if bent is None:
            rows = np.flatnonzero(inner_numbers(group.subs))
            corners = corners_of(group.subs)
            size = np.abs(arms(group.points, corners)).max(axis=(1, 2))
            # One plane of each sub-block excludes most of those without deviations; measuring all planes costs twice
            # that.
            for one_plane in (True, False):
                sub, deviation = _measured(group, rows, one_plane)
                # Of each sub-block, all of which have nodes inside.
                start = np.flatnonzero(np.diff(sub, prepend=-1))
                largest = np.maximum.reduceat(np.abs(deviation).max(axis=1), start) if len(start) else np.empty(0)
                rows = rows[largest > _ROUND_OFF * size[rows]]
            inverse = np.linalg.pinv(arms(group.points, corners[rows]), rcond=THINNEST)
            bent = Bent(rows, corners[rows], np.asarray(inverse, dtype=np.float64))
        sub, deviation = _measured(group, bent.rows)
        return cls(bent, box_nodes(group.subs[bent.rows], inside=True), sub, deviation)

    def add(self, displacement: FloatArray) -> None:
        """Add the missing linear part to the displacement (n_nodes, 3) of inner nodes, in place."""
        gradient = self.bent.inverse @ displacement[self.bent.corners]
        displacement[self.nodes] += np.einsum("na,nac->nc", self.deviation, gradient[self.sub])

    def pull(self, gradient: FloatArray) -> None:
        """Transpose of :meth:`add`: add to the gradients (n_nodes, 3) of the corners, in place."""
        given, found = gradient[self.nodes], np.empty((len(self.bent.rows), 3, 3))
        for a, c in np.ndindex(3, 3):
            found[:, a, c] = np.bincount(self.sub, self.deviation[:, a] * given[:, c], len(found))
        np.add.at(gradient, self.bent.corners, np.einsum("nac,nak->nkc", found, self.bent.inverse))


def _measured(group: Group, rows: IntArray, one_plane: bool = False) -> tuple[IntArray, FloatArray]:
    """Deviations of the nodes inside some sub-blocks, or in one plane of each, from where TFI would place them: the
    position of their sub-block in ``rows`` (n,), and the deviations (n, 3)."""
    part = group.apart(rows)
    blended, subs = part.points.copy(), part.subs
    if one_plane:
        # At a third, not the middle, where S-shaped lines have no deviation.
        low, high = subs[:, 4], subs[:, 7]
        plane, subs = low + np.maximum((high - low) // 3, 1), subs.copy()
        subs[:, 4], subs[:, 7] = np.where(high > low, [plane - 1, plane + 1], [low, high])
    part.blend(blended, np.column_stack([np.arange(len(rows)), subs[:, 4] + 1, subs[:, 7]]) if one_plane else None)
    nodes = box_nodes(subs, inside=True)
    return np.repeat(np.arange(len(rows)), inner_numbers(subs)), part.points[nodes] - blended[nodes]


def arms(points: FloatArray, corners: IntArray) -> FloatArray:
    """Corners (n, 8, 3) relative to their mean."""
    return np.asarray(points[corners] - points[corners].mean(axis=1, keepdims=True))


def corners_of(subs: IntArray) -> IntArray:
    """Flat indices (n, 8) of the corners of sub-blocks."""
    ends = np.stack([subs[:, 4:7], subs[:, 7:10]], axis=1)
    i, j, k = (ends[:, n, axis] for axis, n in enumerate(np.indices((2, 2, 2)).reshape(3, 8)))
    shape = subs[:, 1:4, None]
    return np.asarray(subs[:, :1] + (i * shape[:, 1] + j) * shape[:, 2] + k)
