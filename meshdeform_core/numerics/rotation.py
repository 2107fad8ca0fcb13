"""Unit quaternions, rotation vectors, and logarithms of rigid motions in SE(3); rotations of surface nodes (Sen et al.
appendix A).

Rotation vectors are (n, 3) in radians, unit quaternions (n, 4) scalar first, translations (n, 3).

A rotation by 190 degrees equals one by -170 degrees about the same axis. The logarithm of a matrix or quaternion yields
the smaller angle, node by node, so adjacent nodes of a surface that turns by about 180 degrees may appear to turn in
opposite directions. Rotation vectors are therefore chosen so that they are continuous along surfaces.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import scipy

from .arrays import BoolArray, FloatArray, IntArray, lengths, places_among, spans
from .geometry.coincidence import connected_components
from .tape import Tracked, plain

_TOGETHER = 200_000
"""Corners and edges whose vectors are computed at a time, which bounds the memory."""
STEEP = 0.25
"""An edge counts less below this part of its squared length in the tangent plane, before times after: 45 degrees."""
SHARP = 0.9
"""Length of the mean unit normal at a node below which its faces form a sharp edge."""
_FULL = 2 * math.pi
_CERTAIN = 0.5 * math.pi
"""Nodes that turn by less fix the branch of their surface, which is attached to a resting one or nearly at rest."""
_LARGEST = 0.9 * _FULL
"""Near a full turn a translation cannot be told from a rotation about a distant axis."""
_AGREEMENT = 0.05
"""Weight of the difference between surfaces against the angle itself: bodies that turn by 179 and 181 degrees in a
fixed box agree, two that turn against each other by up to about 170 degrees keep doing so."""


def multiply(p: FloatArray, q: FloatArray) -> FloatArray:
    """Quaternion product: rotation ``q`` followed by ``p``; the scalar part is made non-negative (angle at most pi)."""
    scalar = p[:, 0] * q[:, 0] - dot(p[:, 1:], q[:, 1:])
    vector = p[:, :1] * q[:, 1:] + q[:, :1] * p[:, 1:] + np.cross(p[:, 1:], q[:, 1:])
    return np.concatenate([scalar[:, None], vector], axis=1) * np.where(scalar < 0, -1.0, 1.0)[:, None]


def rotate(q: FloatArray, v: FloatArray) -> FloatArray:
    """Vectors (n, 3) turned by quaternions (n, 4)."""
    lift = np.cross(q[:, 1:], v)
    return v + 2 * (q[:, :1] * lift + np.cross(q[:, 1:], lift))


def rotation_vector(q: FloatArray) -> FloatArray:
    """Axis times angle (radians; at most pi where the scalar part is not negative) of unit quaternions (n, 4)."""
    sine2, scalar = dot(q[:, 1:], q[:, 1:]), q[:, 0]
    small = (sine2 < 1e-4) & (scalar > 0.0)
    sine = np.sqrt(np.where(small, 1.0, sine2))
    # angle / sine = 2 atan(t) / (t q0) for t = sine / q0, smooth at zero.
    safe = np.where(small, scalar, 1.0)
    t2 = np.where(small, sine2, 0.0) / (safe * safe)
    series = 2.0 * (1.0 - t2 * (1 / 3 - t2 * (1 / 5 - t2 * (1 / 7 - t2 / 9)))) / safe
    ratio = np.where(small, series, 2 * np.arctan2(sine, scalar) / sine)
    return q[:, 1:] * ratio[:, None]


def quaternion_of(w: FloatArray) -> FloatArray:
    """Unit quaternions of rotation vectors (n, 3)."""
    # (1 - cos x) / x^2 and sin(x) / x are smooth at zero, with x half the angle.
    half = 0.5 * w
    sinc, versine, _ = _coefficients(half)
    scalar = 1.0 - versine * dot(half, half)
    return np.concatenate([scalar[:, None], sinc[:, None] * half], axis=1)


def translation_of_twist(w: FloatArray, v: FloatArray) -> FloatArray:
    """V(w) v: the translation of the rigid motion exp(w, v)."""
    _, b, c = _coefficients(w)
    cross = np.cross(w, v)
    return v + b[:, None] * cross + c[:, None] * np.cross(w, cross)


def twist_velocity(w: FloatArray, t: FloatArray) -> FloatArray:
    """Inverse of V(w) applied to translations: the v of log (R, t)."""
    a, b, _ = _coefficients(w)
    angle2 = dot(w, w)
    # (1 - a / (2 b)) / angle^2 with a = sin(x)/x, b = (1 - cos x)/x^2; 1/12 in the limit.
    small = angle2 < 1e-3
    safe = np.where(small, 1.0, angle2)
    series = 1 / 12 + angle2 / 720 + angle2**2 / 30240
    factor = np.where(small, series, (1 - a / (2 * np.where(small, 0.5, b))) / safe)
    cross = np.cross(w, t)
    return t - 0.5 * cross + factor[:, None] * np.cross(w, cross)


def _coefficients(w: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """sin(x)/x, (1 - cos x)/x^2 and (x - sin x)/x^3 for x = |w|."""
    x2 = dot(w, w)
    x = np.sqrt(x2)
    small = x2 < 1e-3
    safe = np.where(small, 1.0, x)
    half = np.sin(safe / 2) / safe
    a = np.where(small, 1 - x2 / 6 + x2**2 / 120 - x2**3 / 5040, np.sin(safe) / safe)
    b = np.where(small, 0.5 - x2 / 24 + x2**2 / 720 - x2**3 / 40320, 2 * half**2)
    c = np.where(small, 1 / 6 - x2 / 120 + x2**2 / 5040 - x2**3 / 362880, (safe - np.sin(safe)) / safe**3)
    return a, b, c


def dot(u: FloatArray, v: FloatArray) -> FloatArray:
    """Scalar products (n,) of vectors (n, k)."""
    return np.einsum("ni,ni->n", u, v)


class SurfaceRotations:
    """Rotation of every node of a deforming surface, fitted to its faces (eqs. 21-25).

    A first rotation carries the mean unit normal of the node's faces onto the deformed one; a second turns the edges in
    the tangent plane. Both edge vectors are projected onto that plane, and the angle is taken with its sign (atan2),
    as eq. 23 as printed has no sign for in-plane bending. Nodes on sharp edges are treated like all others.

    ``corners`` (c, 3) are node, next and previous node of the face, for every face corner; in 2-D, where the plane has
    a unit normal, (c, 2) the two end nodes of every edge of the curve. ``edges`` (e, 2) are node and neighbour, each
    neighbour once (unused in 2-D).
    """

    def __init__(
        self, points: FloatArray, corners: IntArray, edges: IntArray, plane_normal: FloatArray | None = None
    ) -> None:
        # Many more nodes have no face here than have one.
        self._nodes = np.unique(corners)
        self._place = places_among(self._nodes, len(points))
        self._points, self._corners, self._edges = points[self._nodes], self._place[corners], self._place[edges]
        self._plane_normal = plane_normal
        self._normals = _node_normals(self._points, self._corners, plane_normal)
        self._last: tuple[FloatArray, tuple[FloatArray, FloatArray]] | None = None

    def folded(self, displacement: FloatArray) -> int:
        """Number of nodes whose faces cancel after a displacement (n, 3), or before it, but not both."""
        after = _node_normals(self._points + displacement[self._nodes], self._corners, self._plane_normal)
        return int(np.count_nonzero(self._normals.any(axis=1) != after.any(axis=1)))

    def of(self, displacement: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The rotations for a displacement (n, 3) as quaternions (n, 4) and as vectors (n, 3), radians, continuous
        along every surface; none at nodes without faces.

        Signs are continuous between neighbours: scalar parts are negative where vectors are longer than pi. The last
        result is kept, as methods, warnings and reports all need it for the same displacement.
        """
        inside = displacement[self._nodes]
        if isinstance(displacement, Tracked):
            found, vectors = self._turned(inside)
        else:
            if self._last is None or not np.array_equal(self._last[0], inside):
                self._last = inside, self._turned(inside)
            found, vectors = self._last[1]
        rest = np.array([[1.0, 0.0, 0.0, 0.0]]), np.zeros((1, 3))
        return np.concatenate([found, rest[0]])[self._place], np.concatenate([vectors, rest[1]])[self._place]

    def _turned(self, displacement: FloatArray) -> tuple[FloatArray, FloatArray]:
        found = np.array([[1.0, 0.0, 0.0, 0.0]])[np.zeros(len(displacement), dtype=np.int64)]
        turning = np.ones(len(displacement), dtype=bool)
        if not isinstance(displacement, Tracked):
            # No round-off where all faces of a node are at rest; in 2-D, an edge of the curve is a face of both ends.
            touched = self._corners[(displacement != 0.0).any(axis=1)[self._corners].any(axis=1)]
            turning = np.zeros(len(displacement), dtype=bool)
            turning[touched if self._plane_normal is not None else touched[:, 0]] = True
        if turning.all():
            found = self._fitted(self._points + displacement)
        elif turning.any():
            found[turning] = self._fitted(self._points + displacement)[turning]
        vectors = continuous(rotation_vector(found), neighbours(self._corners, self._edges, self._plane_normal))
        return found * np.where(lengths(vectors) > np.pi, -1.0, 1.0)[:, None], vectors

    def _fitted(self, after: FloatArray) -> FloatArray:
        before, edges, normals = self._points, self._edges, _node_normals(after, self._corners, self._plane_normal)
        # Shortest rotation that carries unit vectors onto others; for opposite vectors, half a turn about a
        # perpendicular axis.
        start = self._normals
        axis = np.cross(start, normals)
        sine = lengths(axis)
        cosine = dot(start, normals)
        opposite = (sine < 1e-12) & (cosine < 0)
        if opposite.any():
            half_turn = np.zeros(start.shape)
            half_turn[opposite] = _half_turn_axes(start[opposite]) if self._plane_normal is None else self._plane_normal
            axis = np.where(opposite[:, None], half_turn, axis)
        # Up to a right angle, the half-angle formula, which is smooth at zero angle.
        half = np.sqrt(0.5 * (1.0 + np.maximum(cosine, 0.0)))[:, None]
        near = np.concatenate([half, axis / (2.0 * half)], axis=1)
        first = np.where((cosine > 0.0)[:, None], near, _quaternion(_unit(axis), np.arctan2(sine, cosine)))
        if self._plane_normal is not None:
            return first

        def turned_edges(some: IntArray) -> FloatArray:
            here, there = some.T
            arm, target, normal = (
                rotate(first[here], before[there] - before[here]),
                after[there] - after[here],
                normals[here],
            )
            size = dot(arm, arm) * dot(target, target)
            arm, target = (v - normal * dot(normal, v)[:, None] for v in (arm, target))
            # Weights are 1 up to 45 degrees from the tangent plane, falling to 0 at the normal: across thin trailing
            # edges, small shears turn the projection of an edge by any angle, and its mean with others would jump.
            part = dot(arm, arm) * dot(target, target) / np.where(plain(size) > 0.0, size, 1.0) / STEEP
            # Second derivatives are continuous at 1, where edges of boxes are.
            weight = np.where(plain(part) < 1.0, part * part * part * (10.0 + part * (6.0 * part - 15.0)), 1.0)
            return np.stack([np.arctan2(dot(normal, np.cross(arm, target)), dot(arm, target)), weight], axis=1)

        angle = _in_turns(turned_edges, edges, after)
        mean = _mean_angles(angle[:, 0], angle[:, 1], edges[:, 0], len(before))
        return multiply(_quaternion(normals, mean), first)


