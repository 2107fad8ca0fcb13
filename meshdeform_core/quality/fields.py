"""Cell measures of a grid, for pictures and for files displayed by other programs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
import scipy

from ..errors import CaseError, suggestion
from ..grid import BoolArray, FloatArray, Grid, IntArray
from ..grid.faces import Outside, Role, find_outside
from ..grid.planes import plane_normal
from ..grid.topology import Topology, find_topology
from .cells import CellMeasures, measure_block
from .difference import require_same_blocks
from .original import Original
from .shape import shape_of_cells, thickness_of
from .validity import Verdict, judge
from .walls import interface_cells, wall_cells

_ROUND_OFF = 1e-9
Cells = tuple[slice, slice, slice]
"""A box of cells of a block; the slices have explicit bounds."""


@dataclass(frozen=True)
class CellMeasure:
    """A cell measure: its meaning, its ``values`` in a box of cells of a block, and what it requires.

    ``worst``: which values are bad, ``small``, ``large`` or, as 1 is neutral, ``far`` from it; ``from_reference``: it
    compares with the undeformed grid; ``of_walls``: it requires known walls; ``shared``: the attribute of
    :class:`CellFields` that all ranks of a grid in parts find together.
    """

    definition: str
    values: Callable[[CellFields, int, Cells], FloatArray]
    worst: str = "small"
    from_reference: bool = False
    of_walls: bool = False
    shared: str = "_normal"


@dataclass(frozen=True)
class CellFields:
    """The cells of a grid and what their measures require.

    Attributes
    ----------
    topology : of the undeformed grid
    reference : the undeformed grid, against which cells are judged, if there is one
    moving : numbers of the face quads that move; these count as walls in any case
    original : the undeformed grid with its faces, if these have been found already
    """

    grid: Grid
    topology: Topology
    reference: Grid | None = None
    moving: IntArray | None = None
    original: CellFields | Original | None = None

    @classmethod
    def of(cls, grid: Grid, reference: Grid | None = None) -> Self:
        """The cells of a grid, against an undeformed one if given, which gets patches that it lacks from ``grid``."""
        if reference is None:
            return cls(grid, find_topology(grid))
        require_same_blocks(grid, reference)
        reference = reference.with_patches_of(grid)
        return cls(grid, find_topology(reference), reference)

    @cached_property
    def outside(self) -> Outside:
        """Faces and roles, of the undeformed grid if there is one."""
        return self.original.outside if self.original else find_outside(self.reference or self.grid, self.topology)

    def whole(self, block: int) -> Cells:
        """All cells of a block."""
        ci, cj, ck = self.grid.cell_shapes[block]
        return slice(0, ci), slice(0, cj), slice(0, ck)

    def values(self, measure: str, block: int, cells: Cells) -> FloatArray:
        """A measure of a box of cells; of a grid in parts, of cells of this rank, within :meth:`ready`."""
        self.require(measure)
        return CELL_MEASURES[measure].values(self, block, cells)

    def require(self, measure: str) -> None:
        """Refuse a measure that is unknown, or requires an undeformed grid or walls that are not known."""
        if measure not in CELL_MEASURES:
            near = suggestion(measure, CELL_MEASURES)
            raise CaseError(f"measure {measure!r} is unknown{near or '; known are ' + ', '.join(CELL_MEASURES)}")
        if CELL_MEASURES[measure].from_reference and self.reference is None:
            raise CaseError(f"{measure} needs the undeformed grid; give --reference")
        if CELL_MEASURES[measure].of_walls and not len(self.walls):
            raise CaseError(f"{measure}: no wall is known; see `meshdeform info`")

    @contextmanager
    def ready(self, measure: str = "") -> Iterator[None]:
        """Context for :meth:`values` of a measure and :meth:`bad` of cells of this rank, without other ranks; all ranks
        must enter it."""
        if self.grid.nodes.divided:
            # Find what a measure takes from other ranks, which all do the same.
            shared = CELL_MEASURES[measure].shared if measure in CELL_MEASURES else "_normal"
            known = [getattr(self, name) for name in ("_normal", "thickness", shared)]
            # Numbers of the cells behind the planes i of this rank: the first, and one past the last.
            ends = list[int]()
            for block, (ci, cj, ck) in enumerate(self.grid.cell_shapes):
                own, first = self.grid.planes(block), int(self.grid.cell_offsets[block])
                ends += [first + min(end, ci) * cj * ck for end in (own.start, own.stop) if own.start < own.stop]
            low, high = (ends[0], ends[-1]) if ends else (self.grid.n_cells, 0)
            for values in (
                self.verdict.failed,
                self.verdict.ratio,
                *(known[-1] if isinstance(known[-1], tuple) else ()),
            ):
                values.widen(low, high)
            for grid in (self.grid, self.reference):
                if grid is not None:
                    grid.hold_neighbours(after=2)
        yield

    def own(self, block: int, cells: Cells) -> Cells:
        """Those cells of a box that belong to this rank."""
        first, planes = cells[0], self.grid.planes(block)
        low = max(first.start, planes.start)
        return slice(low, max(low, min(first.stop, planes.stop))), cells[1], cells[2]

    def of_all(self, look: Callable[[Cells], np.ndarray], block: int, cells: Cells) -> np.ndarray:
        """What ``look`` finds in a box of cells, on all ranks, from what each finds in its own cells."""
        own = self.own(block, cells)
        found = self.grid.nodes.gather(look(own) if own[0].start < own[0].stop else None)
        return np.concatenate([each for each in found if each is not None])

    def bad(self, block: int, cells: Cells) -> BoolArray:
        """Invalid cells: those that became invalid or, without an undeformed grid, those with a negative Jacobian."""
        if self.reference is None:
            return np.asarray(self.measure(block, cells).scaled < -_ROUND_OFF)
        return np.asarray(self.values_in(self.verdict.failed, block, cells) != 0)

    def nodes(self, block: int, cells: Cells, grid: Grid | None = None) -> FloatArray:
        """The nodes (ni, nj, nk, 3) of a box of cells."""
        shape = self.grid.shapes[block]
        window = [slice(c.start, c.stop + (n > 1)) for c, n in zip(cells, shape, strict=True)]
        return np.ascontiguousarray((grid or self.grid).box(block, window))

    def measure(self, block: int, cells: Cells, grid: Grid | None = None) -> CellMeasures:
        """Corner Jacobians and volumes of a box of cells."""
        return measure_block(self.nodes(block, cells, grid), float(self.topology.handedness[block]), self._normal)

    @cached_property
    def verdict(self) -> Verdict:
        """The verdict on all cells against the undeformed grid."""
        return judge(Original(self.reference or self.grid, self.topology), self.grid.points)

    @cached_property
    def walls(self) -> IntArray:
        """Numbers of the face quads of walls: declared, guessed or moving."""
        quads = [surface.quads for surface in self.outside.of_role(Role.WALL)]
        if self.moving is not None:
            quads.append(self.moving)
        return np.unique(np.concatenate([np.empty(0, np.int64), *quads]))

    @cached_property
    def at_walls(self) -> tuple[FloatArray, FloatArray]:
        """Deviation from the wall normal (degrees) and height ratio (n_cells,) of the cells at walls; NaN elsewhere."""
        return wall_cells(self.reference or self.grid, self.topology, self.grid.points, self.walls)

    @cached_property
    def at_interfaces(self) -> tuple[FloatArray, FloatArray]:
        """Kink (degrees) and spacing jump (n_cells,) of the cells beside block interfaces; NaN elsewhere."""
        before = None if self.reference is None else self.reference.points
        return interface_cells(self.grid, self.topology, self.grid.points, before)

    @cached_property
    def _normal(self) -> FloatArray | None:
        return plane_normal(self.grid)

    @cached_property
    def thickness(self) -> FloatArray | None:
        return thickness_of(self.grid)

    @cached_property
    def wall_tree(self) -> scipy.spatial.cKDTree:
        nodes = np.unique(self.topology.quads.corners[self.walls])
        return scipy.spatial.cKDTree(self.grid.nodes.at(self.topology.first[nodes]))

    def values_in(self, values: np.ndarray, block: int, cells: Cells) -> np.ndarray:
        """A box of cells of an array with one row per cell of the grid."""
        (i, j, k), (_, cj, ck) = cells, self.grid.cell_shapes[block]
        first, last = (int(self.grid.cell_offsets[block]) + end * cj * ck for end in (i.start, i.stop))
        return values[first:last].reshape(i.stop - i.start, cj, ck)[:, j, k]


def cell_means(x: FloatArray) -> FloatArray:
    """Mean over the corners of every cell of node values (ni, nj, nk, ...)."""
    for axis in range(3):
        if x.shape[axis] > 1:
            low, high = (np.take(x, np.arange(x.shape[axis] - 1) + shift, axis=axis) for shift in (0, 1))
            x = 0.5 * (low + high)
    return x


def _volume_ratio(fields: CellFields, block: int, cells: Cells) -> FloatArray:
    new, old = fields.measure(block, cells).volume, fields.measure(block, cells, fields.reference).volume
    return np.asarray(np.divide(new, old, out=np.full(new.shape, np.nan), where=old > 0))


def _corner(name: str) -> Callable[[CellFields, int, Cells], FloatArray]:
    return lambda fields, block, cells: np.asarray(getattr(fields.measure(block, cells), name))


def _shape(number: int) -> Callable[[CellFields, int, Cells], FloatArray]:
    def values(fields: CellFields, block: int, cells: Cells) -> FloatArray:
        sign = float(fields.topology.handedness[block])
        return shape_of_cells(fields.grid, block, cells, fields.thickness, sign)[..., number]

    return values


def _beside(name: str, number: int) -> Callable[[CellFields, int, Cells], FloatArray]:
    return lambda fields, block, cells: fields.values_in(getattr(fields, name)[number], block, cells)


CELL_MEASURES = {
    "f_skew": CellMeasure("f_skew (1: orthogonal, 0: invalid)", _corner("skew")),
    "scaled_jacobian": CellMeasure("smallest scaled corner Jacobian", _corner("scaled")),
    "jacobian": CellMeasure("smallest corner Jacobian", _corner("jacobian")),
    "relative_jacobian": CellMeasure(
        "smallest corner Jacobian over the undeformed one",
        lambda fields, block, cells: fields.values_in(fields.verdict.ratio, block, cells).astype(np.float64),
        from_reference=True,
    ),
    "volume": CellMeasure("cell volume", _corner("volume")),
    "volume_ratio": CellMeasure("cell volume over undeformed volume", _volume_ratio, "far", from_reference=True),
    "aspect_ratio": CellMeasure("aspect ratio", _shape(0), "large"),
    "growth_ratio": CellMeasure("growth ratio to the neighbours", _shape(1), "large"),
    "non_orthogonality_deg": CellMeasure("non-orthogonality [deg]", _shape(2), "large"),
    "skewness": CellMeasure("skewness", _shape(3), "large"),
    "wall_normal_deviation_deg": CellMeasure(
        "grid line to wall normal [deg]", _beside("at_walls", 0), "large", of_walls=True, shared="at_walls"
    ),
    "first_cell_height_ratio": CellMeasure(
        "first cell height over the undeformed one", _beside("at_walls", 1), "far", True, True, shared="at_walls"
    ),
    "interface_kink_deg": CellMeasure(
        "kink of grid lines at block interfaces [deg]", _beside("at_interfaces", 0), "large", shared="at_interfaces"
    ),
    "interface_spacing_jump": CellMeasure(
        "spacing jump at block interfaces, ln", _beside("at_interfaces", 1), "large", shared="at_interfaces"
    ),
    "wall_distance": CellMeasure(
        "distance to the nearest wall node",
        lambda fields, block, cells: fields.wall_tree.query(cell_means(fields.nodes(block, cells)))[0],
        of_walls=True,
        shared="wall_tree",
    ),
    "displacement": CellMeasure(
        "displacement",
        lambda fields, block, cells: np.linalg.norm(
            cell_means(fields.nodes(block, cells) - fields.nodes(block, cells, fields.reference)), axis=-1
        ),
        "large",
        from_reference=True,
    ),
}
"""All measures by name. Measures at walls are NaN in cells away from walls, those at interfaces in cells away from
interfaces. With an undeformed grid, kinks and jumps are changes since that grid."""
