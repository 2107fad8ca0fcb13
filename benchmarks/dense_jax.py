"""Inverse distance weighting of rotations and translations (Sen et al. eqs. 16-25) in JAX: dense, exact, differentiated
by it. Its rotations are fitted anew here, so that it also checks ours; jax is optional (`pip install meshdeform[jax]`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from meshdeform_core.grid import FloatArray
from meshdeform_core.methods import IDW, Problem
from meshdeform_core.numerics.rotation import STEEP

OPTIONS = IDW(rotation="quaternion", summation="exact")
"""The options of ours that it agrees with."""
_TARGETS = 256


def dense(problem: Problem, targets: FloatArray, options: IDW = OPTIONS) -> Callable[[Any], Any]:
    """The displacement (n, 3) of ``targets`` (n, 3) as a compiled function of that of the sources (m, 3)."""
    jax.config.update("jax_enable_x64", True)
    x, area = jnp.asarray(problem.source_points), jnp.asarray(problem.surface.area)
    length = float(np.linalg.norm(problem.source_points - problem.centroid, axis=1).max())
    rows = -(-len(targets) // _TARGETS) * _TARGETS
    # Targets in chunks, whose weights are made again on the way back: all of them together would not fit.
    padded = np.concatenate([targets, np.repeat(targets[:1], rows - len(targets), axis=0)])
    chunks = jnp.asarray(padded.reshape(-1, _TARGETS, 3))

    def weights(at: Any) -> Any:
        r = length / jnp.sqrt(((at[:, None] - x) ** 2).sum(axis=2))
        found = area * (r**3.0 + (options.alpha * r) ** 5.0)
        return found / found.sum(axis=1, keepdims=True)

    def displacement(d: Any) -> Any:
        q = _rotations(problem, x, x + d)
        values = jnp.concatenate([q, x + d - _turned(q, x)], axis=1)

        def chunk(at: Any) -> Any:
            mean = weights(at) @ values
            turn = mean[:, :4] / jnp.linalg.norm(mean[:, :4], axis=1, keepdims=True)
            return _turned(turn, at) + mean[:, 4:] - at

        return jax.lax.map(jax.checkpoint(chunk), chunks).reshape(-1, 3)[: len(targets)]

    return jax.jit(displacement)


def _rotations(problem: Problem, before: Any, after: Any) -> Any:
    """Quaternions (m, 4) of the sources: the normal's shortest turn, then the mean turn of the edges about it."""
    edges = problem.surface.edges
    start, end = (_normals(problem, points) for points in (before, after))
    first = _quaternion(1.0 + (start * end).sum(axis=1), jnp.cross(start, end))
    here, there = edges[:, 0], edges[:, 1]
    normal = end[here]
    arm, target = _turned(first[here], before[there] - before[here]), after[there] - after[here]
    whole = (arm**2).sum(axis=1) * (target**2).sum(axis=1)
    arm, target = (v - normal * (normal * v).sum(axis=1, keepdims=True) for v in (arm, target))
    angle = jnp.arctan2((normal * jnp.cross(arm, target)).sum(axis=1), (arm * target).sum(axis=1))
    # Edges steeper than 45 degrees to the tangent plane count less.
    part = jnp.minimum((arm**2).sum(axis=1) * (target**2).sum(axis=1) / whole / STEEP, 1.0)
    weight = part**3 * (10.0 - 15.0 * part + 6.0 * part**2)
    angles, total = (jnp.zeros(len(before)).at[here].add(each) for each in (weight * angle, weight))
    half = 0.5 * angles / jnp.where(total > 0.0, total, 1.0)
    second = jnp.concatenate([jnp.cos(half)[:, None], jnp.sin(half)[:, None] * end], axis=1)
    scalar = second[:, 0] * first[:, 0] - (second[:, 1:] * first[:, 1:]).sum(axis=1)
    vector = second[:, :1] * first[:, 1:] + first[:, :1] * second[:, 1:] + jnp.cross(second[:, 1:], first[:, 1:])
    return jnp.concatenate([scalar[:, None], vector], axis=1)


def _normals(problem: Problem, points: Any) -> Any:
    """Mean unit normals (m, 3) of the faces at the sources; zero where there are none."""
    node, following, previous = problem.surface.corners.T
    normal = jnp.cross(points[following] - points[node], points[previous] - points[node])
    normal = normal / jnp.linalg.norm(normal, axis=1, keepdims=True)
    total = jnp.zeros_like(points).at[node].add(normal)
    square = (total**2).sum(axis=1, keepdims=True)
    return jnp.where(square > 1e-12, total / jnp.sqrt(jnp.where(square > 1e-12, square, 1.0)), 0.0)


def _quaternion(scalar: Any, vector: Any) -> Any:
    found = jnp.concatenate([scalar[:, None], vector], axis=1)
    return found / jnp.linalg.norm(found, axis=1, keepdims=True)


def _turned(q: Any, v: Any) -> Any:
    lift = jnp.cross(q[:, 1:], v)
    return v + 2.0 * (q[:, :1] * lift + jnp.cross(q[:, 1:], lift))
