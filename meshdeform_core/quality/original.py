"""The undeformed grid, measured only once for any number of deformed grids judged against it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from ..boundary import Boundary, Kind
from ..grid import BoolArray, FloatArray, Grid
from ..grid.faces import Face, Outside, Role, declared_role, find_outside
from ..grid.planes import plane_normal
from ..grid.topology import Topology
from .cells import positive_side
from .lines import InterfaceLines, WallLines, WallMeasures, interface_lines, kink_and_jump

Walls = tuple[WallLines, WallMeasures]
"""The grid lines off walls, and their measures in the undeformed grid."""


@dataclass
class Original:
    """An undeformed grid with the data that the judgement needs.

    ``min_jacobian``: cells with a corner below this share of its undeformed Jacobian count as invalid; ``measured``:
    totals over its cells, see :func:`.validity.measured`, once they are known; ``normal``: of the plane of a 2-D
    grid.
    """

    grid: Grid
    topology: Topology
    min_jacobian: float = 0.0
    measured: Any = field(default=None, init=False)
    normal: FloatArray | None = field(init=False)
    _walls: tuple[Boundary, dict[str, Walls]] | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        self.normal = plane_normal(self.grid)

    def sides(self, block: Any) -> Any:
        """Which Jacobians of cells of blocks, by number (...), are positive, see :func:`.cells.positive_side`."""
        sign = self.topology.handedness[block] * 1.0
        return positive_side(np.array(self.grid.shapes)[block, 1] == 1, sign, self.normal)

    @cached_property
    def interfaces(self) -> tuple[InterfaceLines, tuple[FloatArray, FloatArray]]:
        """Grid lines across interfaces, and :func:`.lines.kink_and_jump` of them."""
        lines = interface_lines(self.grid, self.topology)
        return lines, kink_and_jump(lines, self.grid.points)

    @cached_property
    def outside(self) -> Outside:
        """Its faces with their roles, and its surfaces."""
        return find_outside(self.grid, self.topology)

    def fixed_wall_quads(self, boundary: Boundary) -> BoolArray:
        """(n_quads,) fixed face quads that are likely to be walls, not far field."""
        fixed = np.asarray(boundary.quad_kind == Kind.FIXED)
        outside = self.outside
        walls = [face for face, role in zip(outside.faces, outside.roles, strict=True) if role is Role.WALL]
        return fixed & self._quads_of(walls) if fixed.any() else fixed

    def moving_wall_quads(self, boundary: Boundary) -> BoolArray:
        """(n_quads,) moving face quads without those that the file declares as far field, unless all of them are.

        What moves is more often a wall than not, and the grid must not depend on a guess.
        """
        moving = np.asarray(boundary.quad_kind == Kind.MOVING)
        far = [face for face in self.outside.faces if declared_role(face) is Role.FAR]
        near = moving & ~self._quads_of(far) if far else moving
        return near if near.any() else moving

    def _quads_of(self, faces: Iterable[Face]) -> BoolArray:
        found = np.zeros(len(self.topology.quads.corners), dtype=bool)
        for face in faces:
            found[face.quads] = True
        return found

    def walls(self, boundary: Boundary) -> dict[str, Walls]:
        """The ``moving`` and the ``fixed`` walls of a boundary; those of the last boundary are cached."""
        if self._walls is None or self._walls[0] is not boundary:
            found = {}
            moving = np.asarray(boundary.quad_kind == Kind.MOVING)
            for name, quads in (("moving", moving), ("fixed", self.fixed_wall_quads(boundary))):
                lines = WallLines.off(self.grid, self.topology, quads)
                found[name] = lines, lines.measure(self.grid.points, self.normal)
            self._walls = boundary, found
        return self._walls[1]
