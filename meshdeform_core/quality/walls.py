"""Grid lines at walls, their direction, the height of the first cell, the thickness of the first layers; measures of
grid lines at walls and interfaces, assigned to the adjacent cells."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..boundary import Boundary
from ..grid import BoolArray, FloatArray, Grid, IntArray
from ..grid.planes import plane_normal
from ..grid.topology import Topology, cells_behind
from ..parallel import Nodes
from .cells import cells_alike
from .lines import InterfaceLines, WallFace, WallLines, kink_and_jump, lines_across, wall_faces, wall_lines
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


def wall_cells(before: Grid, topology: Topology, after: FloatArray, quads: IntArray) -> tuple[FloatArray, FloatArray]:
    """Deviation (degrees) and height ratio (n_cells,) of the cells at wall ``quads``, NaN elsewhere.

    A cell gets the largest deviation of its grid lines at the wall in coordinates ``after`` (n_nodes, 3) and, of the
    ratios of first-cell heights after to before along them, the one farthest from 1.
    """
    known = _of_no_cell(before), _of_no_cell(before)
    deviation, ratio = (Nodes.of(values).rows for values in known)
    chosen = np.zeros(len(topology.partner), dtype=bool)
    chosen[quads] = True
    normal = plane_normal(before)
    for face in wall_faces(before, topology, chosen):
        angle, height, _ = wall_lines(face, after, normal)
        old = wall_lines(face, before.points, normal).height
        change = np.divide(height, old, out=np.full(height.shape, np.nan), where=old > 0)
        first = topology.quads.of_side(face.block, face.side).start
        cells = cells_behind(before, topology, first + np.flatnonzero(face.wall))
        own = _of_rank(known[0], cells)
        cells = cells[own]
        deviation[cells] = np.fmax(deviation[cells], _corners(face, angle)[own].max(axis=1))
        ratio[cells] = _farthest(ratio[cells], _corners(face, change)[own])
    return known


def _of_no_cell(grid: Grid) -> FloatArray:
    values: FloatArray = cells_alike(grid, np.float64)
    Nodes.of(values).own[...] = np.nan
    return values


def _of_rank(values: FloatArray, cells: IntArray) -> BoolArray:
    """Which of some cells belong to this rank."""
    low, high = Nodes.of(values).ends
    return np.asarray((cells >= low) & (cells < high))


def _corners(face: WallFace, values: FloatArray) -> FloatArray:
    """Node values of a wall face at the corners (n, 2 or 4) of its wall quads."""
    at_nodes = np.full(face.nodes.shape, np.nan)
    at_nodes[face.touched] = values
    return np.stack([at_nodes[window][face.wall] for window in face.corners], axis=1)


def _farthest(known: FloatArray, ratios: FloatArray) -> FloatArray:
    """(n,) the ratio farthest from 1 among ``ratios`` (n, m) and the ``known`` ones (n,)."""
    all_ratios = np.concatenate([known[:, None], ratios], axis=1)
    with np.errstate(divide="ignore"):
        reach = np.abs(np.log(np.maximum(all_ratios, 0.0)))
    at = np.argmax(np.where(np.isnan(reach), -1.0, reach), axis=1)
    return np.asarray(np.take_along_axis(all_ratios, at[:, None], axis=1)[:, 0])


def interface_cells(
    grid: Grid, topology: Topology, after: FloatArray, before: FloatArray | None
) -> tuple[FloatArray, FloatArray]:
    """Kink (degrees) and spacing jump (n_cells,) of the cells beside shared faces, NaN elsewhere.

    A cell gets the largest magnitude among the grid lines through its faces; with coordinates ``before`` (n_nodes, 3),
    of the changes since these.
    """
    kink, jump = _of_no_cell(grid), _of_no_cell(grid)
    quads = np.flatnonzero(topology.partner > np.arange(len(topology.partner)))
    if quads.size == 0:
        return kink, jump
    lines, _ = lines_across(grid, topology, quads)
    found = list(kink_and_jump(lines, after))
    if before is not None:
        found = [now - then for now, then in zip(found, kink_and_jump(lines, before), strict=True)]
    for target, values in zip((kink, jump), found, strict=True):
        worst = np.abs(values).max(axis=1)
        for sides in (quads, topology.partner[quads]):
            cells = cells_behind(grid, topology, sides)
            own = _of_rank(target, cells)
            np.fmax.at(Nodes.of(target).rows, cells[own], worst[own])
    return kink, jump


def cell_at_wall(grid: Grid, faces: Sequence[WallFace], number: int) -> int:
    """A wall cell at one of the grid lines off ``faces``, numbered as by :func:`.lines.wall_lines`."""
    for face in faces:
        touched = np.argwhere(face.touched)
        if number < len(touched):
            # At the edge of a wall, not all cells around a node are wall cells.
            quads = np.argwhere(face.wall)
            away = touched[number] - quads
            a, b = quads[int(np.argmax(((away == 0) | (away == 1)).all(axis=1)))]
            return _cell_along(grid, int(face.nodes[a, b]), int(face.nodes[a, b] + face.step))
        number -= len(touched)
    raise IndexError(f"there are {number} grid lines fewer at walls")


def cell_at_interface(grid: Grid, lines: InterfaceLines, number: int) -> int:
    """A cell with the first segment of one of the grid lines across interfaces, in the order of ``lines``."""
    return _cell_along(grid, int(lines.before[number]), int(lines.here[number]))


def _cell_along(grid: Grid, node: int, neighbour: int) -> int:
    """The cell beyond the edge between two nodes (flat indices) of a block; at the end of the block the one before."""
    block = int(np.searchsorted(grid.offsets, node, side="right")) - 1
    ends = np.array(np.unravel_index([node - grid.offsets[block], neighbour - grid.offsets[block]], grid.shapes[block]))
    shape = grid.cell_shapes[block]
    cell = np.minimum(ends.min(axis=1), np.array(shape) - 1)
    return int(grid.cell_offsets[block] + np.ravel_multi_index(tuple(cell), shape))