def _in_turns(compute: Callable[[IntArray], FloatArray], rows: IntArray, x: FloatArray) -> FloatArray:
    """``compute(rows)``, a value for each row, a few at a time; all at once if ``x`` records derivatives."""
    if isinstance(x, Tracked) or len(rows) <= _TOGETHER:
        return compute(rows)
    return np.concatenate([compute(rows[lo : lo + _TOGETHER]) for lo in range(0, len(rows), _TOGETHER)])


def _mean_angles(angle: FloatArray, weight: FloatArray, node: IntArray, n: int) -> FloatArray:
    """Weighted mean (n,) of the angles of each node, zero without any; angles near half a turn are given a common sign
    first."""
    total = np.bincount(node, weight, minlength=n)
    total = np.where(plain(total) > 0.0, total, 1.0)
    mean = np.bincount(node, weight * angle, minlength=n) / total
    large = np.zeros(n, dtype=bool)
    large[node[np.abs(plain(angle)) > 0.5 * np.pi]] = True
    if large.any():
        sine, cosine = (np.bincount(node, weight * part, minlength=n) for part in (np.sin(angle), np.cos(angle)))
        middle = np.arctan2(sine, cosine)
        apart = angle - middle[node]
        apart = apart - 2 * np.pi * np.rint(apart / (2 * np.pi))
        spread = np.bincount(node, weight * apart, minlength=n) / total
        mean = np.where(large, middle + spread, mean)
    return mean


