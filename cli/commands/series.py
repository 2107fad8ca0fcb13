"""``meshdeform series``: a motion over time."""

from __future__ import annotations

import dataclasses
import time as clock
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ..checks import check_order, check_reports, too_large
from ..options import CaseInput, GridInput, RunInput, SeriesInput, grid_options, packed
from ..process.progress import ProgressBar

if TYPE_CHECKING:
    from .. import series_run


@click.command("series")
@grid_options
@packed(SeriesInput, "wanted")
@packed(CaseInput, "case")
@packed(RunInput, "run")
def command(source: GridInput, case: CaseInput, wanted: SeriesInput, run: RunInput) -> int:
    """Deform GRID at every time level and write one grid per level, with an index for ParaView.

    \b
    Examples:
      meshdeform series wing.cgns -c flutter.toml --times 0:0.5:0.01 -o flutter
      meshdeform series grid.xyz -c case.toml --times 0:1:0.1 -o out --suffix .vtm --velocity second
      meshdeform series wing.cgns -c flutter.toml --times 0:0.5:0.01 -o flutter --report flutter.json
      meshdeform series wing.cgns -c flutter.toml --times 0:0.5:0.01 -o flutter --resume
      meshdeform series wing.cgns -d 'surface_*.csv' --times 0:0.5:0.01 -o flutter

    Everything that depends only on the undeformed grid is computed once. Files are complete whenever the run is
    stopped; OUTPUT/series.json holds the state for --resume. Levels with invalid cells are written with .invalid before
    the suffix (exit code 3).
    """
    start = clock.perf_counter()
    if case.empty:
        raise click.UsageError("Nothing to do: give a case file (-c) or displacement files (-d).")
    check_order(source, case)
    if case.displacement and not wanted.times:
        raise click.UsageError("Displacement files (-d 'surface_*.csv') need their times: --times START:STOP:STEP.")
    if wanted.resume and run.force:
        raise click.UsageError("--resume continues a series, --force restarts it; give one of them.")
    check_reports(run.reports, run.force or wanted.resume, *source.files, *case.files)

    from .. import series_run, work

    timed = dataclasses.replace(case, times=wanted.times)
    if run.dry_run:
        return work.in_parts(lambda: _dry_run(source, timed, wanted, run), run.verbose)
    begun = False

    def deform() -> int:
        nonlocal begun
        with ProgressBar(not run.quiet) as progress:
            plan = _planned(source, timed, wanted, run, wanted.output)
            # The first rank alone continues what all of them have begun.
            begin = partial(series_run.open_manifest, plan, wanted.resume or begun, run.force and not begun)
            plan.manifest = plan.job.ranks.on_first(begin)
            plan.files.recall(plan.manifest.levels)
            begun = True
            report = series_run.carry_out(plan, progress)
        files = [*source.roles, *case.roles(plan.job.case), ("index", plan.files.view)]
        return work.conclude(report, run, start, files, partial(series_run.illustrate, plan), plan.job.ranks)

    return work.in_parts(deform, run.verbose)


def _planned(
    source: GridInput, case: CaseInput, wanted: SeriesInput, run: RunInput, workplace: Path | None
) -> series_run.Run:
    from .. import series_run, work

    job = work.load(source, case, run, run.reports, wanted.suffix or "", workplace, wanted.velocity_bytes)
    plan = series_run.prepare(job, source, wanted, run)
    run.warnings.tell(plan.setup.warnings)
    return plan


def _dry_run(source: GridInput, case: CaseInput, wanted: SeriesInput, run: RunInput) -> int:
    """Print what the series would do and take; returns the exit code."""
    from .. import series_run, work
    from ..dry_run import Outputs, plan, plan_by_sizes

    what = case.read()
    doing = work.work_of(what, run, wanted.suffix or "", wanted.velocity_bytes)
    if layout := too_large(run.memory, doing, source):
        output = wanted.output / series_run.name_of(source.path, wanted, layout.format)
        precision = run.variant_options.get("precision", layout.precision)
        outputs = Outputs(output, precision, len(series_run.times_of(what, wanted)), wanted.velocity)
        return work.print_plan(plan_by_sizes(layout, doing, outputs, run.memory), False, run)
    with ProgressBar(not run.quiet):
        ready = _planned(source, case, wanted, run, None)
        times, files = ready.schedule.times, ready.files
        outputs = Outputs(files.path(0), files.variant.precision, len(times), wanted.velocity)
        planned = plan(ready.setup, times, wanted.steps, outputs, ready.shortage(0), ready.job.demand, run.memory)
        paths = f"{files.path(0)} ... {files.path(len(times) - 1)}"
        text = f"series    {len(times)} levels from t = {times[0]:g} to {times[-1]:g}: {paths}\n"
    return work.print_plan(*planned, run, text)
