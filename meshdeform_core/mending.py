"""The repair of a grid that another program has deformed: its boundary stays where it is."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from .boundary import Boundary, classify
from .boundary.crossing import CrossingTest
from .boundary.pinned import find_pinned
from .errors import GridError
from .grid import FloatArray, Grid
from .grid.precision import rounded
from .grid.topology import Topology, find_topology
from .memory import UNLIMITED, MemoryLimit
from .methods import Progress
from .quality import Assessment, Original, assess
from .quality.comparison import Comparison
from .quality.difference import require_same_blocks
from .repair.constraints import Constraints
from .repair.repair import Repair, Repairer
from .repair.time_limit import TimeLimit
from .setup import Case


@dataclass(frozen=True, eq=False, repr=False)
class Mended:
    """A repaired grid, its assessment against the original, what was done (``None``: nothing), and what is doubtful."""

    grid: Grid
    original: Grid
    topology: Topology
    boundary: Boundary
    assessment: Assessment
    repair: Repair | None
    warnings: tuple[str, ...]

    def __repr__(self) -> str:
        return f"Mended(valid={self.assessment.valid})"


def mend(
    grid: Grid,
    original: Grid,
    case: Case,
    precision: str | None = None,
    memory: MemoryLimit = UNLIMITED,
    progress: Progress | None = None,
) -> Mended:
    """Move nodes of ``grid``, the deformed ``original``, until every cell is sound that is sound in ``original``.

    Nodes of moving and fixed boundaries of the case stay exactly in place, others slide or repeat as it specifies;
    without boundary entries all outside nodes stay, except on the end planes of a grid that is one cell thick. With
    ``case.repair.mode`` ``polish`` the worst cells of a valid grid are improved; with ``off`` the grid is only judged.

    Parameters
    ----------
    precision : ``float32`` or ``float64`` of the file that will be written; the verdict is about that

    Raises
    ------
    GridError
        When the two have different blocks, or nodes that coincide in the original are apart.
    """
    require_same_blocks(grid, original)
    topology, boundary = classify(original, find_topology(original, case.tolerance), case.boundaries, case.constants)
    _require_closed(grid, topology, case.tolerance)
    width = precision or grid.precision
    measured = Original(original, topology, case.repair.min_jacobian)
    # Another program may have left nodes beside the surface on which they slide.
    constraints = Constraints.of(original, topology, boundary).without_sliding()
    moved = np.abs(grid.points - original.points)[topology.first].max(axis=1) > 0.0
    constraints = dataclasses.replace(constraints, walls=constraints.held & moved)
    limit = TimeLimit(case.repair.time_limit)
    repairer = Repairer(measured, constraints, lambda points: rounded(points, width), memory, progress, limit)
    cells = Comparison(measured, rounded(grid.points, width))
    points, verdict, repair = grid.points, cells.verdict, None
    mode = case.repair.mode
    if mode == "polish" or (mode == "auto" and repairer.needed(verdict, cells)):
        outcome = repairer.repair(points, verdict, polish=mode == "polish")
        points, verdict = outcome.points, outcome.verdict
        repair = outcome.repair if outcome.repair.newton_steps else None
    final = rounded(points, width)
    walls = boundary if case.boundaries else None
    notes = (*original.notes, *(boundary.notes if case.boundaries else ()))
    reasons = [] if verdict.valid else _reasons(original, topology, boundary, grid.points)
    if not verdict.valid and not case.boundaries:
        reasons.append("all outside nodes stay where they are; a case file (-c) tells which faces may slide")
    return Mended(
        grid.moved(final), original, topology, boundary, assess(measured, final, walls), repair, (*notes, *reasons)
    )


def _require_closed(grid: Grid, topology: Topology, tolerance: float) -> None:
    """Nodes that coincide in the original must do so in the deformed grid."""
    at = grid.points[topology.face_nodes]
    gap = np.sqrt(((at - grid.points[topology.first[topology.number]]) ** 2).sum(axis=1))
    apart = gap > tolerance * topology.edge[topology.number]
    if apart.any():
        worst = int(np.argmax(np.where(apart, gap, 0.0)))
        x, y, z = at[worst]
        raise GridError(
            f"{int(apart.sum())} block nodes that coincide with others in the reference do not in the grid, by up to "
            f"{gap[worst]:.3g} at ({x:.6g}, {y:.6g}, {z:.6g}); expected a grid whose blocks are still connected"
        )


def _reasons(original: Grid, topology: Topology, boundary: Boundary, points: FloatArray) -> list[str]:
    """Why no valid grid can be found, if the boundary alone shows it."""
    change = (points - original.points)[topology.first]
    found = []
    for crossing in CrossingTest(original, topology, boundary).crossings(change)[:1]:
        place = ", ".join(f"{x:.6g}" for x in crossing.point)
        names = " and ".join(dict.fromkeys(crossing.patches))
        found.append(f"the boundary crosses itself, so no valid grid exists: {names} near ({place})")
    pinned = find_pinned(original, topology, boundary, change)
    found += [pinned.message] if pinned else []
    return found or ["no valid grid was found; whether there is one is not known"]
