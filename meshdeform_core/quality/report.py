"""The judgement of a deformed grid against its original (spec section 6; Knupp 2003)."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..boundary import Boundary
from ..grid import FloatArray, Grid, IntArray, Shape
from ..grid.planes import plane_normal
from ..grid.topology import Topology
from .cells import measure_block
from .comparison import Comparison
from .lines import interface_lines, kink_and_jump, moving_walls, wall_lines
from .original import Original
from .per_block import BlockQuality, per_block
from .tally import Range, Skew, Tally

MAX_LISTED = 200


@dataclass(frozen=True)
class Spread:
    """Root mean square and largest value."""

    rms: float
    max: float

    @classmethod
    def of(cls, values: FloatArray) -> Spread:
        if values.size == 0:
            return cls(0.0, 0.0)
        return cls(float(np.sqrt(np.mean(values**2))), float(np.abs(values).max()))


@dataclass(frozen=True)
class Quality:
    """Quality of one grid, as in the report's ``before`` and ``after``.

    Kink and spacing jump of a deformed grid are changes against its original. ``None`` where the grid has no moving
    wall or no interface.
    """

    f_skew: Skew
    invalid_cells: int
    inherited_invalid_cells: int
    negative_volumes: int
    min_scaled_jacobian: float
    wall_normal_deviation_deg: Spread | None
    first_cell_height_ratio: Range | None
    interface_kink_deg: Spread | None
    interface_spacing_jump: Spread | None
    volume_ratio: Range
    total_volume: float


@dataclass(frozen=True)
class InvalidCell:
    """A cell with a corner Jacobian that was positive and is not any more.

    ``ijk`` are 1-based; ``center`` is the mean of the corners; ``step`` the first step that broke it.
    """

    block: str
    ijk: Shape
    f_skew: float
    min_jacobian: float
    center: tuple[float, float, float]
    nearest_patch: str = ""
    step: int = 1


@dataclass(frozen=True)
class Assessment:
    """Quality before and after, of the grid and of its blocks, and the verdict."""

    before: Quality
    after: Quality
    invalid: tuple[InvalidCell, ...]
    blocks: tuple[BlockQuality, ...] = ()

    @property
    def valid(self) -> bool:
        return self.after.invalid_cells == 0

    @property
    def change(self) -> dict[str, Any]:
        """After minus before for every number that has both."""
        return _difference(dataclasses.asdict(self.before), dataclasses.asdict(self.after))

    def with_steps(self, grid: Grid, first_bad: Mapping[int, int], otherwise: int) -> Assessment:
        """The same with the step that first broke each listed cell, by cell number (see ``newly_invalid``)."""
        starts = _cell_starts(grid)

        def number(cell: InvalidCell) -> int:
            block = grid.names.index(cell.block)
            return int(starts[block] + np.ravel_multi_index([n - 1 for n in cell.ijk], grid.cell_shapes[block]))

        cells = (dataclasses.replace(c, step=first_bad.get(number(c), otherwise)) for c in self.invalid)
        return dataclasses.replace(self, invalid=tuple(cells))


def _difference(before: dict[str, Any], after: dict[str, Any]) -> dict[str, Any]:
    change: dict[str, Any] = {}
    for key, value in after.items():
        old = before[key]
        if isinstance(value, dict) and isinstance(old, dict):
            change[key] = _difference(old, value)
        elif isinstance(value, (int, float)) and isinstance(old, (int, float)):
            change[key] = value - old
    return change


def assess(original: Original, after: FloatArray, boundary: Boundary | None) -> Assessment:
    """Judge coordinates ``after`` (n_nodes, 3) against the original grid.

    A cell is invalid if a corner Jacobian that was positive became <= 0, where positive is relative to the handedness
    of most cells of the block; cells that were bad before are inherited, not invalid.

    Parameters
    ----------
    boundary : for the moving walls and the nearest patch; without it the wall measures are ``None``
    """
    grid, topology = original.grid, original.topology
    start, cells = grid.points, Comparison(original, after)
    broken = np.flatnonzero(cells.broken)
    invalid = list(_list_cells(grid, topology, after, broken[:MAX_LISTED]))
    walls = _walls(grid, topology, boundary, start, after)
    interfaces = _interfaces(grid, topology, start, after)
    return Assessment(
        _quality(original.tally, 0, original.tally.bad, walls[0], interfaces[0], Range(1.0, 1.0)),
        _quality(cells.after, len(broken), cells.inherited, walls[1], interfaces[1], cells.ratio),
        _with_nearest_patch(grid, topology, boundary, start, invalid),
        per_block(original, cells),
    )


def _quality(cells: Tally, invalid: int, inherited: int, walls: Walls, interfaces: Interfaces, ratio: Range) -> Quality:
    return Quality(
        cells.skew(), invalid, inherited, cells.negative, cells.scaled, *walls, *interfaces, ratio, cells.volume
    )


def _cell_starts(grid: Grid) -> IntArray:
    """Number (n_blocks + 1,) of the first cell of every block."""
    return np.concatenate([[0], np.cumsum([a * b * c for a, b, c in grid.cell_shapes])])


def _list_cells(grid: Grid, topology: Topology, points: FloatArray, cells: IntArray) -> Iterator[InvalidCell]:
    starts, normal = _cell_starts(grid), plane_normal(grid)
    for cell in cells.tolist():
        block = int(np.searchsorted(starts, cell, side="right")) - 1
        i, j, k = (int(n) for n in np.unravel_index(cell - starts[block], grid.cell_shapes[block]))
        x = np.ascontiguousarray(grid.block(block, points)[i : i + 2, j : j + 2, k : k + 2])
        measures = measure_block(x, float(topology.handedness[block]), normal)
        center = x.reshape(-1, 3).mean(axis=0)
        yield InvalidCell(
            grid.names[block],
            (i + 1, j + 1, k + 1),
            measures.skew.item(),
            measures.jacobian.item(),
            (float(center[0]), float(center[1]), float(center[2])),
        )


def _with_nearest_patch(
    grid: Grid, topology: Topology, boundary: Boundary | None, points: FloatArray, cells: list[InvalidCell]
) -> tuple[InvalidCell, ...]:
    """Name the boundary patch closest to each cell, both undeformed."""
    if not cells or boundary is None or not boundary.patches:
        return tuple(cells)
    centers = []
    for cell in cells:
        i, j, k = (n - 1 for n in cell.ijk)
        x = grid.block(grid.names.index(cell.block), points)
        centers.append(x[i : i + 2, j : j + 2, k : k + 2].reshape(-1, 3).mean(axis=0))
    at = np.array(centers)
    distance = np.stack([_distance(at, points[topology.first[p.nodes]]) for p in boundary.patches])
    nearest = distance.argmin(axis=0)
    return tuple(
        dataclasses.replace(cell, nearest_patch=boundary.patches[int(n)].name)
        for cell, n in zip(cells, nearest, strict=True)
    )


def _distance(at: FloatArray, nodes: FloatArray) -> FloatArray:
    return np.array([float(np.sqrt(((nodes - x) ** 2).sum(axis=1).min(initial=np.inf))) for x in at])


Walls = tuple[Spread | None, Range | None]
Interfaces = tuple[Spread | None, Spread | None]


def _walls(
    grid: Grid, topology: Topology, boundary: Boundary | None, before: FloatArray, after: FloatArray
) -> tuple[Walls, Walls]:
    faces = moving_walls(grid, topology, boundary) if boundary is not None else []
    if not faces:
        return (None, None), (None, None)
    normal = plane_normal(grid)
    old, new = ([wall_lines(face, x, normal) for face in faces] for x in (before, after))
    angles = [np.concatenate([angle for angle, _ in lines]) for lines in (old, new)]
    heights = [np.concatenate([height for _, height in lines]) for lines in (old, new)]
    sound = heights[0] > 0
    ratio = heights[1][sound] / heights[0][sound]
    change = Range(float(ratio.min()), float(ratio.max())) if ratio.size else None
    return (Spread.of(angles[0]), Range(1.0, 1.0)), (Spread.of(angles[1]), change)


def _interfaces(grid: Grid, topology: Topology, before: FloatArray, after: FloatArray) -> tuple[Interfaces, Interfaces]:
    lines = interface_lines(grid, topology)
    if lines.here.size == 0:
        return (None, None), (None, None)
    old = kink_and_jump(lines, before)
    if after is before:
        # A grid on its own: kinks and jumps as they are, not changes.
        own = Spread.of(old[0]), Spread.of(old[1])
        return own, own
    new = kink_and_jump(lines, after)
    return (Spread(0.0, 0.0), Spread(0.0, 0.0)), (Spread.of(new[0] - old[0]), Spread.of(new[1] - old[1]))
