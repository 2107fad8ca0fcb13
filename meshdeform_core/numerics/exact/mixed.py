"""Weighted sums with weights in single precision, whose products with charges are added in double precision.

They serve derivatives, where sums over sources and sums over targets must be transposes of each other. Every pair of
points takes the same instructions whichever of the two is the target, so its weight is the same to the last bit, and
the two sums are transposes to the round-off of double precision.

Coordinates, relative to the middle of all points and in units of their extent, are stored as a single-precision number
and its remainder; together they resolve 2e-15 of the extent.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from llvmlite import ir
from numba.core import cgutils

from ..arrays import FloatArray
from ..jit import kernel
from ..lanes import WIDTH, Array, Lanes, lanes

# Vectors of sources in a tile, which stays in the first-level cache while all targets of a group are summed.
_TILE = 16
_CHARGES = 8


class Scale(NamedTuple):
    """``center`` (3,) of some points, and ``unit``, the power of two that scales them into a unit cube."""

    center: np.ndarray
    unit: float


def scale_of(parts: Sequence[FloatArray]) -> Scale:
    """:class:`Scale` of the points of all ``parts`` (n, 3)."""
    low = np.min([part.min(axis=0) for part in parts if len(part)], axis=0)
    high = np.max([part.max(axis=0) for part in parts if len(part)], axis=0)
    return Scale(0.5 * (low + high), float(np.ldexp(1.0, -np.frexp((high - low).max())[1])))


@lanes
def _add_tile(
    near: Array, charges: Array, count: ir.Value, x: Lanes, y: Lanes, z: Lanes, x_rest: Lanes, y_rest: Lanes,
    z_rest: Lanes, three: Lanes, four: Lanes, five: Lanes, all_charges: ir.Value, out: Array, at: ir.Value,
) -> None:  # fmt: skip
    """Add to eight numbers of ``out`` the sums over ``count`` vectors of sources."""
    builder, integer = x.builder, count.type

    def number(value: int) -> ir.Value:
        return ir.Constant(integer, value)

    def over(columns: range) -> None:
        zero = ir.Constant(ir.VectorType(ir.DoubleType(), WIDTH), [0.0] * WIDTH)
        totals = [cgutils.alloca_once_value(builder, zero) for _ in columns]
        for total in totals:
            builder.store(zero, total)
        with cgutils.for_range(builder, count) as loop:
            place, row = (builder.mul(loop.index, number(n * WIDTH)) for n in (6, _CHARGES))
            delta = [
                (one - near.load(place, d * WIDTH)) + (rest - near.load(place, (3 + d) * WIDTH))
                for d, (one, rest) in enumerate(((x, x_rest), (y, y_rest), (z, z_rest)))
            ]
            r = 1.0 / (delta[0] * delta[0] + delta[1] * delta[1] + delta[2] * delta[2]).sqrt()
            weight = (r * (r * r) * (three + r * (four + five * r))).double()
            for column, total in zip(columns, totals, strict=True):
                more = weight * charges.load(row, column * WIDTH)
                builder.store((Lanes(builder, builder.load(total)) + more).value, total)
        for column, total in zip(columns, totals, strict=True):
            out.add_one(at, Lanes(builder, builder.load(total)).total(), column)

    with builder.if_else(builder.icmp_signed("!=", all_charges, ir.Constant(all_charges.type, 0))) as (every, most):
        with every:
            over(range(_CHARGES))
        with most:
            over(range(1, _CHARGES - 1))


@kernel
def sum_groups_mixed(targets, target_span, charged, pieces, piece_span, scale, a, kappa, all_charges, out):
    """Add to ``out`` (n, 8) the sums of charge * (r^-a + kappa r^-5), a = 3 or 4: as :func:`.direct.sum_groups`.

    In units of ``scale``, inverse distances to the fifth power must not overflow single precision; otherwise the sums
    are not finite.
    """
    near, charges = np.empty((_TILE, 6, WIDTH), np.float32), np.empty((_TILE, _CHARGES, WIDTH))
    target = np.empty(6, np.float32)
    unit = scale.unit
    three, four = np.float32(1.0 if a == 3.0 else 0.0), np.float32(0.0 if a == 3.0 else unit)
    five, back = np.float32(kappa * unit * unit), unit * unit * unit
    for group in range(target_span.shape[0]):
        piece, end = piece_span[group, 0], piece_span[group, 1]
        at = pieces[piece, 0] if piece < end else 0
        while piece < end:
            m = 0
            while piece < end and m < _TILE * WIDTH:
                more = min(pieces[piece, 1] - at, _TILE * WIDTH - m)
                for s in range(more):
                    vector, lane = (m + s) // WIDTH, (m + s) % WIDTH
                    for d in range(3):
                        value = (charged[at + s, d] - scale.center[d]) * unit
                        near[vector, d, lane] = np.float32(value)
                        near[vector, 3 + d, lane] = np.float32(value - np.float64(near[vector, d, lane]))
                    for c in range(_CHARGES):
                        charges[vector, c, lane] = back * charged[at + s, 3 + c]
                m += more
                at += more
                if at == pieces[piece, 1]:
                    piece += 1
                    at = pieces[min(piece, end - 1), 0]
            # The remainder of a vector is filled with copies of the first source, with zero charges.
            vectors = (m + WIDTH - 1) // WIDTH
            for s in range(m, vectors * WIDTH):
                for row in range(6):
                    near[s // WIDTH, row, s % WIDTH] = near[0, row, 0]
                for c in range(_CHARGES):
                    charges[s // WIDTH, c, s % WIDTH] = 0.0
            for t in range(target_span[group, 0], target_span[group, 1]):
                for d in range(3):
                    value = (targets[t, d] - scale.center[d]) * unit
                    target[d] = np.float32(value)
                    target[3 + d] = np.float32(value - np.float64(target[d]))
                _add_tile(
                    near, charges, vectors, target[0], target[1], target[2], target[3], target[4], target[5],
                    three, four, five, 1 if all_charges else 0, out, t * _CHARGES,
                )  # fmt: skip