def near_sharp_edges(
    points: FloatArray, corners: IntArray, edges: IntArray, plane_normal: FloatArray | None, rounds: int
) -> BoolArray:
    """Nodes (n,) bool within ``rounds`` edges of a node on a sharp edge.

    Faces whose normals differ by more than about 50 degrees have a mean normal shorter than 0.9. Arguments as in
    :class:`SurfaceRotations`.
    """
    total, count = _sum_of_normals(points, corners, plane_normal)
    near = (count > 0) & (lengths(total) < SHARP * count)
    here, there = neighbours(corners, edges, plane_normal).T
    for _ in range(rounds):
        near |= np.bincount(here, near[there], minlength=len(points)) > 0
    return near


def neighbours(corners: IntArray, edges: IntArray, plane_normal: FloatArray | None) -> IntArray:
    """Pairs (e, 2) of node and neighbour along the surface, or along the curve in 2-D."""
    return edges if plane_normal is None else np.concatenate([corners, corners[:, ::-1]])


def smoothed(q: FloatArray, vectors: FloatArray, pairs: IntArray, rounds: int) -> tuple[FloatArray, FloatArray]:
    """Rotations smoothed ``rounds`` times: the nodes ``pairs[:, 0]`` take the mean of their own and their neighbours'
    mean quaternion.

    Takes and returns the rotations both as quaternions (n, 4) and as vectors (n, 3), of corresponding signs; without
    pairs, those given.
    """
    if not len(pairs):
        return q, vectors
    here, there = pairs.T
    nodes, place = np.unique(here, return_inverse=True)
    count = np.bincount(place)[:, None]
    # Where in the old rows, followed by new ones of the nodes, those of all nodes are.
    rows = np.arange(len(vectors))
    rows[nodes] = len(rows) + np.arange(len(nodes))
    for _ in range(rounds):
        other = q[there] * np.where(np.einsum("ek,ek->e", q[here], q[there]) < 0.0, -1.0, 1.0)[:, None]
        mean = np.stack([np.bincount(place, other[:, k]) for k in range(4)], axis=1) / count
        mixed = q[nodes] + mean
        q = np.concatenate([q, mixed / np.linalg.norm(mixed, axis=1, keepdims=True)])[rows]
    new = nearest_branch(rotation_vector(q[nodes]), vectors[nodes])
    return q, np.concatenate([vectors, new])[rows]


