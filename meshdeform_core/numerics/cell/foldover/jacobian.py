"""f of a map and its derivatives as functions of |A|^2 and D, for arrays and for eight numbers at a time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any


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


def slopes_of_triangle(g: Any, det: Any, chi: Any, root: Any) -> tuple[Any, Any, Any, Any, Any, Any]:
    """As :func:`slopes`, of a sample in a plane: f, u, v, w, q and r."""
    f, u = 0.5 * (g + det * det + 1.0) / chi, 1.0 / chi
    r = 1.0 / chi - 2.0 * det / (chi * root) + f * (1.0 + det / root) / (root * root)
    return f, u, det / chi - f / root, u, -1.0 / (chi * root), r


def combined(of_f: Sequence[Any], one: Any, two: Any) -> tuple[Any, Any, Any, Any, Any, Any]:
    """u, v, w, p, q, r as from :func:`slopes`, for a function of f with the derivatives ``one`` and ``two`` from those
    of f (u, v, w, q and r); p is the factor of A A^T in the Hessian."""
    u, v, w, q, r = of_f
    return u * one, v * one, w * one, two * u * u, q * one + two * u * v, r * one + two * v * v
