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
from .vectors import cross, distances

ORDINARY, BESIDE, SLIDING = 0, 1, 2
"""Roles of faces. Faces beside a sliding face touch it; they are not tested against sliding faces."""

# Bound of the round-off of a 3 x 3 determinant of differences, relative to its permanent (Shewchuk 1997, table 3).
_ROUND_OFF = 8e-16
# Faces whose projections on an axis are farther apart than this part of their size do so without round-off, too.
_APART = 1e-13
_TOGETHER = 1 << 14
"""Faces compared and pairs decided at a time, which bounds the memory."""

# Ascending, so that the verdict on several triangles is the maximum of their verdicts.
_NO, _DOUBTFUL, _YES = 0, 1, 2
_Corners = tuple[int, int, int]
# The halves of a face that is divided from corner 0 to 2, and from 1 to 3.
_HALVES: tuple[tuple[_Corners, _Corners], ...] = (((0, 1, 2), (2, 3, 0)), ((1, 2, 3), (3, 0, 1)))

Signs = NDArray[np.int8]


def overlapping_faces(
    points: FloatArray, faces: IntArray, role: NDArray[np.int8], asked: BoolArray, margin: FloatArray | float = 0.0
) -> IntArray:
    """Pairs (c, 2) of faces (m, 4) with overlapping boxes and no common node, at least one of which is ``asked`` (m,).

    The smaller number comes first. ``points`` (n, 3) are the nodes, triangles repeat one; a ``role`` (m,) is
    ``ORDINARY``, ``BESIDE`` or ``SLIDING``; ``margin`` is that by which the box of a face is larger than the face.
    """
    if not asked.any():
        return np.empty((0, 2), dtype=np.int64)
    margin = np.broadcast_to(margin, asked.shape)
    low, high = _boxes(points, faces[asked], margin[asked])
    low, high = low.min(axis=0), high.max(axis=0)
    # Most faces are far from all that are asked.
    near = []
    for first in range(0, len(faces), _TOGETHER):
        some = slice(first, first + _TOGETHER)
        its_low, its_high = _boxes(points, faces[some], margin[some])
        both = zip(its_low.T, high, low, its_high.T, strict=True)
        near.append(first + np.flatnonzero(np.logical_and.reduce([(a <= b) & (c <= d) for a, b, c, d in both])))
    order = np.concatenate(near)
    low, high = _boxes(points, faces[order], margin[order])
    places = halves(0.5 * (low + high))
    order, low, high = order[places], low[places], high[places]
    pairs = np.sort(order[overlapping(low, high, asked[order])], axis=0)
    pairs = pairs[:, role[pairs].sum(axis=0) != BESIDE + SLIDING]
    one, two = faces[pairs]
    return np.asarray(pairs[:, ~(one[:, :, None] == two[:, None]).any(axis=(1, 2))].T)


