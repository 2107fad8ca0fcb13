"""What cells in space and in a plane have in common: f of a map and its derivatives as functions of |A|^2 and D, and
rows of arrays as eight cells at a time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from llvmlite import ir

from ...lanes import NARROW as WIDTH
from ...lanes import Array, Lanes, Mask

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


def add(array: Array, first: int, values: np.ndarray, node: ir.Value | None = None) -> None:
    """Add ``values`` to the rows of a node, see :func:`load`."""
    at = _start(array, node, values.shape)
    for n, value in enumerate(values.ravel()):
        array.add(at, value, (first + n) * WIDTH)


def _start(array: Array, node: ir.Value | None, shape: tuple[int, ...]) -> ir.Value:
    return ir.IntType(64)(0) if node is None else array.builder.mul(node, node.type(math.prod(shape) * WIDTH))


def at_corner(points: Array, corner: ir.Value, d: int, *_: Array) -> tuple[list[ir.Value], list[np.ndarray]]:
    """A corner and the ends of its edges, and the vectors (d, d) along these in the deformed, the undeformed and the
    reference cells, whose coordinates are rows of ``points`` (GRIDS, 2^d, d, WIDTH)."""
    nodes = [corner, *(points.builder.xor(corner, corner.type(1 << axis)) for axis in reversed(range(d)))]
    grids = [[load(points, grid * (d << d), (d,), node) for node in nodes] for grid in range(GRIDS)]
    return nodes, [np.array(ends) - here for here, *ends in grids]


def add_to_nodes(result: Array, first: int, nodes: list[ir.Value], force: np.ndarray, second: np.ndarray) -> None:
    """Add first derivatives (d, d), from row ``first`` on, and second ones (d, d, d, d) with respect to the vectors of
    :func:`at_corner`."""
    here, *ends = nodes
    add(result, first, force.sum(axis=0) * -1.0, here)
    to_here = second.sum(axis=1) * -1.0
    add_pair(result, here, here, to_here.sum(axis=0) * -1.0)
    for k, end in enumerate(ends):
        add(result, first, force[k], end)
        add_pair(result, end, here, to_here[k])
        for m in range(k, len(ends)):
            add_pair(result, end, ends[m], second[k, m])


def add_pair(result: Array, one: ir.Value, other: ir.Value, values: np.ndarray) -> None:
    """Add second derivatives (d, d) with respect to two nodes of a cell to the rows of their pair."""
    builder, kind, d = result.builder, one.type, len(values)
    turned = builder.icmp_unsigned(">", one, other)
    low, high = builder.select(turned, other, one), builder.select(turned, one, other)
    # Before the pairs of a node are those of lower ones, each of which has one less than the one before.
    before = builder.lshr(builder.mul(low, builder.sub(kind((2 << d) - 1), low)), kind(1))
    first = builder.mul(builder.add(before, high), kind(d * d * WIDTH))
    down, across = (builder.select(turned, kind(a * WIDTH), kind(b * WIDTH)) for a, b in ((1, d), (d, 1)))
    for (i, j), value in np.ndenumerate(values):
        result.add(builder.add(first, builder.add(builder.mul(down, kind(i)), builder.mul(across, kind(j)))), value)


def regular(det: Lanes, eps: Lanes) -> tuple[Lanes, Lanes]:
    """chi and sqrt(eps^2 + D^2), computed without cancellation."""
    root = (eps * eps + det * det).sqrt()
    return (det * 0.0).below(det).choose(0.5 * (det + root), 0.5 * eps * eps / (root - det)), root


def add_energy(
    sums: Array, terms: Array, weights: int, counts: Mask, det: Lanes, chi: Lanes, f: Lanes, strain: np.ndarray,
    share: Lanes, cubic: Lanes, elastic: Lanes,
) -> None:  # fmt: skip
    """Add the energy of cells at a sample point, where it ``counts``, to ``sums`` (3, WIDTH): the energy, the smallest
    D, the largest f. w and the factor of the elastic energy are in row ``weights`` of ``terms`` and the next."""
    (total, lowest, highest), [weight, held] = load(sums, 0, (3,)), load(terms, weights, (2,))
    f = (chi * 0.0).below(chi).choose(f, det * 0.0 + math.inf)
    total = total + counts.choose(share * (weight * f + cubic * growth(f)[0]), 0.0)
    total = total + counts.choose(0.5 * elastic * held * (strain * strain).sum(), 0.0)
    lowest, highest = lowest.min(counts.choose(det, det * 0.0 + math.inf)), highest.max(counts.choose(f, 0.0))
    for row, value in enumerate((total, lowest, highest)):
        sums.store(ir.IntType(64)(0), value, row * WIDTH)
