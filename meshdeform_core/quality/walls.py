"""Grid lines at walls: their direction, the height of the first cell, the thickness of the first layers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..boundary import Boundary
from ..grid import FloatArray
from .boundary_cells import cell_at_wall
from .lines import WallLines, wall_lines
from .listed import Worst, worst_cell
from .original import Original, Walls
from .tally import Range, Spread

CHANGED = 0.01
"""A grid line at a wall counts as changed if the thickness of its first cells differs by more than this fraction."""

Extremes = dict[str, tuple[int, float]]
"""Number and value of the worst cell for each measure; measures with the same value everywhere are left out."""


@dataclass(frozen=True)
class WallQuality:
    """The grid lines off the moving or the fixed walls, as in the report's ``walls``.

    ``layer_thickness_ratio``: of the first :data:`.lines.LAYERS` cells of each line, along the wall normal.
    ``worst`` names the cells with the extremes: ``wall_normal_deviation_deg``, ``first_cell_height_ratio_min`` and
    ``_max``, ``layer_thickness_ratio_min`` and ``_max``; none before.
    """

    wall_normal_deviation_deg: Spread
    first_cell_height_ratio: Range | None
    layer_thickness_ratio: Range | None
    worst: Mapping[str, Worst]


@dataclass(frozen=True)
class LayerChange:
    """Effect of a repair on the grid lines at the moving or the fixed walls.

    ``changed`` of the ``lines`` grid lines have a first cell, or first :data:`.lines.LAYERS` cells together, whose
    height along the wall normal differs by more than :data:`CHANGED`; ratios are to the heights before the repair.
    """

    lines: int
    changed: int
    first_cell_height_ratio: Range | None
    layer_thickness_ratio: Range | None


WallQualities = dict[str, WallQuality | None]


def measure_walls(
    original: Original, boundary: Boundary | None, after: FloatArray
) -> tuple[WallQualities, WallQualities]:
    """The ``moving`` and the ``fixed`` walls before, and with coordinates ``after`` (n_nodes, 3).

    ``None`` where there are none. Fixed walls are fixed faces with the role of a wall (:mod:`..grid.faces.roles`).
    """
    before: WallQualities = {"moving": None, "fixed": None}
    now: WallQualities = dict(before)
    for name, walls in original.walls(boundary).items() if boundary is not None else ():
        before[name], now[name] = _compared(original, walls, after)
    return before, now


def _compared(original: Original, walls: Walls, after: FloatArray) -> tuple[WallQuality | None, WallQuality | None]:
    if not walls.faces:
        return None, None
    grid, normal = original.grid, original.normal
    old = WallLines.joined(walls.lines)
    new = WallLines.joined([wall_lines(face, after, normal) for face in walls.faces])
    worst: Extremes = {}
    if new.angle.any():
        line = int(new.angle.argmax())
        worst["wall_normal_deviation_deg"] = cell_at_wall(grid, walls.faces, line), float(new.angle[line])
    heights = _ratios(old.height, new.height)
    layers = _ratios(old.thickness, new.thickness)
    for name, found in (("first_cell_height_ratio", heights), ("layer_thickness_ratio", layers)):
        if found:
            low, high = ((cell_at_wall(grid, walls.faces, line), value) for line, value in found)
            worst |= extremes_of(name, (low, high))
    places = {name: worst_cell(grid, after, *at) for name, at in worst.items()}
    alike = Range(1.0, 1.0)
    before = WallQuality(Spread.of(old.angle), alike if heights else None, alike if layers else None, {})
    return before, WallQuality(Spread.of(new.angle), _range(heights), _range(layers), places)


def layer_changes(
    original: Original, boundary: Boundary, plain: FloatArray, after: FloatArray
) -> dict[str, LayerChange | None]:
    """Effect of a repair on the ``moving`` and the ``fixed`` walls: from coordinates ``plain`` to ``after``, both
    (n_nodes, 3); ``None`` where there are none."""
    normal = original.normal
    found: dict[str, LayerChange | None] = {}
    for name, walls in original.walls(boundary).items():
        old, new = (WallLines.joined([wall_lines(face, x, normal) for face in walls.faces]) if walls.faces else None
                    for x in (plain, after))  # fmt: skip
        found[name] = None
        if old and new:
            pairs = (old.height, new.height), (old.thickness, new.thickness)
            changed = np.any([np.abs(after - before) > CHANGED * np.abs(before) for before, after in pairs], axis=0)
            ranges = (_range(_ratios(before, after)) for before, after in pairs)
            found[name] = LayerChange(len(changed), int(np.count_nonzero(changed)), *ranges)
    return found


Ends = tuple[tuple[int, float], tuple[int, float]]
"""The grid lines with the smallest and the largest value of a measure, and these values."""


def _ratios(old: FloatArray, new: FloatArray) -> Ends | None:
    """The smallest and the largest ratio of ``new`` to ``old`` lengths (n,), where the old ones are positive."""
    sound = np.flatnonzero(old > 0)
    if not sound.size:
        return None
    ratio = new[sound] / old[sound]
    low, high = int(ratio.argmin()), int(ratio.argmax())
    return (int(sound[low]), float(ratio[low])), (int(sound[high]), float(ratio[high]))


def _range(ends: Ends | None) -> Range | None:
    return Range(ends[0][1], ends[1][1]) if ends else None


def extremes_of(measure: str, ends: Ends | None) -> Extremes:
    """The smallest and the largest value of a measure, unless they are the same."""
    if ends is None or ends[0][1] == ends[1][1]:
        return {}
    return {f"{measure}_min": ends[0], f"{measure}_max": ends[1]}
