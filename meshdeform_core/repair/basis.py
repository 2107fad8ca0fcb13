"""Data common to all repairs of one undeformed grid."""

from __future__ import annotations

from functools import cached_property

from ..boundary import Boundary
from ..grid import FloatArray
from ..numerics.cell.health import all_healthy
from ..parallel import of_all
from ..quality import Original
from .constraints import Constraints
from .energy.elements import COLLAPSED
from .energy.newton import NewtonSystem
from .extrusion import Extrusion, find_extrusion
from .neighbourhood import Neighbourhood, Plot
from .tuned import HEALTHY, SOFT


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

    def healthy(self, points: FloatArray) -> bool:
        """Whether the corners of all cells are healthy, found without building a region; not for plane grids."""
        grid = self.original.grid
        if grid.dimension == 2:
            return False
        for each in (points, grid.points):
            grid.hold_neighbours(each)
        pairs = ((grid.in_planes(n, points, 1), grid.in_planes(n, grid.points, 1)) for n in range(grid.n_blocks))
        healthy = all(all_healthy(x, start, HEALTHY, SOFT, COLLAPSED) for x, start in pairs if len(x) > 1)
        return all(of_all(points, healthy))

    @cached_property
    def whole(self) -> Whole | None:
        """The region of all nodes that may move, or ``None`` if no node may."""
        if not self.neighbourhood.shares.n_unknowns:
            return None
        plot = self.neighbourhood.plot()
        return Whole(plot, plot.region.energy.edges())


class Whole:
    """The region of all nodes that may move, and the shortest undeformed edges (n,) at its nodes."""

    def __init__(self, plot: Plot, edges: FloatArray):
        self.plot, self.edges = plot, edges

    @cached_property
    def system(self) -> NewtonSystem:
        """The linear system of Newton's method; its sparsity pattern is found once."""
        return NewtonSystem(self.plot.region)
