"""Radial basis functions (Sen et al. Table I) of squared distances.

The function is chosen by an integer, because numba cannot cache compiled loops that take functions as arguments.
Logarithm and exponential have no branches, so that loops over them are vectorised.
"""

from __future__ import annotations

import math
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from ..jit import contracted_kernel, fast_kernel

BASES = {"tps": 0, "wendland-c0": 1, "wendland-c2": 2, "ctps-c1": 3, "ctps-c2a": 4, "ctps-c2b": 5}
"""Names and kernel numbers; all but ``tps`` have compact support."""


@fast_kernel
def apply_basis(kind, r2, n):
    """Replace ``r2[:n]``, squared distances in units of the squared support radius (TPS: any unit), by basis values.

    One loop per function, chosen once per call: a branch inside the loop would prevent vectorisation.
    """
    if kind == 0:
        for i in range(n):
            r2[i] = 0.5 * r2[i] * log(r2[i])
    elif kind == 1:
        for i in range(n):
            r = math.sqrt(_inside(r2[i]))
            r2[i] = (1.0 - r) * (1.0 - r)
    elif kind == 2:
        for i in range(n):
            r = math.sqrt(_inside(r2[i]))
            q = (1.0 - r) * (1.0 - r)
            r2[i] = q * q * (4.0 * r + 1.0)
    elif kind == 3:
        for i in range(n):
            s = _inside(r2[i])
            r = math.sqrt(s)
            r2[i] = 1.0 + s * (80.0 / 3.0 - 40.0 * r + 15.0 * s - 8.0 / 3.0 * s * r + 10.0 * log(s))
    elif kind == 4:
        for i in range(n):
            s = _inside(r2[i])
            r = math.sqrt(s)
            r2[i] = 1.0 + s * (-30.0 - 10.0 * r + 45.0 * s - 6.0 * s * r - 30.0 * r * log(s))
    else:
        for i in range(n):
            s = _inside(r2[i])
            r = math.sqrt(s)
            r2[i] = 1.0 + s * (-20.0 + 80.0 * r - 45.0 * s - 16.0 * s * r + 30.0 * s * log(s))


@fast_kernel
def _inside(r2):
    """Squared distance cut off at the support radius, where the compact functions are zero."""
    return r2 if r2 < 1.0 else 1.0


@intrinsic
def _bits(typing_context, value):
    """The 64 bits of a float64 as an integer."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.bitcast(arguments[0], ir.IntType(64))

    return types.int64(types.float64), generate


@intrinsic
def _from_bits(typing_context, value):
    """The float64 with the given 64 bits."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.bitcast(arguments[0], ir.DoubleType())

    return types.float64(types.int64), generate


@contracted_kernel
def log(x):
    """Natural logarithm of a positive normal number.

    ``x = 2^e m`` with m in [sqrt(1/2), sqrt(2)); log m = 2 artanh((m - 1) / (m + 1)). Error below 1e-15 relative; the
    value at 0 is finite (about -709), as x log x needs it.
    """
    bits = _bits(x)
    # Shift the mantissa range from [1, 2) to [sqrt(1/2), sqrt(2)).
    shifted = bits - 0x3FE6A09E667F3BCD
    exponent = shifted >> 52
    m = _from_bits(bits - (exponent << 52))
    # The exponent as a float64 by its bits: vector units have no conversion from 64-bit integers.
    e = _from_bits((exponent + 2048) | 0x4330000000000000) - (4503599627370496.0 + 2048.0)
    s = (m - 1.0) / (m + 1.0)
    z = s * s
    tail = 1.0 / 15.0 + z * (1.0 / 17.0 + z * (1.0 / 19.0 + z * (1.0 / 21.0)))
    series = 1.0 / 3.0 + z * (
        1.0 / 5.0 + z * (1.0 / 7.0 + z * (1.0 / 9.0 + z * (1.0 / 11.0 + z * (1.0 / 13.0 + z * tail))))
    )
    return e * 0.6931471805599453 + 2.0 * s * (1.0 + z * series)


@contracted_kernel
def exp(x):
    """Exponential for -700 < x < 700; error below 1e-15 relative.

    ``x = k log 2 + t`` with abs(t) <= log(2) / 2, exp t by its series.
    """
    # Adding 1.5 * 2^52 rounds to the nearest integer, which then lies in the low bits.
    shifted = x * 1.4426950408889634 + 6755399441055744.0
    k = shifted - 6755399441055744.0
    # log 2 in two parts: the product with the first is exact.
    t = (x - k * 0.6931471803691238) - k * 1.9082149292705877e-10
    tail = 1.0 / 3628800.0 + t * (1.0 / 39916800.0 + t * (1.0 / 479001600.0 + t * (1.0 / 6227020800.0)))
    series = 1.0 / 720.0 + t * (1.0 / 5040.0 + t * (1.0 / 40320.0 + t * (1.0 / 362880.0 + t * tail)))
    series = 1.0 + t * (1.0 + t * (0.5 + t * (1.0 / 6.0 + t * (1.0 / 24.0 + t * (1.0 / 120.0 + t * series)))))
    return _from_bits(_bits(series) + (_bits(shifted) << 52))
