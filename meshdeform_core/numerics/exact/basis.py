"""Radial basis functions (Sen et al. Table I) of squared distances.

The function is chosen by an integer, because numba cannot cache compiled loops that take functions as arguments.
"""

import math

from ..jit import fast_kernel
from .elementary import log

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
