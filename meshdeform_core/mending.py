"""A grid that another program deformed: its judgement, and its repair, during which its boundary remains in place."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from .boundary import Boundary, Kind, classify
from .boundary.classification import ClassifiedPatch, with_plates
from .boundary.motions.motion import GIVEN
from .boundary.tables import BoundaryNodes
from .deform import impose, undeformed_of
from .errors import GridError
from .grid import FloatArray, Grid
from .grid.blocks import rounded
from .grid.selection import with_components
from .grid.topology import Topology, find_topology
from .memory import UNLIMITED, MemoryLimit
from .methods import Progress
from .numerics.geometry.coincidence import distinct
from .quality import Assessment, Original, assess
from .quality.difference import require_same_blocks
from .quality.listed import find_pinned
from .quality.validity import Comparison, judge
from .repair.constraints import Constraints
from .repair.options import Limit
from .repair.outcome import Judged, Repair
from .repair.region import Basis
from .repair.repair import WEAK, Repairer
from .repair.tuned import FARTHEST
from .setup import Case, Setup, Timing, Undeformed

MANY = 0.01
"""If more than this share of the cells is bad, their positions are of little use: the interior is remade at once."""


@dataclass(frozen=True)
class Renewal:
    """An interior that was remade: by which method, in how many steps, and why."""

    method: str
    steps: int
    reason: str


@dataclass(frozen=True, eq=False, repr=False)
class Mended:
    """A repaired grid, its assessment against the original, the repair (``None``: not needed), and warnings.

    ``renewal`` is set instead if the interior was remade from the original.
    """

    grid: Grid
    original: Grid
    topology: Topology
    boundary: Boundary
    assessment: Assessment
    repair: Repair | None
    warnings: tuple[str, ...]
    renewal: Renewal | None = None


def _undeformed(grid: Grid, original: Grid, case: Case) -> tuple[Grid, Topology]:
    """The original of a grid with the components and plates of the case, and its topology."""
    require_same_blocks(grid, original)
    original = with_components(original, case.components)
    return with_plates(original, find_topology(original, case.tolerance), case.plates)


def judge_grid(grid: Grid, original: Grid, case: Case) -> tuple[Assessment, tuple[str, ...]]:
    """Judge ``grid`` against ``original``, which may be the same; the case defines the moving walls.

    Returns the assessment and the warnings about the original.
    """
    original, topology = _undeformed(grid, original, case)
    boundary = classify(original, topology, case.boundaries, case.constants) if case.boundaries else None
    notes = (*original.notes, *(boundary.notes if boundary else ()))
    return assess(Original(original, topology), grid.points, boundary), notes


def mend(
    grid: Grid,
    original: Grid,
    case: Case,
    precision: str | None = None,
    memory: MemoryLimit = UNLIMITED,
    progress: Progress | None = None,
) -> Mended:
    """Move nodes of ``grid``, the deformed ``original``, until every cell is sound that is sound in ``original``.

    If many cells are bad, or moving nodes does not make all of them valid, ``original`` is deformed again by the method
    of the case to match the boundary of ``grid``, and the better of the two grids is the result.

    Nodes of moving and fixed boundaries of the case remain exactly in place, others slide or follow their periodic
    images; without boundary entries all outside nodes are held, except on the end planes of a grid one cell thick. With
    ``case.repair.mode`` ``polish`` the worst cells of a valid grid are improved; with ``off`` the grid is only judged.

    Parameters
    ----------
    precision : ``float32`` or ``float64`` of the file that will be written, to which the verdict applies
    """
    original, topology = _undeformed(grid, original, case)
    boundary = classify(original, topology, case.boundaries, case.constants)
    _require_closed(grid, topology, case.tolerance)
    width = precision or grid.precision
    undeformed = undeformed_of(original, topology, boundary, memory, case.repair.min_jacobian)
    measured, written = undeformed.original, partial(rounded, precision=width)
    cells = Comparison(measured, written(grid.points))
    start = found = Judged(grid.points, cells.verdict, cells)
    bad, renewal = int(np.count_nonzero((cells.verdict.ratio < WEAK) | (cells.verdict.failed != 0))), None
    many = not found.verdict.valid and bad > MANY * original.n_cells
    for remake in () if case.repair.mode == "off" else (many, not many):
        if remake:
            left = f"moving nodes left {found.count:,} invalid cells"
            why = f"{bad:,} of {original.n_cells:,} cells were bad" if many else left
            other, steps = _remade(start, undeformed, case, width, progress)
            if other.count < found.count:
                found, renewal = other, Renewal(case.method.name, steps, why)
        else:
            other = _moved(start, undeformed, case, written, progress)
            # Moving nodes of the grid itself leaves at most as many cells invalid.
            if found is start or other.count < found.count:
                found, renewal = other, None
        if found.verdict.valid:
            break
    notes = [*original.notes, *(boundary.notes if case.boundaries else ())]
    if not found.verdict.valid:
        change = (grid.points - original.points)[topology.first]
        crossings, pinned = undeformed.crossings(change), find_pinned(undeformed.original, boundary, change)
        reasons = [f"the boundary crosses itself, so no valid grid exists: {each}" for each in crossings[:1]]
        reasons += [pinned] if pinned else []
        notes += reasons or ["no valid grid was found; whether there is one is not known"]
        if not case.boundaries:
            notes.append("all outside nodes stay where they are; a case file (-c) tells which faces may slide")
    if found.repair and found.repair.left_out:
        notes.append(f"the grid was not repaired: {found.repair.left_out}")
    final = written(found.points)
    assessment = assess(measured, final, boundary if case.boundaries else None)
    return Mended(grid.moved(final), original, topology, boundary, assessment, found.repair, tuple(notes), renewal)


def _moved(
    start: Judged,
    undeformed: Undeformed,
    case: Case,
    written: Callable[[FloatArray], FloatArray],
    progress: Progress | None,
) -> Judged:
    """The grid at the ``start`` with the nodes moved that a repair moves."""
    measured, grid, first = undeformed.original, undeformed.grid, undeformed.topology.first
    # Another program may have left nodes off the surface on which they slide.
    constraints = Constraints.of(measured, undeformed.boundary).without_sliding()
    change = np.abs(start.points - grid.points)[first].max(axis=1)
    constraints = dataclasses.replace(constraints, walls=constraints.walls | (constraints.held & (change > 0.0)))
    largest, polish = float(change[constraints.held].max(initial=0.0)), case.repair.mode == "polish"
    limit, farthest = Limit.of(grid, case.repair.time_limit), FARTHEST * largest if largest else np.inf
    repairer = Repairer(Basis(measured, constraints), written, undeformed.memory, progress, limit, farthest)
    found = repairer.repair(start, polish) or start
    if polish and start.verdict.valid:
        # Polishing minimises a different measure, so it may not improve this one.
        before, after = (each.smallest_scaled_jacobian(measured, written) for each in (start, found))
        return found if after >= before else start
    return found


def _remade(
    start: Judged, undeformed: Undeformed, case: Case, precision: str, progress: Progress | None
) -> tuple[Judged, int]:
    """The undeformed grid, deformed so that nodes of moving and fixed boundaries take their positions at the ``start``,
    to the bit; and in how many steps. The ``start`` if none of them has moved.

    Faces count as moving where such nodes have moved, and as fixed elsewhere.
    """
    original, topology, boundary = undeformed.grid, undeformed.topology, undeformed.boundary
    change = np.where(boundary.known[:, None], (start.points - original.points)[topology.first], 0.0)
    moved = np.asarray(change.any(axis=1))
    if not moved.any():
        return start, 0
    known = boundary.quad_kind >= Kind.FIXED
    moving = known & moved[topology.quads.corners].any(axis=1)
    quads, rest = np.flatnonzero(moving), np.flatnonzero(known & ~moving)
    nodes, at_rest = (distinct(topology.quads.corners[some], topology.n_unique) for some in (quads, rest))
    kind = np.where(boundary.known, Kind.FIXED, boundary.kind).astype(np.int8)
    kind[nodes] = kind[moved] = Kind.MOVING
    classified = dataclasses.replace(
        boundary,
        kind=kind,
        quad_kind=np.where(moving, Kind.MOVING, np.where(known, Kind.FIXED, boundary.quad_kind)).astype(np.int8),
        patches=(
            ClassifiedPatch("moved", Kind.MOVING, nodes, quads),
            ClassifiedPatch("at rest", Kind.FIXED, at_rest, rest),
            *(patch for patch in boundary.patches if patch.kind < Kind.FIXED),
        ),
        movers=((nodes, GIVEN.prepare(BoundaryNodes.of_quads(original, topology, quads))),),
    )
    setup = Setup(undeformed_of(original, topology, classified, undeformed.memory, undeformed.min_jacobian), case, ())
    result = impose(setup, lambda fraction: fraction * change, None, precision, Timing(progress=progress), progress)
    points: FloatArray = np.array(result.grid.points)
    held = topology.face_nodes[boundary.known[topology.number]]
    points[held] = start.points[held]
    return Judged(points, judge(undeformed.original, rounded(points, precision)), None, result.repair), result.steps


def _require_closed(grid: Grid, topology: Topology, tolerance: float) -> None:
    """Require that nodes that coincide in the original also do so in the deformed grid."""
    at = grid.nodes.at(topology.face_nodes)
    gap = np.sqrt(((at - grid.nodes.at(topology.first[topology.number])) ** 2).sum(axis=1))
    apart = gap > tolerance * topology.edge[topology.number]
    if apart.any():
        worst = int(np.argmax(np.where(apart, gap, 0.0)))
        x, y, z = at[worst]
        raise GridError(
            f"{int(apart.sum())} block nodes that coincide with others in the reference do not in the grid, by up to "
            f"{gap[worst]:.3g} at ({x:.6g}, {y:.6g}, {z:.6g}); expected a grid whose blocks are still connected"
        )