def _boxes(points: FloatArray, faces: IntArray, margin: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest coordinates (m, 3) of faces, with a margin (m,) around each."""
    corners = points.take(faces.T, axis=0)
    return corners.min(axis=0) - margin[:, None], corners.max(axis=0) + margin[:, None]


def crossing_faces(
    points: FloatArray, faces: IntArray, role: NDArray[np.int8], asked: BoolArray
) -> tuple[IntArray, FloatArray]:
    """Pairs (c, 2), ascending, of faces that cross and have no node in common, of which at least one is ``asked`` (m,),
    and a point (c, 3) common to both; arguments as of :func:`overlapping_faces`.

    Cost is near-linear in the number of faces, however different their sizes.
    """
    pairs = overlapping_faces(points, faces, role, asked)
    verdict, places = _decided(points, faces, pairs)
    # In rational arithmetic signs are exact, and a doubt means that the faces touch.
    doubtful = np.flatnonzero(verdict == _DOUBTFUL)
    corners = faces[pairs[doubtful]]
    if doubtful.size:
        exact = np.vectorize(Fraction, otypes=[object])(points[corners])
        verdict[doubtful], places[doubtful] = _verdict(exact, corners)
    found = np.flatnonzero(verdict == _YES)
    found = found[np.lexsort(pairs[found].T[::-1])]
    return pairs[found], places[found]


def near_faces(points: FloatArray, faces: IntArray, asked: BoolArray, tolerance: FloatArray) -> BoolArray:
    """Which faces (m,) among ``asked`` another face comes close to without sharing a node: a corner of one of them is
    within the ``tolerance`` (m,) of the other."""
    pairs = overlapping_faces(points, faces, np.full(len(faces), ORDINARY, dtype=np.int8), asked, tolerance)
    touching = _decided(points, faces, pairs)[0] == _YES
    reach = tolerance[pairs].max(axis=1)
    for one, two in (pairs.T, pairs[:, ::-1].T):
        corners = np.moveaxis(points[faces[two]][:, None], 2, 0)
        touching |= (distances(points[faces[one]], corners) <= reach[:, None]).any(axis=1)
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
            verdict[some], places[some] = _verdict(points[corners], corners)
    return verdict, places


def _verdict(x: FloatArray, nodes: IntArray) -> tuple[Signs, FloatArray]:
    """``_YES``, ``_NO`` or ``_DOUBTFUL`` (n,) for pairs of faces with corners ``x`` (n, 2, 4, 3) of these numbers
    (n, 2, 4), and a common point (n, 3) where it is ``_YES``; exact if coordinates are :class:`fractions.Fraction`."""
    x, nodes = np.ascontiguousarray(np.moveaxis(x.reshape(-1, 8, 3), 0, -1)), nodes.reshape(-1, 8).T
    known: dict[tuple[int, ...], FloatArray] = {}

    def volume(*corners: int) -> FloatArray:
        """Of the tetrahedron between four of the eight corners, zero where round-off could change the sign."""
        key = tuple(sorted(corners))
        if key not in known:
            known[key] = _volumes(*x[list(key)])
        return -known[key] if sum(a > b for a, b in combinations(corners, 2)) % 2 else known[key]

    places, placed = np.zeros(x[0].shape), np.zeros(x.shape[-1], dtype=bool)
    worst = np.full(len(placed), _YES, dtype=np.int8)
    for one, two in product(_HALVES, _HALVES):
        best = np.full(len(placed), _NO, dtype=np.int8)
        for own, (a, b, c) in product(one, two):
            both = (own, (a + 4, b + 4, c + 4)), ((a + 4, b + 4, c + 4), own)
            possible = np.ones(len(placed), dtype=bool)
            for triangle, other in both:
                heights = np.stack([volume(*triangle, corner) for corner in other])
                possible &= (heights >= 0.0).any(axis=0) & (heights <= 0.0).any(axis=0)
                possible &= np.all([nodes[p] != nodes[q] for p, q in _sides(triangle)], axis=0)
            for edges, triangle in both:
                for p, q in _sides(edges):
                    ends = np.stack([volume(*triangle, p), -volume(*triangle, q)])
                    # On which side of the edge the sides of the other face's triangle pass.
                    around = np.stack([volume(p, q, r, s) for r, s in _sides(triangle)])
                    pierced = possible.copy()
                    for values in (ends, around):
                        pierced &= ~((values > 0.0).any(axis=0) & (values < 0.0).any(axis=0))
                    doubtful = (ends == 0.0).any(axis=0) | (around == 0.0).any(axis=0)
                    best = np.maximum(best, np.where(pierced, np.where(doubtful, _DOUBTFUL, _YES), _NO)).astype(np.int8)
                    new = pierced & ~doubtful & ~placed
                    at, to = ends[:, new]
                    places[:, new] = x[p][:, new] + at / (at + to) * (x[q] - x[p])[:, new]
                    placed |= new
        worst = np.minimum(worst, best)
    return worst, places.T


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
