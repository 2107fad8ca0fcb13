"""Data common to all repairs of one undeformed grid."""

from __future__ import annotations

from functools import cached_property

from ..boundary import Boundary
from ..quality import Original
from .constraints import Constraints
from .extrusion import Extrusion, find_extrusion
from .region import Neighbourhood, Plot


class Basis:
    """Data common to all repairs of one undeformed grid; each part is computed when first needed."""

    def __init__(self, original: Original, boundary: Boundary | Constraints):
        self.original, self._boundary = original, boundary

    @cached_property
    def _constraints(self) -> Constraints:
        if isinstance(self._boundary, Constraints):
            return self._boundary
        return Constraints.of(self.original, self._boundary)

    @cached_property
    def neighbourhood(self) -> Neighbourhood:
        """See :class:`Neighbourhood`."""
        return Neighbourhood(self._constraints)

    @cached_property
    def extrusion(self) -> tuple[Extrusion, Basis] | None:
        """The plane grid that this one is extruded from, with its own basis; ``None`` if it is no extrusion."""
        found = find_extrusion(self._constraints)
        if found is None:
            return None
        original = Original(found.plane, found.constraints.topology, self.original.min_jacobian)
        return found, Basis(original, found.constraints)

    @cached_property
    def whole(self) -> Plot | None:
        """The region of all nodes that may move, or ``None`` if no node may."""
        return self.neighbourhood.plot()
