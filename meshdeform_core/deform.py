"""The set-up of a grid, and the whole sequence: from grid, boundary and method to a deformed grid and a verdict."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

from .boundary import Boundary, Kind, classify
from .boundary.classification import UNSELECTED, opening_notes, with_plates
from .errors import CaseError, MotionError
from .grid import FloatArray, Grid
from .grid.connections import check_connections
from .grid.openings import coincident_blocks, find_openings
from .grid.planes import require_extent
from .grid.selection import BY_PREFIX, with_components
from .grid.topology import Topology, find_topology
from .memory import UNLIMITED, MemoryLimit
from .methods import PreparedMethod, Progress
from .methods.limits import patch_motions
from .quality import Assessment, assess
from .repair.options import Limit
from .repair.outcome import Judged, Repair
from .repair.tuned import COLLAPSING
from .setup import Attempt, BoundaryMotion, Case, Result, Setup, Timing, Undeformed
from .stepping import (
    Course,
    State,
    adaptively,
    beginning,
    doubts,
    in_equal_steps,
    prepared_on,
    until_valid,
    warnings_ahead,
)
from .wording import Notice, counted

_BEFORE_REPAIR = ("invalid_cells", "min_scaled_jacobian", "min_relative_jacobian", "f_skew",
                  "wall_normal_deviation_deg", "first_cell_height_ratio")  # fmt: skip
"""Measures of the method's grid in the report of its repair."""
_WORSE = 0.9
"""A repair that lowers the smallest scaled Jacobian below this share of its value says so."""

__all__ = [
    "Attempt",
    "BoundaryMotion",
    "Case",
    "Repair",
    "Result",
    "Setup",
    "Timing",
    "deform",
    "impose",
    "set_up",
]


def set_up(grid: Grid, case: Case, timing: Timing | None = None, memory: MemoryLimit = UNLIMITED) -> Setup:
    """Find the topology and classify the boundary; ``memory`` is the method's limit in addition to the grid. The
    components of an overset grid must be named and have no face in common."""
    grid = with_components(grid, case.components)
    if grid.overset and not grid.components:
        raise CaseError(
            f"the {grid.n_blocks} blocks are connected by overset (Chimera) connectivity only, so nothing would keep "
            f"them together; the case has to name the blocks that belong together: [grid] components = "
            f'"{BY_PREFIX}", or patterns of block names'
        )
    timing = timing or Timing()
    require_extent(grid)
    with timing.stage("topology"):
        topology = find_topology(grid, case.tolerance)
        warnings = [*grid.notes, *case.notes, *check_connections(grid, topology), *coincident_blocks(grid, topology)]
        if topology.crowded:
            crowd = f"{topology.crowded} face quads are shared by more than two blocks, which no interface can be; "
            warnings.append(f"{crowd}check the grid for blocks that exist twice")
        openings = find_openings(grid, topology)
        if grid.component_numbers.any() and case.open_faces is not True:
            from .overset import require_apart

            require_apart(grid, topology)
        grid, topology = with_plates(grid, topology, case.plates)
        boundary = classify(grid, topology, case.boundaries, case.constants)
        unselected = boundary.quads_of(lambda patch: patch.name == UNSELECTED)
        moving = boundary.quads_of(lambda patch: patch.kind is Kind.MOVING)
        warnings += opening_notes(grid, topology, openings, unselected, moving, case.open_faces)
    if not boundary.count(Kind.MOVING):
        raise MotionError(
            "no node moves: no boundary entry of kind moving selects any node; "
            'expected a [[boundary]] with kind = "moving" and a motion, or a displacement table'
        )
    undeformed = undeformed_of(grid, topology, boundary, memory, case.repair.min_jacobian)
    return Setup(undeformed, case, (*warnings, *boundary.notes))


def undeformed_of(
    grid: Grid, topology: Topology, boundary: Boundary, memory: MemoryLimit = UNLIMITED, min_jacobian: float = 0.0
) -> Undeformed:
    """An undeformed grid; an :class:`.Overset` one if it has several components."""
    kind = Undeformed
    if grid.component_numbers.any():
        from .overset import Overset as kind
    return kind(grid, topology, boundary, memory, min_jacobian=min_jacobian)


def deform(
    grid: Grid,
    case: Case,
    *,
    time: float = 0.0,
    steps: int | str | None = None,
    precision: str | None = None,
    memory: MemoryLimit = UNLIMITED,
    progress: Progress | None = None,
    warn: Callable[[Sequence[str]], object] | None = None,
) -> Result:
    """Deform ``grid`` according to ``case`` and judge the result.

    Parameters
    ----------
    time : at which motions are evaluated
    steps : number of increments, each from the previous grid; ``"auto"``: as many as needed; ``None``: one if
        ``case.repair`` is off, otherwise ``"auto"``
    precision : ``float32`` or ``float64`` of the file that will be written (default: the grid's own); the verdict
        applies to the coordinates as written
    memory : limit for the method, in addition to the grid
    warn : called with the warnings of the set-up (also part of the result) before anything is computed

    Raises
    ------
    MeshDeformError
        For any fault of the input.
    """
    timing = Timing(progress=progress)
    setup = set_up(grid, case, timing, memory)
    if warn:
        warn(setup.warnings)
    return impose(setup, setup.motion(time), steps, precision or grid.precision, timing, progress)


