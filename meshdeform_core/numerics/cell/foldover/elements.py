"""What cells in space and in a plane have in common: f of a map and its derivatives as functions of |A|^2 and D, and
rows of arrays as eight cells at a time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from llvmlite import ir

from ...lanes import NARROW as WIDTH
from ...lanes import Array, Lanes

GRIDS = 3
"""Grids, deformed, undeformed and reference: ``points`` (GRIDS, 2^d, d, WIDTH) are the corners of eight cells."""


def growth(f: Any) -> tuple[Any, Any, Any]:
    """p^3 / (1 + p / 4), p = f - 2, and its two derivatives."""
    p = f - 2.0
    q = 1.0 + 0.25 * p
    return p * p * p / q, p * p * (3.0 + 0.5 * p) / (q * q), p * (6.0 + p * (1.5 + 0.125 * p)) / (q * q * q)


def slopes(g: Any, det: Any, chi: Any, root: Any, h: Any) -> tuple[Any, Any, Any, Any, Any, Any, Any]:
    """f of a sample in space and its derivatives; g = |A|^2, ``root`` sqrt(eps^2 + D^2), ``h`` chi^(-2/3).

    The gradient is u A + v K with the cofactors K of A, the Hessian w I + q (A K^T + K A^T) + r K K^T plus v times the
    derivative of K. Returns f, u, v, w, q, r, and the least r for which the Hessian without the last term is convex.
    """
    h1 = -2.0 / 3.0 * h / root
    h2 = 2.0 / 3.0 * h * (2.0 / 3.0 + det / root) / (root * root)
    whole = det * det + 1.0
    q1 = (2.0 * det - whole / root) / chi
    q2 = (2.0 - 2.0 * det / root + whole * det / (root * root * root)) / chi - q1 / root
    f, u, q = g * h / 3.0 + 0.5 * whole / chi, 2.0 / 3.0 * h, 2.0 / 3.0 * h1
    return f, u, g * h1 / 3.0 + 0.5 * q1, u, q, g * h2 / 3.0 + 0.5 * q2, 2.0 / 3.0 * h1 * h1 / h * g


def plane_slopes(g: Any, det: Any, chi: Any, root: Any) -> tuple[Any, Any, Any, Any, Any, Any]:
    """As :func:`slopes`, of a sample in a plane: f, u, v, w, q and r."""
    f, u = 0.5 * (g + det * det + 1.0) / chi, 1.0 / chi
    r = 1.0 / chi - 2.0 * det / (chi * root) + f * (1.0 + det / root) / (root * root)
    return f, u, det / chi - f / root, u, -1.0 / (chi * root), r


def combined(of_f: Sequence[Any], one: Any, two: Any) -> tuple[Any, Any, Any, Any, Any, Any]:
    """u, v, w, p, q, r as from :func:`slopes`, for a function of f with the derivatives ``one`` and ``two`` from those
    of f (u, v, w, q and r); p is the factor of A A^T in the Hessian."""
    u, v, w, q, r = of_f
    return u * one, v * one, w * one, two * u * u, q * one + two * u * v, r * one + two * v * v


def load(array: Array, first: int, shape: tuple[int, ...], node: ir.Value | None = None) -> np.ndarray:
    """Rows of an array (n, WIDTH) from ``first`` on, as an array of :class:`Lanes`; those of a ``node`` are as many
    times farther on as its number says. Of a product with a number, the array is the first factor."""
    at, size = _start(array, node, shape), math.prod(shape)
    return np.array([array.load(at, (first + n) * WIDTH) for n in range(size)], dtype=object).reshape(shape)


def store(array: Array, first: int, values: Any) -> None:
    """Store arrays of :class:`Lanes` as rows of an array (n, WIDTH) from ``first`` on."""
    for n, value in enumerate(np.ravel(values)):
        array.store(ir.IntType(64)(0), value, (first + n) * WIDTH)


def add(array: Array, first: int, values: np.ndarray, node: ir.Value | None = None) -> None:
    """Add ``values`` to the rows of a node, see :func:`load`."""
    at = _start(array, node, values.shape)
    for n, value in enumerate(values.ravel()):
        array.add(at, value, (first + n) * WIDTH)


def _start(array: Array, node: ir.Value | None, shape: tuple[int, ...]) -> ir.Value:
    return ir.IntType(64)(0) if node is None else array.builder.mul(node, node.type(math.prod(shape) * WIDTH))


def slopes_of(slope: Array, sample: ir.Value, node: ir.Value, d: int) -> np.ndarray:
    """The derivatives (d,) of a node's shape function along the index axes, the same for all cells."""
    builder = slope.builder
    place = builder.mul(builder.add(builder.mul(sample, sample.type(1 << d)), node), sample.type(d))
    return np.array([slope.every(place, k) for k in range(d)])


def vectors_at(points: Array, slope: Array, sample: ir.Value, d: int) -> tuple[np.ndarray, list[np.ndarray]]:
    """The slopes (2^d, d) of the shape functions at a sample point, and the vectors (d, d) along the index axes of the
    deformed, the undeformed and the reference cells, whose coordinates are rows of ``points`` (3, 2^d, d, WIDTH)."""
    weights = np.array([slopes_of(slope, sample, sample.type(n), d) for n in range(1 << d)])
    grids = [load(points, grid * (d << d), (1 << d, d)) for grid in range(GRIDS)]
    return weights, [np.array([w[:, None] * p for w, p in zip(weights, x, strict=True)]).sum(axis=0) for x in grids]


def regular(det: Lanes, eps: Lanes) -> tuple[Lanes, Lanes]:
    """chi and sqrt(eps^2 + D^2), computed without cancellation."""
    root = (eps * eps + det * det).sqrt()
    return (det * 0.0).below(det).choose(0.5 * (det + root), 0.5 * eps * eps / (root - det)), root
