"""Which faces of a surface pass through each other: a tree of boxes, then signs of tetrahedra.

A face is a quadrilateral, in general not flat: it lies between the two pairs of triangles into which its diagonals
divide it. Two faces cross if, for every choice of diagonals, an edge of a triangle of one pierces the inside of a
triangle of the other. Touching is not crossing; :mod:`meshdeform_core.boundary.crossing` treats it. The signs are
exact: where round-off could change one, the pair is decided in rational arithmetic.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray
from ..jit import kernel
from .overlap import ORDINARY, FaceTree

# Bound of the round-off of a 3 x 3 determinant of differences, relative to its permanent (Shewchuk 1997, table 3).
_ROUND_OFF = 8e-16

# Ascending, so that the verdict on several triangles is the maximum of their verdicts.
_NO, _DOUBTFUL, _YES = 0, 1, 2

_Point = list[Fraction]
_Triangle = tuple[_Point, _Point, _Point]


def displaced(points: FloatArray, displacement: FloatArray, shift: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Points (n, 3) after a displacement (k, 3) and a small shift (n, 3), and whether the displacement moves them (n,).

    Row r of the points has row r modulo k of the displacement.
    """
    after, moved = np.empty(points.shape), np.empty(len(points), dtype=np.bool_)
    _displace(points, displacement, shift, after, moved)
    return after, moved


def with_moved(faces: IntArray, moved: BoolArray) -> BoolArray:
    """Which faces (m, 4) have a ``moved`` (n,) node."""
    found = np.empty(len(faces), dtype=np.bool_)
    _with_moved(faces, moved, found)
    return found


def crossing_faces(
    tree: FaceTree, points: FloatArray, faces: IntArray, asked: BoolArray
) -> tuple[IntArray, FloatArray]:
    """Pairs of faces that cross and have no node in common, of which at least one is ``asked``.

    Cost is near-linear in the number of faces, however different their sizes.

    Parameters
    ----------
    tree : tree of the faces
    points : (n, 3) float64
    faces : (m, 4) int64, m >= 1; triangles repeat a node
    asked : (m,) bool

    Returns
    -------
    pairs : (c, 2) int64, each pair once, ascending
    places : (c, 3) a point common to both faces
    """
    pairs = tree.overlapping(points, asked)
    verdict, places = np.empty(len(pairs), dtype=np.int8), np.empty((len(pairs), 3))
    _decide(points, faces, pairs, verdict, places)
    for index in np.flatnonzero(verdict == _DOUBTFUL):
        place = cross_exactly(*points[faces[pairs[index]]])
        verdict[index] = _NO if place is None else _YES
        places[index] = 0.0 if place is None else place
    found = np.flatnonzero(verdict == _YES)
    found = found[np.lexsort(pairs[found].T[::-1])]
    return pairs[found], places[found]


def near_faces(points: FloatArray, faces: IntArray, asked: BoolArray, tolerance: FloatArray) -> BoolArray:
    """Faces among ``asked`` that another face comes close to without sharing a node.

    Parameters
    ----------
    tolerance : (m,) distance up to which a corner of one face touches another one

    Returns
    -------
    near : (m,) bool
    """
    tree = FaceTree(points, faces, np.full(len(faces), ORDINARY, dtype=np.int8))
    pairs = tree.overlapping(points, asked, tolerance)
    verdict, places = np.empty(len(pairs), dtype=np.int8), np.empty((len(pairs), 3))
    _decide(points, faces, pairs, verdict, places)
    touching = verdict == _YES
    reach = tolerance[pairs].max(axis=1)
    for one, two in (pairs.T, pairs[:, ::-1].T):
        for triangle in ((0, 1, 2), (2, 3, 0)):
            corner = points[faces[two][:, triangle]]
            for at in range(4):
                touching |= _over(points[faces[one, at]], corner, reach)
    near = np.zeros(len(faces), dtype=np.bool_)
    near[pairs[touching]] = True
    return near & asked


def _over(points: FloatArray, corner: FloatArray, reach: FloatArray) -> BoolArray:
    """Which points (k, 3) lie within ``reach`` (k,) of a triangle (k, 3, 3), above or below it."""
    u, v, w = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0], points - corner[:, 0]
    normal = np.cross(u, v)
    square = np.einsum("ki,ki->k", normal, normal)
    whole = square > 0.0
    safe = np.where(whole, square, 1.0)
    b = np.einsum("ki,ki->k", np.cross(w, v), normal) / safe
    c = np.einsum("ki,ki->k", np.cross(u, w), normal) / safe
    height = np.abs(np.einsum("ki,ki->k", w, normal)) / np.sqrt(safe)
    slack = reach / np.sqrt(np.sqrt(safe))
    inside = (b >= -slack) & (c >= -slack) & (b + c <= 1.0 + slack)
    return whole & inside & (height <= reach)


@kernel
def _displace(points, displacement, shift, after, moved):
    for row in range(points.shape[0]):
        d = displacement[row % displacement.shape[0]]
        moved[row] = d[0] != 0.0 or d[1] != 0.0 or d[2] != 0.0
        for axis in range(3):
            after[row, axis] = points[row, axis] + d[axis] + shift[row, axis]


@kernel
def _with_moved(faces, moved, found):
    for face in range(faces.shape[0]):
        c = faces[face]
        found[face] = moved[c[0]] or moved[c[1]] or moved[c[2]] or moved[c[3]]


@kernel
def _decide(points, faces, pairs, verdict, places):
    for pair in range(pairs.shape[0]):
        verdict[pair] = _cross(points, faces[pairs[pair, 0]], faces[pairs[pair, 1]], places[pair])


