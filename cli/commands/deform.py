"""``meshdeform deform``: the main job."""

from __future__ import annotations

import time as clock
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ..options import (
    OUTPUT,
    CaseInput,
    FiniteNumber,
    GridInput,
    RunInput,
    case_options,
    grid_options,
    parse_steps,
    run_options,
)
from ..outputs import check_output, check_reports
from ..process.machine import use_threads
from ..process.progress import ProgressBar
from ..room import too_large

if TYPE_CHECKING:
    from .. import work


@click.command("deform")
@grid_options
@click.option("-o", "--output", type=OUTPUT, help="Deformed grid; the suffix selects the format.")
@case_options
@click.option(
    "--steps",
    metavar="N|auto",
    callback=parse_steps,
    help="Impose the motion in N steps; by default in as many as needed.",
)
@click.option(
    "--time", "at_time", type=FiniteNumber(), metavar="T", help="Evaluate the motion at this time (default 0)."
)
@run_options
def command(
    source: GridInput, output: Path | None, case: CaseInput, steps: int | str | None, at_time: float | None,
    run: RunInput,
) -> int:  # fmt: skip
    """Deform GRID, judge the result and write it.

    \b
    Examples:
      meshdeform deform wing.cgns -c wing.toml -o bent.cgns
      meshdeform deform grid.xyz -d displacement.csv -o deformed.xyz -m idw-tfi --report report.json
      meshdeform deform grid.cgns -c case.toml --steps auto -s method.idw.alpha=0.3 -o deformed.cgns
      meshdeform deform grid.cgns -c case.toml -o deformed.vtm --field displacement --field f_skew
      meshdeform deform grid.cgns -c case.toml --dry-run

    Outside faces that no boundary entry selects are fixed. A deformed grid with invalid cells (exit code 3) is written
    next to OUT, with .invalid before the suffix; the report lists the cells.
    """
    start = clock.perf_counter()
    use_threads(run.threads)
    if output is None and not run.dry_run:
        raise click.UsageError("Missing option '-o' / '--output' (or --dry-run).")
    if case.empty:
        raise click.UsageError(
            "Nothing to do: give a case file (-c) or a displacement table (-d). To create a case file with every "
            f"boundary of the grid: meshdeform init {source.path} -o case.toml"
        )
    if not run.dry_run and output is not None:
        check_target(output, run, *source.files, *case.files)
    check_reports(run.reports, run.force, output, *source.files, *case.files)

    from .. import work

    imposed = work.Imposed(steps, at_time)
    if output is None or run.dry_run:
        return work.in_parts(lambda: _dry_run(source, case, output, imposed, run), run.verbose)

    def deform() -> int:
        with ProgressBar(not run.quiet) as progress:
            job = _load(source, case, output, run)
            report, illustrate = work.run(job, output, imposed, run.variant_options, run, progress)
        files = [*source.roles, *case.roles(job.case), ("output", Path(report["output"]))]
        return work.conclude(report, run, work.Delivery(start, files, illustrate, job.ranks))

    return work.in_parts(deform, run.verbose)


def _dry_run(source: GridInput, case: CaseInput, output: Path | None, imposed: work.Imposed, run: RunInput) -> int:
    """Print what the run would do and take; returns the exit code."""
    from .. import work
    from ..dry_run import forecast
    from ..dry_run.expense import plan_by_sizes

    if layout := too_large(run.memory, source):
        planned = plan_by_sizes(layout, case.read().case, output, run.variant_options, run.memory)
        return work.print_plan(planned, False, run)
    with ProgressBar(not run.quiet):
        job = _load(source, case, output, run)
        planned, impossible = forecast.plan(job, output, imposed, run.variant_options, run.memory)
    return work.print_plan(planned, impossible, run)


def _load(source: GridInput, case: CaseInput, output: Path | None, run: RunInput) -> work.Job:
    """The case and the grid; no output may replace a file that they name, or anything but an earlier invalid grid."""
    from meshdeform_formats.files import invalid_path
    from meshdeform_formats.grids import require_earlier_grid

    from .. import work

    outputs = [output, *([] if output is None or run.allow_invalid else [invalid_path(output)]), *run.reports]
    workplace = None if run.dry_run or output is None else output.parent
    job = work.load(source, case, run.memory, [path for path in outputs if path is not None], workplace)
    if output is not None and not (run.force or run.dry_run or run.allow_invalid):
        require_earlier_grid(invalid_path(output), job.grid)
    return job


def check_target(output: Path, run: RunInput, *inputs: Path | None) -> None:
    """Refuse an output that cannot be written, before anything is computed."""
    from meshdeform_formats.fields import check_fields
    from meshdeform_formats.files import invalid_path
    from meshdeform_formats.grids import format_of

    format_of(output)
    check_fields(run.fields, output, True)
    check_output(output, run.force, *inputs)
    if not run.allow_invalid:
        # The invalid grid of an earlier run may be replaced, an input never.
        check_output(invalid_path(output), True, *inputs)
