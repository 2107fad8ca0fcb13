"""Choice among equivalent rotation vectors, so that they are continuous along surfaces.

A rotation by 190 degrees equals one by -170 degrees about the same axis. The logarithm of a matrix or quaternion yields
the smaller angle, node by node, so adjacent nodes of a surface that turns by about 180 degrees may appear to turn in
opposite directions.
"""

from __future__ import annotations

import math

import numpy as np
import scipy

from .arrays import FloatArray, IntArray, lengths, spans
from .geometry.coincidence import connected_components
from .tape import Tracked, plain

_FULL = 2 * math.pi
_CERTAIN = 0.5 * math.pi
"""Nodes that turn by less fix the branch of their surface, which is attached to a resting one or nearly at rest."""
_LARGEST = 0.9 * _FULL
"""Near a full turn a translation cannot be told from a rotation about a distant axis."""
_AGREEMENT = 0.05
"""Weight of the difference between surfaces against the angle itself: bodies that turn by 179 and 181 degrees in a
fixed box agree, two that turn against each other by up to about 170 degrees keep doing so."""


def nearest_branch(vectors: FloatArray, reference: FloatArray) -> FloatArray:
    """Rotation vectors (n, 3) of the same rotations, those nearest to ``reference`` (n, 3)."""
    angle = lengths(vectors)
    # A rotation by zero has any axis.
    axis = np.where((angle > 0.0)[:, None], vectors, reference)
    axis = np.divide(axis, lengths(axis)[:, None], out=np.zeros_like(axis), where=lengths(axis)[:, None] > 0.0)
    turns = np.rint((np.einsum("ni,ni->n", axis, reference) - angle) / _FULL)
    return vectors + (_FULL * turns)[:, None] * axis


def continuous(vectors: FloatArray, pairs: IntArray) -> FloatArray:
    """Rotation vectors (n, 3) of the same rotations that are continuous along every connected surface.

    The vectors are returned unchanged, to the bit, unless some node turns by more than a quarter of a turn.

    Parameters
    ----------
    vectors : (n, 3) radians, at most pi long
    pairs : (e, 2) int64 node and neighbour, in both directions
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
    _turn_alike(found, np.split(rows, np.flatnonzero(np.diff(label[rows])) + 1))
    return found


def _turn_alike(vectors: FloatArray, surfaces: list[IntArray]) -> None:
    """Choose the direction in which each surface turns, in place: the shorter way, or where both are about equally long
    the way in which the other surfaces turn."""
    means = [vectors[rows].mean(axis=0) for rows in surfaces]
    total, count = np.zeros(3), 0
    for index in np.argsort([np.linalg.norm(mean) for mean in means], kind="stable"):
        rows, mean = surfaces[index], means[index]
        if lengths(vectors[rows]).min() > _CERTAIN:
            # At first a small rotation whose largest component is positive: it decides the sense of half a turn.
            lead = total / count if count else 1e-3 * mean * np.sign(mean[np.argmax(np.abs(mean).round(6))])
            other = mean - _FULL * mean / max(float(np.linalg.norm(mean)), 1e-100)
            if _cost(other, lead) < _cost(mean, lead):
                angle = lengths(vectors[rows])[:, None]
                vectors[rows] *= 1.0 - _FULL / angle
        total, count = total + vectors[rows].sum(axis=0), count + len(rows)


def _cost(mean: FloatArray, lead: FloatArray) -> float:
    apart = mean - lead
    return float(mean @ mean + _AGREEMENT * (apart @ apart))
