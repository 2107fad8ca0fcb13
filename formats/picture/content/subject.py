"""The subject of a picture: a grid, the metric for its colours, its invalid cells."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from meshdeform_core.grid import FloatArray
from meshdeform_core.grid.faces.surfaces import thin_direction
from meshdeform_core.numerics.arrays import extent
from meshdeform_core.parallel import of_all, own_rows, rows_of
from meshdeform_core.quality.fields import CELL_MEASURES, CellFields, Cells

__all__ = ["METRICS", "Cells", "Metric", "Subject"]


@dataclass(frozen=True)
class Metric:
    """The measure that colours cells: its values, the label of the colour bar, the range that is always shown, if any.

    ``diverging`` measures have the neutral value 1; for ``rising`` ones large values are bad.
    """

    label: str
    limits: tuple[float, float] | None = None
    diverging: bool = False
    rising: bool = False


_LIMITS = {"f_skew": (0.0, 1.0), "scaled_jacobian": (0.0, 1.0)}
_DIVERGING = ("volume_ratio", "first_cell_height_ratio")
_RISING = (
    "displacement", "aspect_ratio", "growth_ratio", "non_orthogonality_deg", "skewness", "wall_normal_deviation_deg",
    "interface_kink_deg", "interface_spacing_jump",
)  # fmt: skip
METRICS = {
    name: Metric(measure.definition, _LIMITS.get(name), name in _DIVERGING, name in _RISING)
    for name, measure in CELL_MEASURES.items()
}


@dataclass(frozen=True)
class Subject(CellFields):
    """A grid to draw; cells that are invalid are marked, with a reference only those that became invalid."""

    @cached_property
    def thin(self) -> FloatArray | None:
        """Normal of the plane of a 2-D grid, or of a grid that is one cell thick."""
        return thin_direction(self.grid)

    @cached_property
    def size(self) -> float:
        """Largest extent of the grid."""
        low, high = extent(self.grid.points)
        return float((high - low).max())

    def reach(self, normal: FloatArray) -> tuple[float, float]:
        """Smallest and largest x . ``normal`` of all nodes x."""
        rows = rows_of(self.grid.points)[slice(*own_rows(self.grid.points))]
        level = rows[:, 0] * normal[0] + rows[:, 1] * normal[1] + rows[:, 2] * normal[2]
        ends = of_all(self.grid.points, (level.min(), level.max()) if level.size else (np.inf, -np.inf))
        return float(min(low for low, _ in ends)), float(max(high for _, high in ends))
