"""Derivatives of prepared methods with respect to the displacement of the sources, forward and transposed."""

from .choice import derivative_of
from .composite import Derivative
from .kinks import reason_of

__all__ = ["Derivative", "derivative_of", "reason_of"]
