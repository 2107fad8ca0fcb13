"""The derivative of any prepared method with respect to the displacement of the sources."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...grid import FloatArray
from ...grid.connectivity.components import assembled
from ...parallel import require_whole
from ..base import PreparedMethod
from ..components import PreparedComponents
from ..gaps import PreparedInGaps
from .composite import Derivative, derivative_of_composite
from .gaps import InGapsDerivative
from .kinks import Kinks


def derivative_of(method: PreparedMethod, displacement: FloatArray) -> Derivative:
    """The derivative of a prepared method at one displacement (n_sources, 3)."""
    if isinstance(method, PreparedComponents):
        require_whole(method.problem.grid.points, "a derivative of overset components")
        return ComponentsDerivative(
            method, [derivative_of(own, displacement[rows]) if own else None for _, own, rows in method.parts]
        )
    if not isinstance(method, PreparedInGaps):
        return derivative_of_composite(method, displacement)
    closing = method.closing(displacement)
    if closing is None:
        return derivative_of_composite(method.method, displacement)
    require_whole(method.method._problem.grid.points, "a derivative of a motion that closes a gap")
    return InGapsDerivative(method, closing, displacement)


class ComponentsDerivative:
    """Derivative of every component with respect to the displacement of its own sources; ``own`` holds the derivatives
    of the components, ``None`` for those at rest."""

    def __init__(self, method: PreparedComponents, own: Sequence[Derivative | None]) -> None:
        self._method, self._grid, self._own = method, method.problem.grid, own
        self.kinks = sum((each.kinks for each in own if each), Kinks())

    def push(self, change: FloatArray) -> FloatArray:
        """Change (n_nodes, 3) for a ``change`` (n_sources, 3) of the sources."""
        moved = []
        for ((component, _), _, rows), own in zip(self._method.parts, self._own, strict=True):
            moved.append((component, own.push(change[rows]) if own else np.zeros(component.grid.points.shape)))
        return assembled(self._grid, moved)

    def pull(self, gradient: FloatArray) -> FloatArray:
        """Gradient (n_sources, 3) from that (n_nodes, 3) of all block nodes, which may be overwritten."""
        found = np.zeros((len(self._method.problem.source_numbers), 3))
        for ((component, _), _, rows), own in zip(self._method.parts, self._own, strict=True):
            if own:
                found[rows] = own.pull(component.rows(self._grid, gradient))
        return found
