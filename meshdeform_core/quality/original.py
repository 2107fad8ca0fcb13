"""The undeformed grid, measured only once for any number of deformed grids judged against it."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

from ..boundary import Boundary
from ..grid import FloatArray, Grid
from ..grid.planes import plane_normal
from ..grid.topology import Topology
from .kept import KeptCells
from .lines import InterfaceLines, WallFace, interface_lines, kink_and_jump, moving_walls, wall_lines
from .tally import Tally

Lines = list[tuple[FloatArray, FloatArray]]


@dataclass
class Original:
    """An undeformed grid with the data that the judgement needs.

    ``min_jacobian``: cells with a corner below this share of its undeformed Jacobian count as invalid; ``measured``:
    totals over its cells, from the first comparison with another grid; ``kept``: what the judgement of further grids
    needs of them.
    """

    grid: Grid
    topology: Topology
    min_jacobian: float = 0.0
    measured: Tally | None = field(default=None, init=False)
    kept: KeptCells = field(init=False)
    _walls: tuple[Boundary, list[WallFace], Lines] | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        self.kept = KeptCells(self.grid)

    @property
    def tally(self) -> Tally:
        """Totals over its cells; there must have been a comparison."""
        assert self.measured is not None
        return self.measured

    @cached_property
    def interfaces(self) -> tuple[InterfaceLines, tuple[FloatArray, FloatArray]]:
        """Grid lines across interfaces, and :func:`.lines.kink_and_jump` of them."""
        lines = interface_lines(self.grid, self.topology)
        return lines, kink_and_jump(lines, self.grid.points)

    def walls(self, boundary: Boundary) -> tuple[list[WallFace], Lines]:
        """The moving walls of a boundary, and :func:`.lines.wall_lines` of each; the last ones are kept."""
        if self._walls is None or self._walls[0] is not boundary:
            faces = moving_walls(self.grid, self.topology, boundary)
            normal = plane_normal(self.grid)
            self._walls = boundary, faces, [wall_lines(face, self.grid.points, normal) for face in faces]
        return self._walls[1:]