@kernel
def _cross(points, one, two, place):
    """Whether two faces cross with every choice of diagonals; stores a common point in ``place``."""
    first, second = np.empty(3, dtype=np.int64), np.empty(3, dtype=np.int64)
    result = _YES
    for choice in range(4):
        best = _NO
        for part in range(4):
            _triangle(one, choice & 1, part & 1, first)
            _triangle(two, choice >> 1, part >> 1, second)
            if best != _YES and _is_triangle(first) and _is_triangle(second):
                best = max(best, _triangles_cross(points, first, second, place))
        if best == _NO:
            return _NO
        if best == _DOUBTFUL:
            result = _DOUBTFUL
    return result


@kernel
def _triangle(face, diagonal, half, out):
    """Corners of one half of a face that is divided from corner ``diagonal`` to the opposite one."""
    begin = diagonal + 2 * half
    for k in range(3):
        out[k] = face[(begin + k) % 4]


@kernel
def _is_triangle(t):
    return t[0] != t[1] and t[1] != t[2] and t[2] != t[0]


@kernel
def _triangles_cross(points, one, two, place):
    first, second = np.empty(3), np.empty(3)
    if not _sides(points, one, two, second) or not _sides(points, two, one, first):
        return _NO
    result = _NO
    for k in range(3):
        result = max(result, _pierces(points, two, k, second, one, place))
        if result != _YES:
            result = max(result, _pierces(points, one, k, first, two, place))
        if result == _YES:
            return result
    return result


@kernel
def _sides(points, plane, corners, out):
    """Store the signed volumes of a triangle's corners over the plane of another; return whether it may cross it."""
    above = below = False
    for k in range(3):
        value, bound = _orient(points, plane[0], plane[1], plane[2], corners[k])
        out[k] = 0.0 if abs(value) <= bound else value
        above = above or value >= -bound
        below = below or value <= bound
    return above and below


@kernel
def _pierces(points, edges, k, volume, triangle, place):
    """Whether edge ``k`` of a triangle pierces another one; ``volume`` as stored by :func:`_sides`."""
    p, q = edges[k], edges[(k + 1) % 3]
    at, to = volume[k], volume[(k + 1) % 3]
    if at * to > 0.0:
        return _NO
    doubtful = at == 0.0 or to == 0.0
    above = below = False
    for side in range(3):
        value, bound = _orient(points, p, q, triangle[side], triangle[(side + 1) % 3])
        if abs(value) <= bound:
            doubtful = True
        elif value > 0.0:
            above = True
        else:
            below = True
    if above and below:
        return _NO
    share = 0.5 if doubtful else at / (at - to)
    for axis in range(3):
        place[axis] = points[p, axis] + share * (points[q, axis] - points[p, axis])
    return _DOUBTFUL if doubtful else _YES


@kernel
def _orient(points, a, b, c, d):
    """Six times the signed volume of a tetrahedron, and a bound of the round-off in it."""
    ax, ay, az = points[a, 0] - points[d, 0], points[a, 1] - points[d, 1], points[a, 2] - points[d, 2]
    bx, by, bz = points[b, 0] - points[d, 0], points[b, 1] - points[d, 1], points[b, 2] - points[d, 2]
    cx, cy, cz = points[c, 0] - points[d, 0], points[c, 1] - points[d, 1], points[c, 2] - points[d, 2]
    value = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
    size = abs(ax) * (abs(by * cz) + abs(bz * cy)) + abs(ay) * (abs(bz * cx) + abs(bx * cz))
    size += abs(az) * (abs(bx * cy) + abs(by * cx))
    return value, _ROUND_OFF * size


def cross_exactly(one: FloatArray, two: FloatArray) -> list[float] | None:
    """Decide in rational arithmetic whether two faces, (4, 3) corners each, cross: a common point or ``None``."""
    place = None
    for first in _halves(one):
        for second in _halves(two):
            common = (_pierced(s, t) for s in first for t in second)
            place = next((point for point in common if point is not None), None)
            if place is None:
                return None
    return place


def _halves(face: FloatArray) -> tuple[tuple[_Triangle, _Triangle], tuple[_Triangle, _Triangle]]:
    """Both pairs of triangles of a face, with rational coordinates."""
    a, b, c, d = ([Fraction(float(x)) for x in corner] for corner in face)
    return ((a, b, c), (c, d, a)), ((b, c, d), (d, a, b))


def _pierced(one: _Triangle, two: _Triangle) -> list[float] | None:
    """The point where an edge of one triangle pierces the other, or ``None``."""
    for edges, triangle in ((one, two), (two, one)):
        for k in range(3):
            p, q = edges[k], edges[(k + 1) % 3]
            at, to = _volume(*triangle, p), _volume(*triangle, q)
            if at * to >= 0:
                continue
            around = [_volume(p, q, triangle[side], triangle[(side + 1) % 3]) for side in range(3)]
            if all(v > 0 for v in around) or all(v < 0 for v in around):
                share = at / (at - to)
                return [float(u + share * (v - u)) for u, v in zip(p, q, strict=True)]
    return None


def _volume(a: _Point, b: _Point, c: _Point, d: _Point) -> Fraction:
    u, v, w = ([x - y for x, y in zip(corner, d, strict=True)] for corner in (a, b, c))
    return u[0] * (v[1] * w[2] - v[2] * w[1]) + u[1] * (v[2] * w[0] - v[0] * w[2]) + u[2] * (v[0] * w[1] - v[1] * w[0])
