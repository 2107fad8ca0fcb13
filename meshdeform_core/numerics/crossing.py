"""Which faces of a surface pass through each other: a tree of boxes, then signs of tetrahedra.

A face is a quadrilateral between four nodes, which is not flat: it lies between the two pairs of triangles that its
diagonals make. Two faces cross if they do with every choice of diagonals, and if an edge of one triangle pierces the
inside of the other (touching is not crossing; see :mod:`meshdeform_core.boundary.crossing` for that). The signs are
those of exact arithmetic: where round-off could turn one, the pair is decided again with fractions.
"""

from fractions import Fraction

import numpy as np

from .jit import kernel

_LEAF, _DEPTH = 8, 64
# Bound of the round-off of a 3 x 3 determinant of differences, relative to its permanent (Shewchuk 1997, table 3).
_ROUND_OFF = 8e-16

# Ascending, so that the larger of two verdicts holds unless one is certain.
_NO, _YES, _DOUBTFUL = 0, 1, 2

ORDINARY, BESIDE, SLIDING = 0, 1, 2
"""Roles of faces: those beside a sliding face touch it and are not tested against any sliding one."""


def crossing_faces(points, faces, asked, role):
    """Pairs of faces that cross and have no node in common, of which at least one is ``asked``.

    Cost is near-linear in the number of faces, however different their sizes.

    Parameters
    ----------
    points : (n, 3) float64
    faces : (m, 4) int64, m >= 1; triangles repeat a node
    asked : (m,) bool
    role : (m,) int8, ``ORDINARY``, ``BESIDE`` or ``SLIDING``

    Returns
    -------
    pairs : (c, 2) int64, each pair once, ascending
    places : (c, 3) a point that both faces have in common
    """
    corners = points[faces]
    pairs = _close_pairs(faces, corners.min(axis=1), corners.max(axis=1), asked, role)
    verdict, places = np.empty(len(pairs), dtype=np.int8), np.empty((len(pairs), 3))
    _decide(points, faces, pairs, verdict, places)
    for index in np.flatnonzero(verdict == _DOUBTFUL):
        place = cross_exactly(*points[faces[pairs[index]]])
        verdict[index] = _NO if place is None else _YES
        places[index] = 0.0 if place is None else place
    found = np.flatnonzero(verdict == _YES)
    found = found[np.lexsort(pairs[found].T[::-1])]
    return pairs[found], places[found]


def near_faces(points, faces, asked, tolerance):
    """Faces among ``asked`` that another one comes close to without having a node in common.

    Parameters
    ----------
    tolerance : (m,) distance up to which a corner of one face touches another one

    Returns
    -------
    near : (m,) bool
    """
    corners, margin = points[faces], tolerance[:, None]
    low, high = corners.min(axis=1) - margin, corners.max(axis=1) + margin
    pairs = _close_pairs(faces, low, high, asked, np.zeros(len(faces), dtype=np.int8))
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


def _over(points, corner, reach):
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


def winding(points, triangles, places):
    """How often a closed surface goes round points: 1 inside, 0 outside; turned round it counts negative.

    Parameters
    ----------
    points : (n, 3); ``triangles`` (m, 3) int64, counter-clockwise seen from outside; ``places`` (k, 3), not on them

    Returns
    -------
    winding : (k,) the solid angle (Van Oosterom & Strackee 1983) of the triangles as a part of the whole sphere; a
        whole number if the surface is closed
    """
    result = np.empty(len(places))
    for index, place in enumerate(places):
        a, b, c = (points[triangles[:, k]] - place for k in range(3))
        la, lb, lc = (np.sqrt(np.einsum("ki,ki->k", x, x)) for x in (a, b, c))
        volume = np.einsum("ki,ki->k", a, np.cross(b, c))
        base = la * lb * lc
        for one, two, length in ((a, b, lc), (b, c, la), (c, a, lb)):
            base += np.einsum("ki,ki->k", one, two) * length
        result[index] = np.arctan2(volume, base).sum() / (2.0 * np.pi)
    return result


