"""Node distributions along a line."""

import numpy as np
from scipy.optimize import brentq

from meshdeform_core.grid import FloatArray


def even(span: tuple[float, float], size: int) -> FloatArray:
    """Nodes over ``span``, ``size`` cells per unit: whole multiples of a cell, so that neighbouring blocks agree to the
    last bit."""
    return np.arange(round(span[0] * size), round(span[1] * size) + 1) / size


def geometric(first: float, cells: int, length: float) -> FloatArray:
    """``cells`` + 1 nodes from 0 to ``length`` in geometric progression, the first cell of size ``first``."""

    def excess(log_ratio: float) -> float:
        # At the far end of the bracket the sum may be infinite, which counts as too long.
        with np.errstate(over="ignore"):
            return float(first * np.exp(log_ratio * np.arange(cells)).sum() - length)

    ratio = brentq(excess, -5.0, 5.0)
    nodes = np.concatenate([[0.0], np.cumsum(first * np.exp(ratio * np.arange(cells)))])
    return np.asarray(nodes * (length / nodes[-1]))


def tanh_law(first: float, cells: int, length: float) -> FloatArray:
    """``cells`` + 1 nodes from 0 to ``length`` by the one-sided hyperbolic tangent law, first cell ``first``."""
    s = np.arange(cells + 1) / cells

    def nodes(beta: float) -> FloatArray:
        return np.asarray(length * (1.0 + np.tanh(beta * (s - 1.0)) / np.tanh(beta)))

    beta = brentq(lambda b: float(nodes(b)[1] - first), 1e-3, 50.0)
    return nodes(beta)
