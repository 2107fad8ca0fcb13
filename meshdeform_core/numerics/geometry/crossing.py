"""Which faces of a surface pass through each other: a tree of boxes, then signs of tetrahedra.

A face is a quadrilateral, in general not flat: it lies between the two pairs of triangles into which its diagonals
divide it. Two faces cross if, for every choice of diagonals, an edge of a triangle of one pierces the inside of a
triangle of the other. Touching is not crossing; :mod:`meshdeform_core.boundary.crossing` treats it. The signs are
exact: where round-off could change one, the pair is decided in rational arithmetic.
"""

from __future__ import annotations

from fractions import Fraction
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from ..arrays import BoolArray, FloatArray, IntArray
from .boxes import halves, overlapping
from .vectors import cross

ORDINARY, BESIDE, SLIDING = 0, 1, 2
"""Roles of faces. Faces beside a sliding face touch it; they are not tested against sliding faces."""

# Bound of the round-off of a 3 x 3 determinant of differences, relative to its permanent (Shewchuk 1997, table 3).
_ROUND_OFF = 8e-16
# Faces whose projections on an axis are farther apart than this part of their size do so without round-off, too.
_APART = 1e-13
_TOGETHER = 1 << 14
"""Pairs decided at a time, which bounds the memory."""

# Ascending, so that the verdict on several triangles is the maximum of their verdicts.
_NO, _DOUBTFUL, _YES = 0, 1, 2
_Corners = tuple[int, int, int]
# The halves of a face that is divided from corner 0 to 2, and from 1 to 3.
_HALVES: tuple[tuple[_Corners, _Corners], ...] = (((0, 1, 2), (2, 3, 0)), ((1, 2, 3), (3, 0, 1)))

Signs = NDArray[np.int8]


class FaceTree:
    """A tree over at least one face (m, 4) of the undeformed nodes (n, 3), efficient as long as neighbours in space
    remain neighbours; triangles repeat a node. A role (m,) is ``ORDINARY``, ``BESIDE`` or ``SLIDING``."""

    def __init__(self, points: FloatArray, faces: IntArray, role: NDArray[np.int8]):
        self._faces, self._role = faces, role
        self._low, self._high = _bounds(points, faces)
        self._order = halves(0.5 * (self._low + self._high))

    def overlapping(
        self, points: FloatArray, asked: BoolArray, margin: FloatArray | float = 0.0, moved: BoolArray | None = None
    ) -> IntArray:
        """Pairs (c, 2) of faces with overlapping boxes and no common node, at least one of which is ``asked`` (m,).

        The smaller number comes first. ``points`` (n, 3) are the nodes, ``margin`` is that by which the box of a face
        is larger than the face. Faces that have not ``moved`` (m,) are within the margin of their undeformed position.
        """
        wider = np.broadcast_to(margin, asked.shape)[:, None]
        order = self._order
        if moved is not None and asked.any():
            low, high = _bounds(points, self._faces[asked])
            reach = 2.0 * wider.max()
            low, high = low.min(axis=0) - reach, high.max(axis=0) + reach
            order = order[(moved | ((self._low <= high) & (self._high >= low)).all(axis=1))[order]]
        low, high = _bounds(points, self._faces[order])
        low, high = low - wider[order], high + wider[order]
        pairs = np.sort(order[overlapping(low, high, asked[order])], axis=0)
        pairs = pairs[:, self._role[pairs].sum(axis=0) != BESIDE + SLIDING]
        one, two = self._faces[pairs]
        return np.asarray(pairs[:, ~(one[:, :, None] == two[:, None]).any(axis=(1, 2))].T)


