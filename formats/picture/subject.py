"""What a picture shows: a grid, what its cells are coloured by, which of them are invalid."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from meshdeform_core.errors import CaseError
from meshdeform_core.grid import BoolArray, FloatArray, Grid
from meshdeform_core.grid.planes import plane_normal
from meshdeform_core.grid.roles import Role
from meshdeform_core.grid.surfaces import Outside, find_outside, thin_direction
from meshdeform_core.grid.topology import Topology
from meshdeform_core.quality.cells import CellMeasures, measure_block
from meshdeform_core.quality.original import Original
from meshdeform_core.quality.validity import Verdict, judge

_ROUND_OFF = 1e-9
Cells = tuple[slice, slice, slice]
"""A box of cells of a block, with explicit first and last."""


@dataclass(frozen=True)
class Metric:
    """What cells are coloured by: label of the colour bar, the range that is always shown, if any.

    ``diverging`` values have a neutral one, 1; ``from_reference`` needs the original grid.
    """

    label: str
    limits: tuple[float, float] | None = None
    diverging: bool = False
    from_reference: bool = False


METRICS = {
    "f_skew": Metric("f_skew (1: orthogonal, 0: invalid)", (0.0, 1.0)),
    "scaled_jacobian": Metric("smallest scaled corner Jacobian", (0.0, 1.0)),
    "jacobian": Metric("smallest corner Jacobian"),
    "volume": Metric("cell volume"),
    "volume_ratio": Metric("cell volume over undeformed volume", diverging=True, from_reference=True),
    "relative_jacobian": Metric("smallest corner Jacobian over the undeformed one", from_reference=True),
    "displacement": Metric("displacement", from_reference=True),
    "wall_distance": Metric("distance to the nearest wall node"),
}


@dataclass(frozen=True)
class Subject:
    """A grid to draw.

    Attributes
    ----------
    topology : of the undeformed grid
    reference : the undeformed grid; cells that became invalid are marked against it, else all that are
    """

    grid: Grid
    topology: Topology
    reference: Grid | None = None

    @cached_property
    def outside(self) -> Outside:
        """Faces and roles, of the undeformed grid where there is one."""
        return find_outside(self.reference or self.grid, self.topology)

    @cached_property
    def thin(self) -> FloatArray | None:
        """Normal of the plane of a 2-D grid or of one that is one cell thick."""
        return thin_direction(self.grid)

    @cached_property
    def size(self) -> float:
        """Largest extent of the grid."""
        return float(np.ptp(self.grid.points, axis=0).max())

    @cached_property
    def _normal(self) -> FloatArray | None:
        return plane_normal(self.grid)

    @cached_property
    def walls(self) -> FloatArray:
        """Coordinates (n, 3) of all nodes on walls."""
        quads = [surface.quads for surface in self.outside.of_role(Role.WALL)]
        if not quads:
            raise CaseError("metric wall_distance: no wall is known; see `meshdeform info`")
        nodes = np.unique(self.topology.quads.corners[np.concatenate(quads)])
        return np.asarray(self.grid.points[self.topology.first[nodes]])

    def whole(self, block: int) -> Cells:
        """All cells of a block."""
        ci, cj, ck = self.grid.cell_shapes[block]
        return slice(0, ci), slice(0, cj), slice(0, ck)

    def nodes(self, block: int, cells: Cells, grid: Grid | None = None) -> FloatArray:
        """The nodes (ni, nj, nk, 3) of a box of cells."""
        x = (grid or self.grid).block(block)
        window = tuple(slice(c.start, c.stop + (n > 1)) for c, n in zip(cells, x.shape[:3], strict=True))
        return np.ascontiguousarray(x[window])

    def measure(self, block: int, cells: Cells, grid: Grid | None = None) -> CellMeasures:
        """Measures of a box of cells."""
        return measure_block(self.nodes(block, cells, grid), float(self.topology.handedness[block]), self._normal)

    def values(self, metric: str, block: int, cells: Cells) -> FloatArray:
        """The metric of a box of cells.

        Raises
        ------
        CaseError
            When the metric needs the undeformed grid and there is none.
        """
        if metric not in METRICS:
            raise CaseError(f"metric {metric!r} is unknown; known are {', '.join(METRICS)}")
        if METRICS[metric].from_reference and self.reference is None:
            raise CaseError(f"metric {metric}: it compares with the undeformed grid; give --reference")
        return _VALUES[metric](self, block, cells)

    def bad(self, block: int, cells: Cells) -> BoolArray:
        """Invalid cells: where there is an undeformed grid those that became so, else those turned inside out."""
        if self.reference is None:
            return np.asarray(self.measure(block, cells).scaled < -_ROUND_OFF)
        return np.asarray(self.of_cells(self.verdict.failed, block, cells) != 0)

    @cached_property
    def verdict(self) -> Verdict:
        """The verdict on all cells against the undeformed grid."""
        return judge(Original(self.reference or self.grid, self.topology), self.grid.points)

    def of_cells(self, values: np.ndarray, block: int, cells: Cells) -> np.ndarray:
        """A box of cells of an array with one row per cell of the grid."""
        sizes = [a * b * c for a, b, c in self.grid.cell_shapes]
        start = sum(sizes[:block])
        return values[start : start + sizes[block]].reshape(self.grid.cell_shapes[block])[cells]


def cell_means(x: FloatArray) -> FloatArray:
    """Mean over the corners of every cell of node values (ni, nj, nk, ...)."""
    for axis in range(3):
        if x.shape[axis] > 1:
            low, high = (np.take(x, np.arange(x.shape[axis] - 1) + shift, axis=axis) for shift in (0, 1))
            x = 0.5 * (low + high)
    return x


def _displacement(subject: Subject, block: int, cells: Cells) -> FloatArray:
    moved = subject.nodes(block, cells) - subject.nodes(block, cells, subject.reference)
    return np.asarray(np.linalg.norm(cell_means(moved), axis=-1))


def _wall_distance(subject: Subject, block: int, cells: Cells) -> FloatArray:
    from scipy.spatial import cKDTree

    centers = cell_means(subject.nodes(block, cells))
    distance, _ = cKDTree(subject.walls).query(centers.reshape(-1, 3))
    return np.asarray(distance).reshape(centers.shape[:3])


def _volume_ratio(subject: Subject, block: int, cells: Cells) -> FloatArray:
    new, old = subject.measure(block, cells).volume, subject.measure(block, cells, subject.reference).volume
    return np.asarray(np.divide(new, old, out=np.full(new.shape, np.nan), where=old > 0))


def _relative_jacobian(subject: Subject, block: int, cells: Cells) -> FloatArray:
    return np.asarray(subject.of_cells(subject.verdict.ratio, block, cells), dtype=np.float64)


def _measure(name: str) -> Callable[[Subject, int, Cells], FloatArray]:
    return lambda subject, block, cells: np.asarray(getattr(subject.measure(block, cells), name))


_VALUES: dict[str, Callable[[Subject, int, Cells], FloatArray]] = {
    "f_skew": _measure("skew"),
    "scaled_jacobian": _measure("scaled"),
    "jacobian": _measure("jacobian"),
    "volume": _measure("volume"),
    "volume_ratio": _volume_ratio,
    "relative_jacobian": _relative_jacobian,
    "displacement": _displacement,
    "wall_distance": _wall_distance,
}
