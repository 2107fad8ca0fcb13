"""Warnings of a dry run about motions that are bound to fail, found by tests of the boundary and by a trial."""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path
from typing import TYPE_CHECKING

from meshdeform_core.boundary.crossing import find_pinned
from meshdeform_core.boundary.prescribed import largest_displacement
from meshdeform_core.deform import Result, Setup, Timing, impose, set_up
from meshdeform_core.memory import MemoryLimit
from meshdeform_core.methods import PreparedMethod
from meshdeform_core.methods.limits import patch_motions
from meshdeform_core.repair.limit import Limit
from meshdeform_core.setup import Start
from meshdeform_core.stepping.course import Course, doubts
from meshdeform_core.wording import counted
from meshdeform_formats.grids import variant_of
from meshdeform_formats.placing import shortage
from meshdeform_formats.report.records import Report, plan_report

from ..work import Imposed, Job, place_of
from .expense import Levels, expense_of

if TYPE_CHECKING:
    from ..series_run import Run

TRIAL_NODES = 5_000_000
"""Largest number of nodes times steps for which the motion is tried."""
_GROUPS = 2


@dataclasses.dataclass(frozen=True)
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
        expense = expense_of(job.grid, setup.case, output, precision, limit)
        report["expected"] = dataclasses.asdict(expense)
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
        expense = expense_of(run.setup.grid, run.setup.case, run.files.path(0), precision, limit, levels)
        report["expected"] = dataclasses.asdict(expense)
    return (
        report,
        expected.impossible,
        f"series    {len(times)} levels from t = {times[0]:g} to {times[-1]:g}: {run.files.path(0)} ... {last}\n",
    )


def _doubts(
    setup: Setup, prepared: PreparedMethod, time: float, steps: int | str | None, precision: str, one_of_many: bool
) -> list[str]:
    """The warnings that a run gives before its first step; see :func:`meshdeform_core.stepping.course.doubts`."""
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