def impose(
    setup: Setup,
    motion: BoundaryMotion,
    steps: int | str | None,
    precision: str,
    timing: Timing,
    progress: Progress | None = None,
    prepared: PreparedMethod | None = None,
) -> Result:
    """Impose a motion of the boundary; see :func:`deform`. The method of the case, ``prepared`` on the undeformed grid,
    is given where the motion is one of many."""
    limit = Limit.of(setup.grid, setup.case.repair.time_limit)
    course = Course(setup, motion, precision, timing, progress, limit)
    one_of_many = prepared is not None
    course.warnings.extend([*setup.warnings, *doubts(course, one_of_many)])
    if steps is None:
        steps = "auto" if course.repairing else 1
    if steps != "auto" and not (isinstance(steps, int) and steps > 0):
        raise CaseError(f'steps = {steps!r}; expected a whole number >= 1 or "auto"')

    def result(of: Course, prepared: PreparedMethod | None) -> Result:
        state = beginning(of, of.setup.case.method)
        if prepared:
            of.latest.append((state.found.points, state.options, prepared))
        if not of.setup.boundary.count(Kind.MOVING):
            # A component in which nothing moves.
            return _result(dataclasses.replace(state, fraction=1.0, steps=1), one_of_many)
        of.warnings.extend(warnings_ahead(of, prepared_on(state), steps))
        if isinstance(steps, int):
            return _result(in_equal_steps(state, steps), one_of_many)
        return _result((until_valid if of.repairing else adaptively)(state), one_of_many)

    if setup.grid.component_numbers.any():
        from .overset import impose_on_components

        return impose_on_components(course, prepared, result)
    return result(course, prepared)


def _result(state: State, one_of_many: bool) -> Result:
    course, setup, failed = state.course, state.course.setup, state.failed
    motion = patch_motions(setup.problem, course.total)
    # The motion is complete: free what the method has prepared, to make room for the assessment.
    course.latest.clear()
    if not one_of_many:
        setup.problem.forget()
    final = course.rounded(state.found.points)

    def judged(found: Judged, points: FloatArray) -> Assessment:
        def step_of(cell: int) -> int:
            return state.first_bad.get(cell, state.steps + (failed is not None))

        return assess(setup.original, points, setup.boundary, found.cells, step_of)

    with course.timing.stage("quality"):
        assessment = judged(state.found, final)
        if failed:
            # The grid kept is valid; users need to know which cells the next step would break.
            broken = judged(failed.found, course.rounded(failed.found.points))
            assessment = dataclasses.replace(assessment, invalid=broken.invalid)
        repair, plain = state.repairs, state.plain
        if repair and plain and state.repair and state.steps == 1 and state.options is setup.case.method:
            before = dataclasses.asdict(judged(plain, course.rounded(plain.points)).after)
            measures = {name: before[name] for name in _BEFORE_REPAIR}
            measures["f_skew"] = {name: before["f_skew"][name] for name in ("min", "mean")}
            repair = dataclasses.replace(repair, before=measures)
    return Result(
        setup=setup,
        grid=setup.grid.moved(final),
        assessment=assessment,
        account=(state if state.steps or failed is None else failed).account,
        steps=state.steps,
        reached=state.fraction,
        displacement=course.total,
        timing=course.timing,
        warnings=(*course.warnings, *state.notices.values(), *_notices(state, repair, assessment)),
        motion=motion,
        attempts=tuple(course.attempts),
        repair=repair,
    )


def _notices(state: State, repair: Repair | None, assessment: Assessment) -> list[str]:
    """What users need to know about the grid that is kept."""
    course, asked, used = state.course, state.course.setup.case.method.name, state.options.name
    found = list[str]()
    if used != asked:
        text = (
            f"the grid was made by {used} in {counted(state.steps, 'step')}, as attempts with {asked} left cells "
            "invalid or nearly collapsed (listed under attempts in the report)"
        )
        found.append(Notice(text, f"made by {used}"))
    if repair and repair.left_out:
        found.append(Notice(f"the grid was not repaired: {repair.left_out}", "no repair"))
    elif repair and assessment.valid and not repair.converged:
        text = (
            f"the repair did not reach the minimum over all nodes in {counted(repair.newton_steps, 'Newton step')}; "
            f"the grid is valid, but may change abruptly with the motion"
        )
        found.append(Notice(text, "unfinished repair"))
    before, after = (repair.before if repair else None), assessment.after.min_scaled_jacobian
    if before and not before["invalid_cells"] and after < _WORSE * before["min_scaled_jacobian"]:
        text = (
            f"the repair lowers the smallest scaled Jacobian from {before['min_scaled_jacobian']:.3g} to {after:.3g} "
            f"for better cells elsewhere; --repair off keeps the method's grid"
        )
        found.append(Notice(text, "a worse worst cell"))
    worst = assessment.after.worst["min_relative_jacobian"]
    if assessment.valid and worst.value < COLLAPSING:
        x, y, z = worst.center
        text = (
            f"cell {worst.block} {worst.ijk} at ({x:.6g}, {y:.6g}, {z:.6g}) is valid but nearly collapsed: a Jacobian "
            f"is {worst.value:.2g} of its original value"
        )
        found.append(Notice(text, "nearly collapsed cell"))
    if assessment.valid and state.fraction >= 1.0:
        # A wall may pass through itself where no cells lie between its sides; others cannot meet while cells are valid.
        with course.timing.stage("quality"):
            crossings = course.setup.undeformed.crossings(course.total)
        for crossing in crossings[:1]:
            text = (
                f"the moved boundary crosses itself: {crossing}. The cells are valid one by one, but the grid overlaps "
                f"itself there"
            )
            found.append(Notice(text, f"crossing of {' and '.join(crossing.patches)}"))
    return found
