"""Derivatives of prepared methods with respect to the displacement of the sources, forward and transposed."""

from .composite import Derivative, derivative_of

__all__ = ["Derivative", "derivative_of"]
