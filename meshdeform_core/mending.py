"""A grid that another program deformed: its judgement, and its repair, during which its boundary remains in place."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from .boundary import Boundary, Kind, classify
from .boundary.classification import UNSELECTED, ClassifiedPatch, with_plates
from .boundary.crossing import find_pinned
from .boundary.motions.motion import GIVEN
from .boundary.tables import BoundaryNodes
from .deform import Result, Timing, impose
from .errors import GridError
from .grid import FloatArray, Grid
from .grid.blocks import rounded
from .grid.selection import with_components
from .grid.topology import Topology, find_topology
from .memory import UNLIMITED, MemoryLimit
from .methods import Progress
from .numerics.geometry.coincidence import distinct
from .overset import undeformed_of
from .quality import Assessment, Original, assess
from .quality.difference import require_same_blocks
from .quality.validity import Comparison, judge
from .repair.constraints import Constraints
from .repair.options import Limit
from .repair.outcome import Judged, Repair
from .repair.region import Basis
from .repair.repair import WEAK, Repairer
from .repair.tuned import FARTHEST
from .setup import Case, Setup

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

    def __repr__(self) -> str:
        return f"Mended(valid={self.assessment.valid})"


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
    measured = Original(original, topology, case.repair.min_jacobian)
    # Another program may have left nodes off the surface on which they slide.
    constraints = Constraints.of(measured, boundary).without_sliding()
    change = np.abs(grid.points - original.points)[topology.first].max(axis=1)
    moved, largest = change > 0.0, float(change[constraints.held].max(initial=0.0))
    constraints = dataclasses.replace(constraints, walls=constraints.walls | (constraints.held & moved))
    limit = Limit.of(original.n_nodes, case.repair.time_limit)
    written = partial(rounded, precision=width)
    farthest = FARTHEST * largest if largest else np.inf
    repairer = Repairer(Basis(measured, constraints), written, memory, progress, limit, farthest)
    cells = Comparison(measured, written(grid.points))
    start = found = _Found(grid.points, cells.verdict, cells)
    mode = case.repair.mode
    if mode != "off":

        def renew(reason: str, than: _Found) -> _Found:
            result = renewed(grid, original, (topology, boundary), case, width, memory, progress)
            if result is None:
                return than
            points, how = result.grid.points, Renewal(case.method.name, result.steps, reason)
            return than.or_better(_Found(points, judge(measured, written(points)), None, result.repair, how))

        found = _mended(start, repairer, renew, mode == "polish")
        if mode == "polish" and cells.verdict.valid:
            # Polishing minimises a different measure, so it may not improve this one.
            before, after = (each.smallest_scaled_jacobian(measured, written) for each in (start, found))
            found = found if after >= before else start
    final = written(found.points)
    walls = boundary if case.boundaries else None
    notes = (*original.notes, *(boundary.notes if case.boundaries else ()))
    reasons = [] if found.verdict.valid else _reasons(original, topology, boundary, grid.points)
    if not found.verdict.valid and not case.boundaries:
        reasons.append("all outside nodes stay where they are; a case file (-c) tells which faces may slide")
    if found.repair and found.repair.left_out:
        reasons.append(f"the grid was not repaired: {found.repair.left_out}")
    assessment, told = assess(measured, final, walls), (*notes, *reasons)
    return Mended(grid.moved(final), original, topology, boundary, assessment, found.repair, told, found.renewal)


@dataclass(frozen=True, eq=False)
class _Found(Judged):
    """A judged grid, and how its interior was remade."""

    renewal: Renewal | None = None

    def or_better(self, other: _Found) -> _Found:
        """The one with fewer invalid cells; this one if both have as many."""
        return other if other.count < self.count else self


def _mended(start: _Found, repairer: Repairer, renew: Callable[[str, _Found], _Found], polish: bool) -> _Found:
    """Move nodes, remake the interior, or both, whichever is more promising first, until the grid is valid."""
    found, verdict = start, start.verdict
    bad = int(np.count_nonzero((verdict.ratio < WEAK) | (verdict.failed != 0)))
    many = not verdict.valid and bad > MANY * len(verdict.failed)
    if many:
        found = renew(f"{bad:,} of {len(verdict.failed):,} cells were bad", found)
    if found.renewal is None or not found.verdict.valid:
        outcome = repairer.repair(start, polish)
        if outcome:
            moved = _Found(outcome.points, outcome.verdict, outcome.cells, outcome.repair)
            found = moved if found is start else found.or_better(moved)
    if not many and not found.verdict.valid:
        found = renew(f"moving nodes left {len(found.verdict.invalid):,} invalid cells", found)
    return found


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


def _reasons(original: Grid, topology: Topology, boundary: Boundary, points: FloatArray) -> list[str]:
    """Why no valid grid can be found, if the boundary alone shows it."""
    change = (points - original.points)[topology.first]
    found = []
    for crossing in undeformed_of(original, topology, boundary).crossings(change)[:1]:
        place = ", ".join(f"{x:.6g}" for x in crossing.point)
        names = " and ".join(name for name in dict.fromkeys(crossing.patches) if name != UNSELECTED) or "a part"
        found.append(f"the boundary crosses itself, so no valid grid exists: {names} near ({place})")
    pinned = find_pinned(original, topology, boundary, change)
    found += [pinned] if pinned else []
    return found or ["no valid grid was found; whether there is one is not known"]


def renewed(
    grid: Grid,
    original: Grid,
    placed: tuple[Topology, Boundary],
    case: Case,
    precision: str,
    memory: MemoryLimit,
    progress: Progress | None = None,
) -> Result | None:
    """Deform ``original`` so that nodes of moving and fixed boundaries take their positions in ``grid``, to the bit.

    ``placed`` are topology and boundary classified by the case. Faces count as moving where such nodes have moved, and
    as fixed elsewhere. Returns ``None`` if none has moved.
    """
    topology, boundary = placed
    change = np.where(boundary.known[:, None], (grid.points - original.points)[topology.first], 0.0)
    moved = np.asarray(change.any(axis=1))
    if not moved.any():
        return None
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
    setup = Setup(undeformed_of(original, topology, classified, memory, case.repair.min_jacobian), case, ())
    result = impose(setup, lambda fraction: fraction * change, None, precision, Timing(progress=progress), progress)
    points: FloatArray = np.array(result.grid.points)
    held = topology.face_nodes[boundary.known[topology.number]]
    points[held] = grid.points[held]
    return dataclasses.replace(result, grid=original.moved(points))
