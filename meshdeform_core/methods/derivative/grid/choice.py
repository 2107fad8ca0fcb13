"""The derivative of any prepared method with respect to the displacement of the sources and to the grid."""

from __future__ import annotations

from ....grid import FloatArray
from ...base import PreparedMethod
from ...gaps import PreparedInGaps
from .composite import GridDerivative, grid_derivative_of_composite
from .gaps import InGapsGridDerivative


def grid_derivative_of(method: PreparedMethod, displacement: FloatArray) -> GridDerivative:
    """The derivative at one displacement (n_sources, 3) of the sources.

    Raises
    ------
    MethodError
        For radial basis functions whose centres follow the grid abruptly.
    """
    if not isinstance(method, PreparedInGaps):
        return grid_derivative_of_composite(method, displacement)
    closing = method.closing(displacement)
    if closing is None:
        return grid_derivative_of_composite(method.method, displacement)
    return InGapsGridDerivative(method, closing, displacement)
