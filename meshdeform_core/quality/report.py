"""The judgement of a deformed grid against its original (Knupp 2003)."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..boundary import Boundary
from ..grid import FloatArray
from .lines import kink_and_jump
from .listed import InvalidCell, Worst, list_cells, worst_cell
from .original import Original
from .validity import EXTREMES, Comparison, Range, Skew, Spread, measured
from .walls import Extremes, WallQuality, cell_at_interface, measure_walls

MAX_LISTED = 200


@dataclass(frozen=True)
class Quality:
    """Quality of one grid, as in the report's ``before`` and ``after``.

    Kink and spacing jump of a deformed grid are changes against its original. ``None`` where the grid has no moving
    wall or no interface; ``walls`` has the measures of ``moving`` and of ``fixed`` walls. ``min_relative_jacobian`` is
    the smallest corner Jacobian relative to the undeformed one, collapsed corners aside. ``worst`` names the cells with
    the extremes: those of :data:`.validity.EXTREMES`, before only of measures that do not compare;
    ``wall_normal_deviation_deg``, ``first_cell_height_ratio_min`` and ``_max``, ``interface_kink_deg``,
    ``interface_spacing_jump``. A measure with the same value everywhere has none.
    """

    f_skew: Skew
    invalid_cells: int
    inherited_invalid_cells: int
    negative_volumes: int
    min_scaled_jacobian: float
    min_relative_jacobian: float
    wall_normal_deviation_deg: Spread | None
    first_cell_height_ratio: Range | None
    interface_kink_deg: Spread | None
    interface_spacing_jump: Spread | None
    volume_ratio: Range
    total_volume: float
    walls: Mapping[str, WallQuality | None]
    worst: Mapping[str, Worst]


@dataclass(frozen=True)
class Assessment:
    """Quality before and after, and the verdict; ``invalid`` are the worst of the invalid cells, in this order."""

    before: Quality
    after: Quality
    invalid: tuple[InvalidCell, ...]

    @property
    def valid(self) -> bool:
        return self.after.invalid_cells == 0

    @property
    def change(self) -> dict[str, Any]:
        """After minus before for every number that has both."""
        change = _difference(dataclasses.asdict(self.before), dataclasses.asdict(self.after))
        for part in (change, *change["walls"].values()):
            del part["worst"]
        return change


def _difference(before: dict[str, Any], after: dict[str, Any]) -> dict[str, Any]:
    change: dict[str, Any] = {}
    for key, value in after.items():
        old = before.get(key)
        if isinstance(value, dict) and isinstance(old, dict):
            change[key] = _difference(old, value)
        elif isinstance(value, (int, float)) and isinstance(old, (int, float)):
            change[key] = value - old
    return change


def assess(
    original: Original,
    after: FloatArray,
    boundary: Boundary | None,
    cells: Comparison | None = None,
    step_of: Callable[[int], int] = lambda _: 1,
) -> Assessment:
    """Judge coordinates ``after`` (n_nodes, 3) against the original grid.

    A cell is invalid if it was sound and no longer is, see :mod:`.validity`; cells that were bad before are
    inherited, not invalid.

    Parameters
    ----------
    boundary : for the walls and the nearest patch; without it the wall measures are ``None``
    cells : the comparison of these coordinates, if there is one already
    step_of : the first step after which a cell, by number, was invalid
    """
    grid, start, cells = original.grid, original.grid.points, cells or Comparison(original, after)
    broken, old = cells.verdict.invalid, measured(original)
    # The worst first.
    broken = broken[np.argsort(cells.verdict.ratio[broken], kind="stable")]
    walls, interfaces = measure_walls(original, boundary, after), _interfaces(original, after)
    worst = cells.extremes | interfaces[2]
    if cells.volume_ratio.min == cells.volume_ratio.max:
        del worst["volume_ratio_min"], worst["volume_ratio_max"]
    named = {name: worst_cell(grid, after, *found) for name, found in worst.items()}
    moving, smallest = walls[1]["moving"], named["min_relative_jacobian"].value
    if moving:
        # The grid as a whole also lists those at moving walls.
        named |= {name: found for name, found in moving.worst.items() if not name.startswith("layer")}
    alone = {name: worst_cell(grid, start, *found) for name, found in old.extremes.items() if not EXTREMES[name][2]}
    return Assessment(
        _quality(old, (0, old.bad, 1.0), walls[0], interfaces[0], alone),
        _quality(cells, (len(broken), cells.inherited, smallest), walls[1], interfaces[1], named),
        list_cells(original, boundary, after, broken[:MAX_LISTED], cells.verdict, step_of),
    )


def _quality(
    cells: Comparison,
    verdict: tuple[int, int, float],
    walls: Mapping[str, WallQuality | None],
    interfaces: Interfaces,
    worst: Mapping[str, Worst],
) -> Quality:
    """``verdict``: numbers of invalid and of inherited cells, smallest relative Jacobian."""
    invalid, inherited, relative = verdict
    counts = invalid, inherited, cells.negative
    least = cells.extremes["min_scaled_jacobian"][1], relative
    moving = walls["moving"]
    angle, height = (moving.wall_normal_deviation_deg, moving.first_cell_height_ratio) if moving else (None, None)
    return Quality(
        cells.skew, *counts, *least, angle, height, *interfaces, cells.volume_ratio, cells.volume, walls, worst
    )  # fmt: skip


Interfaces = tuple[Spread | None, Spread | None]


def _interfaces(original: Original, after: FloatArray) -> tuple[Interfaces, Interfaces, Extremes]:
    lines, old = original.interfaces
    if lines.here.size == 0:
        return (None, None), (None, None), {}
    alone = after is original.grid.points
    # For a grid on its own, kinks and jumps themselves, not changes.
    found = list(old) if alone else [now - then for now, then in zip(kink_and_jump(lines, after), old, strict=True)]
    worst: Extremes = {}
    for name, values in zip(("interface_kink_deg", "interface_spacing_jump"), found, strict=True):
        line = int(np.abs(values).argmax())
        if values[line] != 0.0:
            worst[name] = cell_at_interface(original.grid, lines, line), abs(float(values[line]))
    spread = Spread.of(found[0]), Spread.of(found[1])
    return spread if alone else (Spread(0.0, 0.0), Spread(0.0, 0.0)), spread, worst