def _close_pairs(faces, low, high, asked, role):
    """Pairs of faces, at least one of them ``asked``, whose boxes overlap and that have no node in common."""
    order, box = _box_tree(low, high)
    capacity = 4 * len(faces)
    while True:
        pairs = np.empty((capacity, 2), dtype=np.int64)
        count = _search(faces, asked, role, low, high, order, box, pairs)
        if count <= capacity:
            return pairs[:count]
        capacity = count


def _box_tree(low, high):
    """Balanced tree over boxes: their order (padded with -1), and the boxes (2 p, 6) of its nodes.

    Node 1 is the root, 2 n and 2 n + 1 are the children of n, and leaf p + l holds the boxes ``_LEAF`` l and following.
    The order is that of a curve that fills space (Morton), with coordinates that are finer where most faces are.
    """
    center = 0.5 * (low + high)
    away = center - np.median(center, axis=0)
    fine = 1e-3 * max(float(np.median(np.abs(away).max(axis=1))), 1e-300)
    key = np.arcsinh(away / fine)
    key -= key.min(axis=0)
    order = np.argsort(_morton((key * ((1 << 21) - 1) / max(float(key.max()), 1e-300)).astype(np.uint64)))
    leaves = 1 << max(0, int(len(order) - 1).bit_length() - (_LEAF.bit_length() - 1))
    padded = np.full(leaves * _LEAF, -1, dtype=np.int64)
    padded[: len(order)] = order
    box = np.empty((2 * leaves, 6))
    box[leaves:] = np.repeat([[np.inf] * 3 + [-np.inf] * 3], leaves, axis=0)
    leaf = np.where(padded >= 0, padded, 0).reshape(leaves, _LEAF)
    empty = (padded < 0).reshape(leaves, _LEAF, 1)
    box[leaves:, :3] = np.where(empty, np.inf, low[leaf]).min(axis=1)
    box[leaves:, 3:] = np.where(empty, -np.inf, high[leaf]).max(axis=1)
    while leaves > 1:
        children = box[leaves : 2 * leaves].reshape(-1, 2, 6)
        leaves //= 2
        box[leaves : 2 * leaves, :3] = children[:, :, :3].min(axis=1)
        box[leaves : 2 * leaves, 3:] = children[:, :, 3:].max(axis=1)
    return padded, box


def _morton(index):
    """Bits of three numbers (n, 3) below 2^21 interleaved."""
    key = np.zeros(len(index), dtype=np.uint64)
    for axis in range(3):
        x = index[:, axis]
        for shift, mask in (
            (32, 0x1F00000000FFFF), (16, 0x1F0000FF0000FF), (8, 0x100F00F00F00F00F), (4, 0x10C30C30C30C30C3),
            (2, 0x1249249249249249),
        ):  # fmt: skip
            x = (x | x << np.uint64(shift)) & np.uint64(mask)
        key |= x << np.uint64(axis)
    return key


@kernel
def _search(faces, asked, role, low, high, order, box, pairs):
    count = 0
    leaves = box.shape[0] // 2
    stack = np.empty(_DEPTH, dtype=np.int64)
    for one in range(faces.shape[0]):
        if not asked[one]:
            continue
        stack[0] = 1
        depth = 1
        while depth:
            depth -= 1
            current = stack[depth]
            if _apart(low[one], high[one], box[current, :3], box[current, 3:]):
                continue
            if current < leaves:
                stack[depth], stack[depth + 1] = 2 * current, 2 * current + 1
                depth += 2
                continue
            for slot in range((current - leaves) * _LEAF, (current - leaves + 1) * _LEAF):
                two = order[slot]
                if two < 0 or two == one or (asked[two] and two < one) or role[one] + role[two] == BESIDE + SLIDING:
                    continue
                if _apart(low[one], high[one], low[two], high[two]) or _share(faces[one], faces[two]):
                    continue
                if count < pairs.shape[0]:
                    pairs[count, 0], pairs[count, 1] = min(one, two), max(one, two)
                count += 1
    return count


