"""``meshdeform quality``: quality report of a grid."""

from __future__ import annotations

import dataclasses
import time as clock
from pathlib import Path

import click

from meshdeform_core.memory import passing

from ..checks import check_reports, keep_inputs, make_room, temporary_folder
from ..exit_codes import EXIT_INVALID
from ..options import PATH, CaseInput, GridInput, RunInput, grid_options, packed
from ..process.progress import ProgressBar

# Memory in units of the coordinates: these, the verdict, totals, and buffers of reading.
_ARRAYS = 2.5


@click.command("quality")
@grid_options
@click.option("--reference", type=PATH, help="The original grid: judge GRID against it.")
@packed(CaseInput, "case", "file", "displacement", "match", "tolerance", "overrides", "min_jacobian")
@packed(RunInput, "run", "reports", "as_json", "threads", "max_memory", "force", "quiet")
def command(source: GridInput, reference: Path | None, case: CaseInput, run: RunInput) -> int:
    """Judge GRID, by itself or against its original.

    \b
    Examples:
      meshdeform quality deformed.cgns --reference original.cgns
      meshdeform quality deformed.cgns --reference original.cgns -c case.toml --report quality.html
      meshdeform quality grid.xyz --json

    With --reference a cell is invalid if a corner Jacobian that was positive became zero or negative (exit code 3).
    Without it, cells with such corners count as inherited. A case file (-c) defines the moving walls.
    """
    start = clock.perf_counter()
    check_reports(run.reports, run.force, reference, *source.files, *case.files)

    from meshdeform_core.mending import judge_grid
    from meshdeform_formats import read_grid
    from meshdeform_formats.report.records import quality_report

    from ..work import deliver

    what = case.read()
    for path in run.reports:
        keep_inputs(path, *what.files)
    sources = [source, *([GridInput(reference)] if reference else [])]
    make_room(run.limit, "judging", passing(_ARRAYS), sources, temporary_folder())
    with ProgressBar(not run.quiet) as progress:
        grid = source.read(what.boundary_file)
        # Boundaries that the file of the original lacks are those of the deformed grid.
        original = None if reference is None else read_grid(reference).with_patches_of(grid)
        progress("quality", 0, 0)
        assessment, notes = judge_grid(grid, original or grid, what.case)
        report = quality_report(grid, assessment, notes, str(reference) if reference else None, original)
    run.warnings.tell(report["warnings"])
    files = [*source.roles, ("reference", reference), ("case", case.file)]
    # With --json the text would be redundant.
    deliver(report, dataclasses.replace(run, quiet=run.quiet or run.as_json), start, files)
    return 0 if report["valid"] else EXIT_INVALID
