"""Grid lines at walls, their direction, the height of the first cell, the thickness of the first layers; measures of
grid lines at walls and interfaces, assigned to the adjacent cells."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..boundary import Boundary
from ..grid import FloatArray, Grid, IntArray
from ..grid.planes import plane_normal
from ..grid.topology import Topology, cells_behind
from ..parallel import Nodes
from .cells import cells_alike
from .lines import InterfaceLines, WallLines, kink_and_jump, lines_across
from .listed import Worst, worst_cell
from .original import Original
from .validity import Range, Spread

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


WallQualities = dict[str, WallQuality | None]


def measure_walls(
    original: Original, boundary: Boundary | None, after: FloatArray
) -> tuple[WallQualities, WallQualities]:
    """The ``moving`` and the ``fixed`` walls before, and with coordinates ``after`` (n_nodes, 3).

    ``None`` where there are none. Fixed walls are fixed faces with the role of a wall (:mod:`..grid.faces`).
    """
    before: WallQualities = {"moving": None, "fixed": None}
    now: WallQualities = dict(before)
    grid, alike = original.grid, Range(1.0, 1.0)
    for name, (lines, old) in original.walls(boundary).items() if boundary is not None else ():
        if not lines.quads.size:
            continue
        new = lines.measure(after, original.normal)
        heights, layers = _ratios(old.height, new.height), _ratios(old.thickness, new.thickness)
        steepest = int(new.angle.argmax()), float(new.angle.max())
        worst: Extremes = {"wall_normal_deviation_deg": steepest} if steepest[1] else {}
        worst |= extremes_of("first_cell_height_ratio", heights) | extremes_of("layer_thickness_ratio", layers)
        found = {}
        for measure, (line, value) in worst.items():
            quad = int((lines.line == line).any(axis=1).argmax())
            cell = int(cells_behind(grid, original.topology, lines.quads[quad : quad + 1])[0])
            found[measure] = worst_cell(grid, after, cell, value)
        height, layer = (Range(ends[0][1], ends[1][1]) if ends else None for ends in (heights, layers))
        before[name] = WallQuality(Spread.of(old.angle), height and alike, layer and alike, {})
        now[name] = WallQuality(Spread.of(new.angle), height, layer, found)
    return before, now


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


def extremes_of(measure: str, ends: Ends | None) -> Extremes:
    """The smallest and the largest value of a measure, unless they are the same."""
    if ends is None or ends[0][1] == ends[1][1]:
        return {}
    return {f"{measure}_min": ends[0], f"{measure}_max": ends[1]}


def wall_cells(before: Grid, topology: Topology, after: FloatArray, quads: IntArray) -> tuple[FloatArray, FloatArray]:
    """Deviation (degrees) and height ratio (n_cells,) of the cells at wall ``quads``, NaN elsewhere.

    A cell gets the largest deviation of its grid lines at the wall in coordinates ``after`` (n_nodes, 3) and, of the
    ratios of first-cell heights after to before along them, the one farthest from 1.
    """
    chosen = np.zeros(len(topology.partner), dtype=bool)
    chosen[quads] = True
    lines, normal = WallLines.off(before, topology, chosen), plane_normal(before)
    old, new = (lines.measure(points, normal) for points in (before.points, after))
    change = np.divide(new.height, old.height, out=np.full(len(old.height), np.nan), where=old.height > 0)
    with np.errstate(divide="ignore"):
        far = np.abs(np.log(np.maximum(change, 0.0)))
    cells, pairs = cells_behind(before, topology, lines.quads), ((new.angle, new.angle), (change, far))
    angle, ratio = (_largest(before, cells, values[lines.line], size[lines.line]) for values, size in pairs)
    return angle, ratio


def _largest(grid: Grid, cells: IntArray, values: FloatArray, size: FloatArray) -> FloatArray:
    """Of the ``values`` (m, k) of ``cells`` (m,) those with the largest ``size`` (m, k), in (n_cells,), else NaN."""
    found: FloatArray = cells_alike(grid, np.float64)
    nodes = Nodes.of(found)
    nodes.own[...] = np.nan
    own = (cells >= nodes.low) & (cells < nodes.high)
    # In ascending order, so that a cell keeps the last one.
    order = np.argsort(np.where(np.isnan(size), -1.0, size)[own].ravel(), kind="stable")
    nodes.rows[np.repeat(cells[own], values.shape[1])[order]] = values[own].ravel()[order]
    return found


def interface_cells(
    grid: Grid, topology: Topology, after: FloatArray, before: FloatArray | None
) -> tuple[FloatArray, FloatArray]:
    """Kink (degrees) and spacing jump (n_cells,) of the cells beside shared faces, NaN elsewhere.

    A cell gets the largest magnitude among the grid lines through its faces; with coordinates ``before`` (n_nodes, 3),
    of the changes since these.
    """
    quads = np.flatnonzero(topology.partner > np.arange(len(topology.partner)))
    lines, _ = lines_across(grid, topology, quads)
    cells = np.concatenate([cells_behind(grid, topology, sides) for sides in (quads, topology.partner[quads])])
    found = list(kink_and_jump(lines, after))
    if before is not None:
        found = [now - then for now, then in zip(found, kink_and_jump(lines, before), strict=True)]
    kink, jump = (_largest(grid, cells, *[np.tile(np.abs(values), (2, 1))] * 2) for values in found)
    return kink, jump


def cell_at_interface(grid: Grid, lines: InterfaceLines, number: int) -> int:
    """A cell with the first segment of one of the grid lines across interfaces, in the order of ``lines``."""
    node, neighbour = int(lines.before[number]), int(lines.here[number])
    # At the end of a block the cell before.
    block = int(np.searchsorted(grid.offsets, node, side="right")) - 1
    ends = np.array(np.unravel_index([node - grid.offsets[block], neighbour - grid.offsets[block]], grid.shapes[block]))
    shape = grid.cell_shapes[block]
    cell = np.minimum(ends.min(axis=1), np.array(shape) - 1)
    return int(grid.cell_offsets[block] + np.ravel_multi_index(tuple(cell), shape))