def _node_normals(x: FloatArray, corners: IntArray, plane_normal: FloatArray | None) -> FloatArray:
    """Mean of the unit normals of the faces at each node, normalised; zero where it is undefined."""
    total, _ = _sum_of_normals(x, corners, plane_normal)
    # Normals that cancel (both sides of a plate without thickness) or vanish (collapsed faces) leave only round-off.
    return _unit(np.where((lengths(total) < 1e-6)[:, None], 0.0, total))


def _sum_of_normals(x: FloatArray, corners: IntArray, plane_normal: FloatArray | None) -> tuple[FloatArray, IntArray]:
    """Sum (n, 3) of the unit normals of the faces at each node, and their number (n,)."""
    if plane_normal is None:

        def corner_normals(some: IntArray) -> FloatArray:
            here, following, previous = some.T
            return _unit(np.cross(_unit(x[following] - x[here]), _unit(x[previous] - x[here])))

        normal = _in_turns(corner_normals, corners, x)
        owners = [corners[:, 0]]
    else:
        normal = np.cross(_unit(x[corners[:, 1]] - x[corners[:, 0]]), plane_normal)
        owners = [corners[:, 0], corners[:, 1]]
    owner, normals = np.concatenate(owners), np.concatenate([normal] * len(owners))
    columns = [np.bincount(owner, normals[:, axis], minlength=len(x)) for axis in range(3)]
    return np.stack(columns, axis=1), np.bincount(owner, minlength=len(x))


def _half_turn_axes(normals: FloatArray) -> FloatArray:
    """Axes (n, 3) of half turns that reverse ``normals``, as far as possible the same axis for the whole surface.

    A body that turns by 180 degrees reverses all normals perpendicular to its axis. Any other axis would require an
    additional half turn about the normal, whose sign would depend on round-off.
    """
    common = np.linalg.eigh(normals.T @ normals)[1][:, 0]
    axes = common - dot(normals, np.broadcast_to(common, normals.shape))[:, None] * normals
    poor = lengths(axes) < 1e-3
    least = np.eye(3)[np.argmin(np.abs(normals), axis=1)]
    axes[poor] = np.cross(normals, least)[poor]
    return axes


