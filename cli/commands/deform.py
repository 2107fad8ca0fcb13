"""``meshdeform deform``: the main job."""

from __future__ import annotations

import dataclasses
import time as clock
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ..checks import check_order, check_reports, check_target, too_large
from ..options import OUTPUT, CaseInput, GridInput, Imposed, RunInput, grid_options, packed
from ..process.progress import ProgressBar

if TYPE_CHECKING:
    from .. import work


@click.command("deform")
@grid_options
@click.option("-o", "--output", type=OUTPUT, help="Deformed grid; the suffix selects the format.")
@packed(CaseInput, "case")
@packed(Imposed, "imposed")
@packed(RunInput, "run")
def command(source: GridInput, output: Path | None, case: CaseInput, imposed: Imposed, run: RunInput) -> int:
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
    if case.empty:
        raise click.UsageError(
            "Nothing to do: give a case file (-c) or a displacement table (-d). To create a case file with every "
            f"boundary of the grid: meshdeform init {source.path} -o case.toml"
        )
    check_order(source, case)
    check_target(output, run, *source.files, *case.files)
    check_reports(run.reports, run.force, output, *source.files, *case.files)

    from .. import work

    if output is None or run.dry_run:
        return work.in_parts(lambda: _dry_run(source, case, output, imposed, run), run.verbose)

    def deform() -> int:
        with ProgressBar(not run.quiet) as progress:
            job = _load_inputs(source, case, output, imposed, run)
            report, illustrate = work.run(job, output, imposed, run, progress)
        files = [*source.roles, *case.roles(job.case), ("output", Path(report["output"]))]
        return work.conclude(report, run, start, files, illustrate, job.ranks)

    return work.in_parts(deform, run.verbose)


def _dry_run(source: GridInput, case: CaseInput, output: Path | None, imposed: Imposed, run: RunInput) -> int:
    """Print what the run would do and take; returns the exit code."""
    from meshdeform_core.deform import set_up

    from .. import work
    from ..dry_run import Outputs, plan, plan_by_sizes

    doing = work.work_of(case.read(), run, output.suffix if output else "")
    if layout := too_large(run.memory, doing, source):
        outputs = Outputs(output, run.variant_options.get("precision", layout.precision))
        return work.print_plan(plan_by_sizes(layout, doing, outputs, run.memory), False, run)
    with ProgressBar(not run.quiet):
        job = _load_inputs(source, case, output, imposed, run)
        setup = set_up(job.grid, job.case.case, memory=job.memory)
        outputs, missing = Outputs(output, job.grid.precision), ""
        if output is not None:
            variant, missing = work.variant_and_shortage(job.grid, output, run)
            outputs = Outputs(output, variant.precision)
        planned = plan(setup, [imposed.time], imposed.steps, outputs, missing, job.demand, run.memory)
    return work.print_plan(*planned, run)


def _load_inputs(source: GridInput, case: CaseInput, output: Path | None, imposed: Imposed, run: RunInput) -> work.Job:
    """The case and the grid; no output may replace a file that they name, or anything but an earlier invalid grid."""
    from meshdeform_formats.files import invalid_path

    from .. import work

    outputs = [output, *([] if output is None or run.allow_invalid else [invalid_path(output)]), *run.reports]
    workplace = None if run.dry_run or output is None else output.parent
    named = [path for path in outputs if path is not None]
    job = work.load(source, case, run, named, output.suffix if output else "", workplace)
    work.require_room_for_invalid(output, job.grid, run)
    return dataclasses.replace(job, case=work.timed(job.case, imposed.at_time))
