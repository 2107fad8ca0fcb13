"""The derivative of any prepared method with respect to the displacement of the sources."""

from __future__ import annotations

from ...grid import FloatArray
from ...parallel import require_whole
from ..base import PreparedMethod
from ..gaps import PreparedInGaps
from ..layer import PreparedLayer
from .composite import Derivative, derivative_of_composite
from .gaps import InGapsDerivative


def derivative_of(method: PreparedMethod, displacement: FloatArray) -> Derivative:
    """The derivative of a prepared method at one displacement (n_sources, 3)."""
    if isinstance(method, PreparedLayer):
        # Changes of single sources are not mirrored.
        return derivative_of(method.whole, displacement)
    if not isinstance(method, PreparedInGaps):
        return derivative_of_composite(method, displacement)
    closing = method.closing(displacement)
    if closing is None:
        return derivative_of_composite(method.method, displacement)
    require_whole(method.method._problem.grid.points, "a derivative of a motion that closes a gap")
    return InGapsDerivative(method, closing, displacement)
