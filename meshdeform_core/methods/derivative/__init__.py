"""Derivatives of prepared methods with respect to the displacement of the sources, forward and transposed."""

from __future__ import annotations

from ...grid import FloatArray
from ..base import PreparedMethod
from ..gaps import PreparedInGaps
from .composite import Derivative, derivative_of_composite
from .gaps import InGapsDerivative

__all__ = ["Derivative", "derivative_of"]


def derivative_of(method: PreparedMethod, displacement: FloatArray) -> Derivative:
    """The derivative of a prepared method at one displacement (n_sources, 3).

    Raises
    ------
    MethodError
        For options without a derivative: greedy reduction, and weights that are recomputed on the way.
    """
    if not isinstance(method, PreparedInGaps):
        return derivative_of_composite(method, displacement)
    closing = method.closing(displacement)
    if closing is None:
        return derivative_of_composite(method.method, displacement)
    return InGapsDerivative(method, closing, displacement)