def _quaternion(axis: FloatArray, angle: FloatArray) -> FloatArray:
    return np.concatenate([np.cos(angle / 2)[:, None], np.sin(angle / 2)[:, None] * axis], axis=1)


def _unit(v: FloatArray) -> FloatArray:
    """Unit vectors; zero where the length is zero (collapsed edges and faces)."""
    length = lengths(v)[:, None]
    return v / np.where(plain(length) > 1e-100, length, np.inf)


def nearest_branch(vectors: FloatArray, reference: FloatArray) -> FloatArray:
    """Rotation vectors (n, 3) of the same rotations, those nearest to ``reference`` (n, 3)."""
    angle = lengths(vectors)
    # A rotation by zero has any axis.
    axis = _unit(np.where((angle > 0.0)[:, None], vectors, reference))
    turns = np.rint((np.einsum("ni,ni->n", axis, reference) - angle) / _FULL)
    return vectors + (_FULL * turns)[:, None] * axis


def continuous(vectors: FloatArray, pairs: IntArray) -> FloatArray:
    """Rotation vectors (n, 3) of the same rotations that are continuous along every connected surface, from those that
    are at most pi long; ``pairs`` (e, 2) of node and neighbour are in both directions.

    The vectors are returned unchanged, to the bit, unless some node turns by more than a quarter of a turn.
    """
    if isinstance(vectors, Tracked):
        return nearest_branch(vectors, continuous(plain(vectors), pairs))
    angle = lengths(vectors)
    if not len(pairs) or not (angle > _CERTAIN).any():
        return vectors
    label = connected_components(len(vectors), pairs)
    turning = np.unique(label[angle > _CERTAIN])
    rows = np.flatnonzero(np.isin(label, turning))
    found = vectors.copy()
    ordered = rows[np.argsort(angle[rows], kind="stable")]
    # From the node of each surface that turns least, every node takes the rotation vector nearest to that of the node
    # from which it is reached first.
    seeds = ordered[np.unique(label[ordered], return_index=True)[1]]
    graph = scipy.sparse.csr_matrix((np.ones(len(pairs), dtype=bool), pairs.T), shape=(len(found),) * 2)
    reached, here = np.zeros(len(found), dtype=bool), seeds
    while len(here):
        reached[here] = True
        start = graph.indptr[here]
        run, place = spans(graph.indptr[here + 1] - start)
        there, before = graph.indices[start[run] + place], here[run]
        new = ~reached[there]
        # In the order in which they are reached.
        first = np.sort(np.unique(there[new], return_index=True)[1])
        there, before = there[new][first], before[new][first]
        turns = lengths(found[there]) > 0.0
        found[there[turns]] = nearest_branch(found[there[turns]], found[before[turns]])
        here = there
    too_far = np.unique(label[lengths(found) > _LARGEST])
    found[np.isin(label, too_far)] = vectors[np.isin(label, too_far)]
    rows = rows[np.argsort(label[rows], kind="stable")]
    surfaces = np.split(rows, np.flatnonzero(np.diff(label[rows])) + 1)
    # Each surface turns the shorter way, or where both are about equally long the way in which the others turn.
    means = [found[rows].mean(axis=0) for rows in surfaces]
    total, count = np.zeros(3), 0
    for index in np.argsort([np.linalg.norm(mean) for mean in means], kind="stable"):
        rows, mean = surfaces[index], means[index]
        if lengths(found[rows]).min() > _CERTAIN:
            # At first a small rotation whose largest component is positive: it decides the sense of half a turn.
            lead = total / count if count else 1e-3 * mean * np.sign(mean[np.argmax(np.abs(mean).round(6))])
            other = mean - _FULL * mean / max(float(np.linalg.norm(mean)), 1e-100)
            if _cost(other, lead) < _cost(mean, lead):
                found[rows] *= 1.0 - _FULL / lengths(found[rows])[:, None]
        total, count = total + found[rows].sum(axis=0), count + len(rows)
    return found


def _cost(mean: FloatArray, lead: FloatArray) -> float:
    apart = mean - lead
    return float(mean @ mean + _AGREEMENT * (apart @ apart))
