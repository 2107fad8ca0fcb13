"""Dry runs: what a run would do, warnings about motions that are bound to fail, found by tests of the boundary and by a
trial, and forecasts of memory and disk space from the sizes of the grid."""

from __future__ import annotations

import dataclasses
import functools
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from meshdeform_core.boundary.crossing import find_pinned
from meshdeform_core.boundary.prescribed import largest_displacement
from meshdeform_core.deform import Result, Setup, Timing, impose, set_up
from meshdeform_core.grid import FileFormat, Grid
from meshdeform_core.memory import Demand, MemoryLimit, Work, readable
from meshdeform_core.methods import PreparedMethod
from meshdeform_core.methods.limits import patch_motions
from meshdeform_core.parallel import current_ranks
from meshdeform_core.repair.limit import Limit
from meshdeform_core.setup import Start
from meshdeform_core.stepping.steps import Course, doubts
from meshdeform_core.wording import counted
from meshdeform_formats.grids import Layout, format_of, variant_of
from meshdeform_formats.placing import lack, least_bytes, shortage, velocity_bytes
from meshdeform_formats.report.records import Report, head_part, plan_report

from .work import Imposed, Job, place_of

if TYPE_CHECKING:
    from .series_run import Run

TRIAL_NODES = 5_000_000
"""Largest number of nodes times steps for which the motion is tried."""
_GROUPS = 2


@dataclass(frozen=True)
class Levels:
    """Number of grids that a run writes, and their velocities."""

    count: int = 1
    velocity: str = "none"


ONE = Levels()


def expense_of(
    grid: Grid | Layout, demand: Demand, output: Path | None, precision: str, limit: MemoryLimit, levels: Levels = ONE
) -> dict[str, int]:
    """What one step without a repair takes, at every level, in bytes: memory of each of the ranks that hold a part of
    the grid; temporary files of all of them, and the output. What has been taken from the ``limit`` is for pictures.

    Raises
    ------
    MethodError
        When the memory does not suffice even with large arrays in files.
    """
    ranks, (memory, files), written = current_ranks().count, demand.foretold(limit), 0
    if output is not None:
        options = grid.format.options if grid.format and grid.format.name == format_of(output) else {}
        size = least_bytes(grid, output, FileFormat(format_of(output), precision, options))
        written = levels.count * (size and size + velocity_bytes(grid, levels.velocity, precision))
    return {
        "ranks": ranks,
        "memory_bytes": memory + limit.taken,
        "work_bytes": ranks * files,
        "output_bytes": written,
    }


def plan_by_sizes(
    layout: Layout, work: Work, output: Path | None, variant: dict[str, str], limit: MemoryLimit, levels: Levels = ONE
) -> Report:
    """The report of a dry run for a grid that does not fit into memory, from the header of its file."""
    demand = Demand.of("deforming", work, layout)
    # How many nodes are sources is known only from coordinates.
    demand = dataclasses.replace(demand, sources=int(demand.outside))
    expense = expense_of(layout, demand, output, variant.get("precision", layout.precision), limit, levels)
    note = (
        f"the grid is larger than the memory ({readable(limit.size)}): only the header of its file was read; the "
        "boundary was not classified, the motion not tried"
    )
    warnings = [note]
    needed = expense["work_bytes"] + expense["output_bytes"]
    if output is not None and (missing := lack(needed, output, "files to work in and the output take")):
        warnings.append(missing)
    return head_part(layout) | {"expected": expense, "warnings": warnings}


@dataclass(frozen=True)
class Forecast:
    """Warnings about a motion, and whether the boundary alone shows that no valid grid exists for it."""

    warnings: list[str]
    impossible: bool


def plan(
    job: Job, output: Path | None, imposed: Imposed, variant: dict[str, str], limit: MemoryLimit
) -> tuple[Report, bool]:
    """The report of a dry run (classification, parameters, node counts, early warnings and, for a grid too large for a
    trial, its expense), and whether no valid grid exists."""
    chosen = variant_of(job.grid, output, variant) if output is not None else None
    precision = chosen.precision if chosen else job.grid.precision
    setup = set_up(job.grid, imposed.case(job.case.case), memory=job.memory)
    prepared = setup.prepare()
    motion = setup.displacement(imposed.time)
    largest = largest_displacement(motion)
    report = plan_report(setup, prepared.account, largest, patch_motions(setup.problem, motion))
    report["warnings"] += _doubts(setup, prepared, imposed.time, imposed.steps, precision, one_of_many=False)
    expected = forecast(setup, imposed.time, imposed.steps, precision)
    report["warnings"] += expected.warnings
    if output is not None and chosen and (missing := shortage(job.grid, output, chosen)):
        report["warnings"].append(missing)
    if job.grid.n_nodes > TRIAL_NODES:
        demand = dataclasses.replace(job.demand, sources=len(setup.problem.source_numbers))
        report["expected"] = expense_of(job.grid, demand, output, precision, limit)
    return report, expected.impossible


