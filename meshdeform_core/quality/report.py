"""The judgement of a deformed grid against its original (spec section 6; Knupp 2003)."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..boundary import Boundary
from ..grid import FloatArray, Grid, Shape
from ..planes import plane_normal
from ..topology import Topology
from .cells import CellMeasures, measure_grid
from .lines import interface_lines, kink_and_jump, moving_walls, wall_lines

HISTOGRAM_BINS = 20
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
class Range:
    """Smallest and largest value."""

    min: float
    max: float


@dataclass(frozen=True)
class Skew:
    """Distribution of f_skew: 1 is orthogonal, 0 is invalid. ``histogram`` counts cells in 20 equal bins of [0, 1]."""

    harmonic_mean: float
    mean: float
    min: float
    p01: float
    histogram: tuple[int, ...]


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
    """Quality before and after and the verdict."""

    before: Quality
    after: Quality
    invalid: tuple[InvalidCell, ...]

    @property
    def valid(self) -> bool:
        return self.after.invalid_cells == 0

    @property
    def change(self) -> dict[str, Any]:
        """After minus before for every number that has both."""
        return _difference(dataclasses.asdict(self.before), dataclasses.asdict(self.after))

    def with_steps(self, grid: Grid, first_bad: Mapping[int, int], otherwise: int) -> Assessment:
        """The same with the step that first broke each listed cell, by cell number (see ``newly_invalid``)."""
        starts = np.concatenate([[0], np.cumsum([a * b * c for a, b, c in grid.cell_shapes])])

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


@dataclass
class _Tally:
    """Running totals over the blocks of one grid."""

    skews: list[np.ndarray] = field(default_factory=list)
    inverse: float = 0.0
    total: float = 0.0
    low: float = np.inf
    negative: int = 0
    scaled: float = np.inf
    volume: float = 0.0

    def add(self, m: CellMeasures) -> None:
        with np.errstate(divide="ignore"):
            self.inverse += float((1.0 / m.skew).sum())
        self.total += float(m.skew.sum())
        self.low = min(self.low, float(m.skew.min()))
        # Single precision is enough for the quantile and the histogram.
        self.skews.append(m.skew.ravel().astype(np.float32))
        self.negative += int((m.volume <= 0).sum())
        self.scaled = min(self.scaled, float(m.scaled.min()))
        self.volume += float(m.volume.sum())

    def skew(self) -> Skew:
        every = np.concatenate(self.skews)
        n = len(every)
        at = max(0, -(-n // 100) - 1)
        p01 = float(np.partition(every, at)[at])
        bins = np.minimum((every * HISTOGRAM_BINS).astype(np.int64), HISTOGRAM_BINS - 1)
        histogram = tuple(int(c) for c in np.bincount(bins, minlength=HISTOGRAM_BINS))
        harmonic = n / self.inverse if np.isfinite(self.inverse) else 0.0
        return Skew(harmonic, self.total / n, self.low, p01, histogram)

    def quality(self, invalid: int, inherited: int, walls: Walls, interfaces: Interfaces, ratio: Range) -> Quality:
        return Quality(
            self.skew(), invalid, inherited, self.negative, self.scaled, *walls, *interfaces, ratio, self.volume
        )


@dataclass
class _Comparison:
    """Running comparison of two grids, block by block."""

    before: _Tally = field(default_factory=_Tally)
    after: _Tally = field(default_factory=_Tally)
    invalid: int = 0
    bad_before: int = 0
    inherited: int = 0
    ratio: Range = field(default_factory=lambda: Range(np.inf, -np.inf))

    def add(self, old: CellMeasures, new: CellMeasures) -> np.ndarray:
        """Count one block; returns where its cells are newly invalid."""
        self.before.add(old)
        self.after.add(new)
        broken = np.asarray((new.bad & ~old.bad) != 0)
        self.invalid += int(broken.sum())
        self.bad_before += int((old.bad != 0).sum())
        self.inherited += int(((old.bad != 0) & (new.bad != 0) & ~broken).sum())
        sound = old.volume > 0
        if sound.any():
            change = new.volume[sound] / old.volume[sound]
            self.ratio = Range(min(self.ratio.min, float(change.min())), max(self.ratio.max, float(change.max())))
        return broken


def assess(
    grid: Grid, after: FloatArray, topology: Topology, boundary: Boundary | None, before: FloatArray | None = None
) -> Assessment:
    """Judge coordinates ``after`` (n_nodes, 3) against ``before`` (default: those of ``grid``).

    A cell is invalid if a corner Jacobian that was positive became <= 0, where positive is relative to the handedness
    of most cells of the block; cells that were bad before are inherited, not invalid.

    Parameters
    ----------
    boundary : for the moving walls and the nearest patch; without it the wall measures are ``None``
    """
    start = grid.points if before is None else before
    comparison = _Comparison()
    invalid: list[InvalidCell] = []
    normal = plane_normal(grid)
    both = zip(*(measure_grid(grid, x, topology.handedness, normal) for x in (start, after)), strict=True)
    for block, (old, new) in enumerate(both):
        broken = comparison.add(old, new)
        invalid += _list_cells(grid, after, block, broken, new, MAX_LISTED - len(invalid))
    walls = _walls(grid, topology, boundary, start, after)
    interfaces = _interfaces(grid, topology, start, after)
    c = comparison
    ratio = c.ratio if c.ratio.min <= c.ratio.max else Range(1.0, 1.0)
    return Assessment(
        c.before.quality(0, c.bad_before, walls[0], interfaces[0], Range(1.0, 1.0)),
        c.after.quality(c.invalid, c.inherited, walls[1], interfaces[1], ratio),
        _with_nearest_patch(grid, topology, boundary, start, invalid),
    )


def _list_cells(
    grid: Grid, points: FloatArray, block: int, broken: np.ndarray, measures: CellMeasures, room: int
) -> Iterable[InvalidCell]:
    x = grid.block(block, points)
    for ijk in np.argwhere(broken)[: max(room, 0)]:
        i, j, k = (int(n) for n in ijk)
        center = x[i : i + 2, j : j + 2, k : k + 2].reshape(-1, 3).mean(axis=0)
        yield InvalidCell(
            grid.names[block],
            (i + 1, j + 1, k + 1),
            float(measures.skew[i, j, k]),
            float(measures.jacobian[i, j, k]),
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
