"""Derivatives of prepared methods with respect to the displacement of the sources, forward and transposed."""

from .choice import derivative_of
from .composite import Derivative
from .kinks import reason_of
from .steps import ComponentsInSteps, StepsDerivative, derivative_of_steps

__all__ = ["ComponentsInSteps", "Derivative", "StepsDerivative", "derivative_of", "derivative_of_steps", "reason_of"]