def plan_series(run: Run, levels: Levels, limit: MemoryLimit) -> tuple[Report, bool, str]:
    """The report of a dry run (classification, parameters, node counts and, for a grid too large for a trial, its
    expense), whether no valid grid exists at the level of the largest displacement, and the levels as a line of text.
    """
    prepared = run.setup.prepare()
    times = run.schedule.times
    largest, worst = max((largest_displacement(run.setup.displacement(t)), t) for t in times)
    last = run.files.path(len(times) - 1)
    report = plan_report(run.setup, prepared.account, largest)
    steps, precision = run.schedule.steps, run.files.variant.precision
    expected = forecast(run.setup, worst, steps, precision)
    found = [*_doubts(run.setup, prepared, worst, steps, precision, one_of_many=True), *expected.warnings]
    report["warnings"] += [f"at t = {worst:g}, where the displacement is largest: {text}" for text in found]
    if missing := run.shortage(0):
        report["warnings"].append(missing)
    if run.setup.grid.n_nodes > TRIAL_NODES:
        demand = dataclasses.replace(run.job.demand, sources=len(run.setup.problem.source_numbers))
        report["expected"] = expense_of(run.setup.grid, demand, run.files.path(0), precision, limit, levels)
    return (
        report,
        expected.impossible,
        f"series    {len(times)} levels from t = {times[0]:g} to {times[-1]:g}: {run.files.path(0)} ... {last}\n",
    )


def _doubts(
    setup: Setup, prepared: PreparedMethod, time: float, steps: int | str | None, precision: str, one_of_many: bool
) -> list[str]:
    """The warnings that a run gives before its first step; see :func:`meshdeform_core.stepping.steps.doubts`."""
    course = Course(setup, setup.motion(time), precision, Timing(), None, Start(setup.grid.points), Limit())
    # Adaptive steps are halved until they succeed, so none is too large.
    first = setup.displacement(time, 1 / steps if isinstance(steps, int) else 0.0)
    sources = setup.problem.source_numbers
    motion = setup.displacement(time)[sources]
    return [*doubts(course, one_of_many), *prepared.warnings_for(motion, first[sources])]


def forecast(setup: Setup, time: float, steps: int | str | None, precision: str) -> Forecast:
    """Warnings about a motion that is bound to fail, from tests of the boundary and from a trial of the method.

    The trial imposes the motion without repair, in the requested number of steps or in one, and judges the grid as the
    run would. It does not cover smaller steps and repairs, which the run tries afterwards.
    """
    motion = setup.displacement(time)
    contact = setup.undeformed.crossing_test.contact(functools.partial(setup.displacement, time))
    pinned = find_pinned(setup.grid, setup.topology, setup.boundary, motion)
    certain: list[str] = [found for found in (contact and contact.message, pinned) if found]
    count = steps if isinstance(steps, int) else 1
    if setup.grid.n_nodes * count > TRIAL_NODES:
        untried = (
            f"not tried: {counted(count, 'step')} with {setup.grid.n_nodes:,} nodes; trials are made up to "
            f"{TRIAL_NODES:,} nodes times steps"
        )
        return Forecast([*certain, untried], bool(certain))
    alone = setup.with_repair("off")
    result = impose(alone, alone.motion(time), count, precision, Timing())
    failures = [] if result.valid else [_failure(setup, result, steps, bool(certain))]
    return Forecast([*certain, *failures], bool(certain))


def _failure(setup: Setup, result: Result, steps: int | str | None, certain: bool) -> str:
    """The result of the trial, and how the run will respond to it."""
    cells, count = result.assessment.after.invalid_cells, result.steps
    groups = [place_of(dataclasses.asdict(group)) for group in result.assessment.groups[:_GROUPS]]
    found = (
        f"tried with {setup.case.method.name} in {counted(count, 'step')}: {counted(cells, 'cell')} "
        f"{'becomes' if cells == 1 else 'become'} invalid {' and '.join(groups)}"
    )
    if certain:
        return f"{found}; no repair can mend that"
    if setup.case.repair.mode == "off" and steps != "auto":
        return f"{found}; without repair the run is bound to fail: try --repair auto, --steps auto or another method"
    if setup.case.repair.mode == "off":
        return f"{found}; the run divides the motion, which may not reach all of it"
    more = "" if isinstance(steps, int) else ", then smaller steps"
    return f"{found}; the run will repair them{more}, which takes longer and may fail"
