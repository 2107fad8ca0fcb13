"""What cells in space and in a plane have in common: f of a map and its derivatives as functions of |A|^2 and D, rows
of arrays as eight cells at a time, and where the derivatives of cells go: the rows of a block-sparse matrix."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numpy.typing import NDArray

from ...arrays import IntArray
from ...jit import inlined, record
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


@record("i8[::1], f8[:, :, ::1], b1[::1]")
class Unknowns(NamedTuple):
    """The unknowns of a region's n nodes: ``number`` (n,), the unknown of each node or -1; ``frame`` (n, d, d), with
    displacement = frame @ unknown; ``plain`` (n,), whether the frame is the identity."""

    number: np.ndarray
    frame: np.ndarray
    plain: np.ndarray


@inlined
def gather_cell(x, start, reference, cell, points, lane):
    """The corners of a cell in three grids."""
    for n in range(points.shape[1]):
        for d in range(points.shape[2]):
            points[0, n, d, lane] = x[cell[n], d]
            points[1, n, d, lane] = start[cell[n], d]
            points[2, n, d, lane] = reference[cell[n], d]


@inlined
def weigh_cell(mask, weight, c, corners, terms, lane):
    """Rows of ``terms``: the share of the energy at the sample points of a cell, 0 where they do not count, w, and the
    factor of the elastic energy; returns the mask."""
    samples = terms.shape[0] - 2
    for s in range(samples):
        terms[s, lane] = float(mask >> s & 1) * (1.0 if s < corners else weight[c, 1])
    terms[samples, lane], terms[samples + 1, lane] = weight[c, 0], weight[c, 2]
    return mask


def places_of_pairs(unknowns: IntArray, starts: IntArray, columns: NDArray[np.int32]) -> NDArray[np.int32]:
    """Where a matrix in the BSR format has the blocks (m, p) of pairs of the ``unknowns`` (m, 2^d) of cells, on and
    above its diagonal; -1 for pairs with one that is -1. Pairs of nodes are in ascending order."""
    n, pairs = len(starts) - 1, list(itertools.combinations_with_replacement(range(unknowns.shape[1]), 2))
    blocks = np.repeat(np.arange(n) * n, np.diff(starts))
    blocks += columns
    places = np.empty((len(unknowns), len(pairs)), np.int32)
    for pair, ends in enumerate(pairs):
        low, high = (of(*unknowns[:, ends].T) for of in (np.minimum, np.maximum))
        places[:, pair] = np.where(low < 0, -1, np.searchsorted(blocks, low * n + high))
    return places


@inlined
def add_element(nodes, places, c, corners, d, found, lane, force, work, unknowns, rows, matrix, gradient):
    """Add the derivatives of a cell to the rows of its unknowns; see :func:`.hexahedra.add_derivatives`.

    ``nodes[c]`` are its ``corners``, in ``d`` dimensions; in a ``lane`` of ``found`` the second derivatives (d, d)
    for pairs of nodes in ascending order, from the row ``force`` on the first ones (m, d); ``work`` (3, 3) is room.
    """
    number, frame, plain = unknowns
    pair = 0
    for n in range(corners):
        here = nodes[c, n]
        row = number[here]
        if row >= rows[0] and row < rows[1]:
            for i in range(d):
                for k in range(d):
                    gradient[row, i] += frame[here, k, i] * found[force + d * n + k, lane]
        for o in range(n, corners):
            at, first, there = places[c, pair] - rows[2], d * d * pair, nodes[c, o]
            pair += 1
            if at < 0 or at >= len(matrix):
                continue
            if not (plain[here] and plain[there]):
                _turn(frame, here, there, d, found, lane, first, work)
            if row <= number[there]:
                for i in range(d):
                    for k in range(d):
                        matrix[at, i, k] += found[first + d * i + k, lane]
            # Two nodes with the same unknown have both blocks on the diagonal.
            if row > number[there] or (n != o and row == number[there]):
                for i in range(d):
                    for k in range(d):
                        matrix[at, k, i] += found[first + d * i + k, lane]


@inlined
def _turn(frame, one, two, d, found, lane, first, work):
    """``B = F^T B G`` for the matrix B (d, d) of numbers of ``found`` and the frames F, G of nodes ``one``, ``two``."""
    for i in range(d):
        for k in range(d):
            work[i, k] = 0.0
            for e in range(d):
                work[i, k] += frame[one, e, i] * found[first + d * e + k, lane]
    for i in range(d):
        for k in range(d):
            total = 0.0
            for e in range(d):
                total += work[i, e] * frame[two, e, k]
            found[first + d * i + k, lane] = total
