"""Partial derivatives of numpy's elementwise functions, for :mod:`.tape`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np


def quotient(a: Any, b: Any) -> Any:
    """a / b, zero where b is."""
    b = np.asarray(b)
    return np.where(b != 0.0, a / np.where(b != 0.0, b, 1.0), 0.0)


FIXED = frozenset(
    [
        "less",
        "less_equal",
        "greater",
        "greater_equal",
        "equal",
        "not_equal",
        "isfinite",
        "isnan",
        "rint",
        "sign",
        "floor",
        "ceil",
        "logical_not",
    ]
)
"""Functions with zero derivative almost everywhere."""
PARTIALS: dict[str, Callable[..., tuple[Any, ...]]] = {
    "add": lambda y, a, b: (1.0, 1.0),
    "subtract": lambda y, a, b: (1.0, -1.0),
    "multiply": lambda y, a, b: (b, a),
    "divide": lambda y, a, b: (1.0 / np.asarray(b), -np.asarray(a) / np.asarray(b) ** 2),
    "negative": lambda y, a: (-1.0,),
    "absolute": lambda y, a: (np.sign(a),),
    "sqrt": lambda y, a: (quotient(0.5, y),),
    "sin": lambda y, a: (np.cos(a),),
    "cos": lambda y, a: (-np.sin(a),),
    "power": lambda y, a, n: (n * a ** (n - 1.0), 0.0),
    "square": lambda y, a: (2.0 * a,),
    "arctan2": lambda y, a, b: (quotient(b, a**2 + b**2), -quotient(a, a**2 + b**2)),
    "maximum": lambda y, a, b: ((np.asarray(a) >= b) * 1.0, (np.asarray(a) < b) * 1.0),
    "minimum": lambda y, a, b: ((np.asarray(a) <= b) * 1.0, (np.asarray(a) > b) * 1.0),
}
MATMUL = {(1, 1): "i,i->", (1, 2): "i,ij->j", (2, 1): "ij,j->i", (2, 2): "ij,jk->ik"}
"""Rule of ``einsum`` for products of matrices and vectors, by the numbers of dimensions of the two operands."""
