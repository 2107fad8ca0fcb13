"""Derivatives of prepared methods with respect to the displacement of the sources, forward and transposed."""

from .choice import derivative_of
from .composite import Derivative
from .steps import StepsDerivative

__all__ = ["Derivative", "StepsDerivative", "derivative_of"]