@kernel
def _decide(points, faces, pairs, verdict, places):
    for pair in range(pairs.shape[0]):
        verdict[pair] = _cross(points, faces[pairs[pair, 0]], faces[pairs[pair, 1]], places[pair])


@kernel
def _apart(low, high, other_low, other_high):
    for axis in range(3):
        if low[axis] > other_high[axis] or other_low[axis] > high[axis]:
            return True
    return False


@kernel
def _share(one, two):
    for a in range(4):
        for b in range(4):
            if one[a] == two[b]:
                return True
    return False


@kernel
def _cross(points, one, two, place):
    """Whether two faces cross with every choice of diagonals; a common point into ``place``."""
    first, second = np.empty(3, dtype=np.int64), np.empty(3, dtype=np.int64)
    result = _YES
    for choice in range(4):
        best = _NO
        for part in range(4):
            _triangle(one, choice & 1, part & 1, first)
            _triangle(two, choice >> 1, part >> 1, second)
            if best != _YES and _is_triangle(first) and _is_triangle(second):
                best = _combine(best, _triangles_cross(points, first, second, place))
        if best == _NO:
            return _NO
        if best == _DOUBTFUL:
            result = _DOUBTFUL
    return result


@kernel
def _combine(one, two):
    """Any of two verdicts."""
    if one == _YES or two == _YES:
        return _YES
    return max(one, two)


@kernel
def _triangle(face, diagonal, half, out):
    """Corners of a half of a face that is cut from corner ``diagonal`` to the opposite one."""
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
        result = _combine(result, _pierces(points, two, k, second, one, place))
        if result != _YES:
            result = _combine(result, _pierces(points, one, k, first, two, place))
        if result == _YES:
            return result
    return result


@kernel
def _sides(points, plane, corners, out):
    """Signed volumes of a triangle's corners over the plane of another one; whether it may cross that plane."""
    above = below = False
    for k in range(3):
        value, bound = _orient(points, plane[0], plane[1], plane[2], corners[k])
        out[k] = 0.0 if abs(value) <= bound else value
        above = above or value >= -bound
        below = below or value <= bound
    return above and below


@kernel
def _pierces(points, edges, k, volume, triangle, place):
    """Whether edge ``k`` of a triangle pierces another one, given the ``volume`` of its corners over that one's plane."""
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
    """Six times the signed volume of a tetrahedron, and what round-off may make of it at most."""
    ax, ay, az = points[a, 0] - points[d, 0], points[a, 1] - points[d, 1], points[a, 2] - points[d, 2]
    bx, by, bz = points[b, 0] - points[d, 0], points[b, 1] - points[d, 1], points[b, 2] - points[d, 2]
    cx, cy, cz = points[c, 0] - points[d, 0], points[c, 1] - points[d, 1], points[c, 2] - points[d, 2]
    value = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
    size = abs(ax) * (abs(by * cz) + abs(bz * cy)) + abs(ay) * (abs(bz * cx) + abs(bx * cz))
    size += abs(az) * (abs(bx * cy) + abs(by * cx))
    return value, _ROUND_OFF * size


def cross_exactly(one, two):
    """The same decision for two faces, (4, 3) corners each, on rational numbers: a common point or ``None``."""
    place = None
    for first in _halves(one):
        for second in _halves(two):
            common = (_pierced(s, t) for s in first for t in second)
            place = next((point for point in common if point is not None), None)
            if place is None:
                return None
    return place


def _halves(face):
    """Both pairs of triangles of a face, with rational coordinates."""
    a, b, c, d = ([Fraction(float(x)) for x in corner] for corner in face)
    return ((a, b, c), (c, d, a)), ((b, c, d), (d, a, b))


def _pierced(one, two):
    """Where an edge of one triangle pierces the other, if it does."""
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


def _volume(a, b, c, d):
    u, v, w = ([x - y for x, y in zip(corner, d, strict=True)] for corner in (a, b, c))
    return (
        u[0] * (v[1] * w[2] - v[2] * w[1]) + u[1] * (v[2] * w[0] - v[0] * w[2]) + u[2] * (v[0] * w[1] - v[1] * w[0])
    )
