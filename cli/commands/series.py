"""``meshdeform series``: a motion over time."""

from __future__ import annotations

import dataclasses
import time as clock
from functools import partial
from pathlib import Path

import click

from meshdeform_core.parallel import current_ranks

from ..options import PATH, CaseInput, GridInput, RunInput, case_options, grid_options, run_options
from ..outputs import check_reports
from ..process.machine import use_threads
from ..process.progress import ProgressBar
from .deform import parse_steps


@click.command("series")
@grid_options
@click.option("-o", "--output", type=PATH, help="Folder for the levels; created if missing.")
@case_options
@click.option(
    "--times", metavar="START:STOP:STEP",
    help="Time levels, or a list a,b,c; by default those of the case's sequence of displacement files.",
)  # fmt: skip
@click.option(
    "--from", "origin", type=click.Choice(("reference", "last")), default="reference", show_default=True,
    help="Make each level from the undeformed grid, or from the previous level (marching).",
)  # fmt: skip
@click.option("--steps", metavar="N|auto", help="Impose each level in N steps; by default in as many as needed.")
@click.option(
    "--velocity", type=click.Choice(("none", "first", "second", "swept")), default="none", show_default=True,
    help="Write the grid velocity, by backward differences of this order, or the volumes swept by the cell faces as "
    "well (VTK and CGNS).",
)  # fmt: skip
@click.option("--suffix", help="Format of the levels, by suffix (default: that of GRID).")
@click.option("--single-file", is_flag=True, help="All levels in one CGNS file.")
@click.option("--resume", is_flag=True, help="Continue an interrupted run of the same series.")
@run_options
def command(
    source: GridInput, output: Path | None, case: CaseInput, times: str | None, origin: str, steps: str | None,
    velocity: str, suffix: str | None, single_file: bool, resume: bool, run: RunInput,
) -> int:  # fmt: skip
    """Deform GRID at every time level and write one grid per level, with an index for ParaView.

    \b
    Examples:
      meshdeform series wing.cgns -c flutter.toml --times 0:0.5:0.01 -o flutter
      meshdeform series grid.xyz -c case.toml --times 0:1:0.1 -o out --suffix .vtm --velocity second
      meshdeform series wing.cgns -c flutter.toml --times 0:0.5:0.01 -o flutter --single-file --report flutter.json
      meshdeform series wing.cgns -c flutter.toml --times 0:0.5:0.01 -o flutter --resume
      meshdeform series wing.cgns -d 'surface_*.csv' --times 0:0.5:0.01 -o flutter

    Everything that depends only on the undeformed grid is computed once. Files are complete whenever the run is
    stopped; OUTPUT/series.json holds the state for --resume. Levels with invalid cells are written with .invalid before
    the suffix (exit code 3).
    """
    start = clock.perf_counter()
    use_threads(run.threads)
    if output is None:
        raise click.UsageError("Missing option '-o' / '--output'.")
    if case.empty:
        raise click.UsageError("Nothing to do: give a case file (-c) or displacement files (-d).")
    if case.displacement and not times:
        raise click.UsageError("Displacement files (-d 'surface_*.csv') need their times: --times START:STOP:STEP.")
    if resume and run.force:
        raise click.UsageError("--resume continues a series, --force restarts it; give one of them.")
    check_reports(run.reports, run.force or resume, *source.files, *case.files)
    count, options, limit = parse_steps(steps), run.variant_options, run.memory

    from meshdeform_core.memory import SMOOTHNESS_ARRAYS, SWEPT_ARRAYS, VELOCITY_ARRAYS

    from .. import series_run, work

    wanted = series_run.Wanted(output, times, origin, velocity, count, suffix, single_file, options, run.fields)
    with ProgressBar(not run.quiet) as progress:
        more = SMOOTHNESS_ARRAYS + VELOCITY_ARRAYS * (velocity != "none") + SWEPT_ARRAYS * (velocity == "swept")
        job = work.load(source, dataclasses.replace(case, times=times), limit, run.reports, more_arrays=more)
        plan = series_run.prepare(job, source, wanted, run)
        run.warnings.tell(plan.setup.warnings)
        if run.dry_run:
            planned, impossible, levels = series_run.describe(plan)
        else:
            plan.manifest = current_ranks().on_first(lambda: series_run.open_manifest(plan, resume, run.force))
            report = series_run.carry_out(plan, progress)
    if run.dry_run:
        return work.print_plan(planned, impossible, run, levels)
    files = [*source.roles, *case.roles(job.case), ("index", plan.files.view)]
    return work.conclude(report, run, work.Delivery(start, files, partial(series_run.illustrate, plan)))