def _bounds(points: FloatArray, faces: IntArray) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest coordinates (m, 3) of faces."""
    low = points[faces[:, 0]]
    high = low.copy()
    for corner in faces.T[1:]:
        x = points[corner]
        np.minimum(low, x, out=low)
        np.maximum(high, x, out=high)
    return low, high


def crossing_faces(
    tree: FaceTree,
    points: FloatArray,
    faces: IntArray,
    asked: BoolArray,
    reach: float = 0.0,
    moved: BoolArray | None = None,
) -> tuple[IntArray, FloatArray]:
    """Pairs (c, 2), ascending, of faces that cross and have no node in common, of which at least one is ``asked`` (m,),
    and a point (c, 3) common to both.

    Cost is near-linear in the number of faces, however different their sizes. ``tree`` is that of the faces (m, 4);
    those that have not ``moved`` (m,) are within ``reach`` of their undeformed position.
    """
    pairs = tree.overlapping(points, asked, reach, moved)
    verdict, places = _decided(points, faces, pairs)
    # In rational arithmetic signs are exact, and a doubt means that the faces touch.
    doubtful = np.flatnonzero(verdict == _DOUBTFUL)
    corners = faces[pairs[doubtful]]
    if doubtful.size:
        exact = np.vectorize(Fraction, otypes=[object])(points[corners])
        verdict[doubtful], places[doubtful] = _Signs(exact, corners).verdict()
    found = np.flatnonzero(verdict == _YES)
    found = found[np.lexsort(pairs[found].T[::-1])]
    return pairs[found], places[found]


def near_faces(points: FloatArray, faces: IntArray, asked: BoolArray, tolerance: FloatArray) -> BoolArray:
    """Which faces (m,) among ``asked`` another face comes close to without sharing a node: a corner of one of them is
    within the ``tolerance`` (m,) of the other."""
    tree = FaceTree(points, faces, np.full(len(faces), ORDINARY, dtype=np.int8))
    pairs = tree.overlapping(points, asked, tolerance)
    touching = _decided(points, faces, pairs)[0] == _YES
    reach = tolerance[pairs].max(axis=1)
    for one, two in (pairs.T, pairs[:, ::-1].T):
        for triangle in _HALVES[0]:
            corner = points[faces[two][:, triangle]]
            u, v = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
            normal = np.cross(u, v)
            square = np.einsum("ki,ki->k", normal, normal)
            safe = np.where(square > 0.0, square, 1.0)
            slack = reach / np.sqrt(np.sqrt(safe))
            for at in range(4):
                # Corners within reach of the triangle, above or below it.
                w = points[faces[one, at]] - corner[:, 0]
                b = np.einsum("ki,ki->k", np.cross(w, v), normal) / safe
                c = np.einsum("ki,ki->k", np.cross(u, w), normal) / safe
                height = np.abs(np.einsum("ki,ki->k", w, normal)) / np.sqrt(safe)
                inside = (b >= -slack) & (c >= -slack) & (b + c <= 1.0 + slack)
                touching |= (square > 0.0) & inside & (height <= reach)
    near = np.zeros(len(faces), dtype=np.bool_)
    near[pairs[touching]] = True
    return near & asked


def _decided(points: FloatArray, faces: IntArray, pairs: IntArray) -> tuple[Signs, FloatArray]:
    """Whether pairs (n, 2) of faces cross with every choice of diagonals; a point (n, 3) common to those that do."""
    verdict, places = np.full(len(pairs), _NO, dtype=np.int8), np.zeros((len(pairs), 3))
    for lo in range(0, len(pairs), _TOGETHER):
        some = np.arange(lo, min(lo + _TOGETHER, len(pairs)))
        # Those pairs are left that no plane separates, normal to one of the faces or along an edge.
        x = points[faces[pairs[some]]]
        left = np.arange(len(x))
        x = np.ascontiguousarray(np.moveaxis(x - x[:, :1, :1], 0, -1))
        normals = [cross(each[2] - each[0], each[3] - each[1]) for each in (x[0], x[1])]
        for number in range(10):
            which, corner = divmod(number, 5)
            axis = normals[which]
            if corner < 4:
                axis = cross(axis, x[which, (corner + 1) % 4] - x[which, corner])
            at = (x * axis).sum(axis=2)
            reach = _APART * np.abs(x).max(axis=(0, 1, 2)) * np.abs(axis).sum(axis=0)
            low, high = at.min(axis=1), at.max(axis=1)
            open_ = (low[0] <= high[1] + reach) & (low[1] <= high[0] + reach)
            left, x, normals = left[open_], x[..., open_], [normal[:, open_] for normal in normals]
        some = some[left]
        if some.size:
            corners = faces[pairs[some]]
            verdict[some], places[some] = _Signs(points[corners], corners).verdict()
    return verdict, places


class _Signs:
    """The signed volumes between the corners (n, 2, 4, 3), with numbers (n, 2, 4), of pairs of faces: zero where
    round-off could change the sign, exact if corners are objects of :class:`fractions.Fraction`."""

    def __init__(self, x: FloatArray, nodes: IntArray):
        self._x = np.ascontiguousarray(np.moveaxis(x, 0, -1))
        self._nodes = np.moveaxis(nodes, 0, -1)
        # Corners of each face over the triangles of the other one; edges of the first about edges of the second.
        self._heights = [
            {
                (a, b, c): [_volumes(own[a], own[b], own[c], corner) for corner in other]
                for a, b, c in (*_HALVES[0], *_HALVES[1])
            }
            for own, other in ((self._x[0], self._x[1]), (self._x[1], self._x[0]))
        ]
        edges = list(combinations(range(4), 2))
        self._about = {
            ((p, q), (r, s)): np.sign(_volumes(self._x[0, p], self._x[0, q], self._x[1, r], self._x[1, s]))
            for (p, q), (r, s) in product(edges, edges)
        }

    def verdict(self) -> tuple[Signs, FloatArray]:
        """``_YES``, ``_NO`` or ``_DOUBTFUL`` (n,), and a common point (n, 3) where it is ``_YES``."""
        self._places, self._placed = np.zeros(self._x[0, 0].shape), np.zeros(self._x.shape[-1], dtype=bool)
        worst = np.full(len(self._placed), _YES, dtype=np.int8)
        for one, two in product(_HALVES, _HALVES):
            best = np.max([self._triangles(*halves) for halves in product(one, two)], axis=0)
            worst = np.minimum(worst, best)
        return worst, self._places.T

    def _triangles(self, one: _Corners, two: _Corners) -> Signs:
        """The verdict on a triangle of the first and one of the second face."""
        possible = np.ones(len(self._placed), dtype=bool)
        for face, own, other in ((0, one, two), (1, two, one)):
            corners = self._nodes[face][list(own)]
            possible &= (corners[0] != corners[1]) & (corners[1] != corners[2]) & (corners[2] != corners[0])
            heights = [self._heights[face][own][c] for c in other]
            possible &= np.any([h >= 0.0 for h in heights], axis=0) & np.any([h <= 0.0 for h in heights], axis=0)
        best = np.full(len(possible), _NO, dtype=np.int8)
        for face, edges, triangle in ((0, one, two), (1, two, one)):
            heights = self._heights[1 - face][triangle]
            for p, q in _sides(edges):
                around = []
                for r, s in _sides(triangle):
                    # On which side of the edge this side of the other face's triangle passes.
                    edge, side = (min(p, q), max(p, q)), (min(r, s), max(r, s))
                    passes = self._about[(edge, side) if face == 0 else (side, edge)]
                    around.append(passes if (p < q) == (r < s) else -passes)
                outside = np.any([each > 0 for each in around], axis=0) & np.any([each < 0 for each in around], axis=0)
                at, to = heights[p], heights[q]
                pierced = possible & ~outside & (np.sign(at) * np.sign(to) <= 0.0)
                doubtful = (at == 0.0) | (to == 0.0) | np.any([each == 0 for each in around], axis=0)
                best = np.maximum(best, np.where(pierced, np.where(doubtful, _DOUBTFUL, _YES), _NO)).astype(np.int8)
                new = pierced & ~doubtful & ~self._placed
                if new.any():
                    start, end = self._x[face, p][:, new], self._x[face, q][:, new]
                    self._places[:, new] = start + at[new] / (at[new] - to[new]) * (end - start)
                    self._placed |= new
        return best


def _volumes(a: FloatArray, b: FloatArray, c: FloatArray, d: FloatArray) -> FloatArray:
    """Six times the signed volumes of tetrahedra with corners (3, n), zero where round-off could change the sign."""
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = a - d, b - d, c - d
    value = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
    size = np.abs(ax) * (np.abs(by * cz) + np.abs(bz * cy)) + np.abs(ay) * (np.abs(bz * cx) + np.abs(bx * cz))
    size += np.abs(az) * (np.abs(bx * cy) + np.abs(by * cx))
    return np.where(np.abs(value) <= (0 if value.dtype == object else _ROUND_OFF) * size, 0.0, value)


def _sides(triangle: _Corners) -> list[tuple[int, int]]:
    a, b, c = triangle
    return [(a, b), (b, c), (c, a)]
