"""``meshdeform quality``: quality report of a grid."""

from __future__ import annotations

import time as clock
from pathlib import Path

import click

from meshdeform_core.memory import passing

from ..exit_codes import EXIT_INVALID
from ..options import (
    PATH,
    CaseInput,
    GridInput,
    force_option,
    grid_options,
    json_option,
    judged_case_options,
    memory_option,
    quiet_option,
    report_option,
    threads_option,
)
from ..outputs import check_reports, keep_inputs
from ..process.messages import Warnings
from ..process.progress import ProgressBar
from ..room import limit_of, make_room, temporary_folder

# Memory in units of the coordinates: these, the verdict, totals, and buffers of reading.
_ARRAYS = 2.5


@click.command("quality")
@grid_options
@click.option("--reference", type=PATH, help="The original grid: judge GRID against it.")
@judged_case_options
@report_option
@threads_option
@memory_option
@force_option
@json_option
@quiet_option
def command(
    source: GridInput, reference: Path | None, case: CaseInput, reports: tuple[Path, ...],
    max_memory: str | None, force: bool, as_json: bool, quiet: bool,
) -> int:  # fmt: skip
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
    check_reports(reports, force, reference, *source.files, *case.files)

    from meshdeform_core.mending import judge_grid
    from meshdeform_formats import read_grid
    from meshdeform_formats.report.records import quality_report

    from ..reporting import Delivery, deliver

    what = case.read()
    for path in reports:
        keep_inputs(path, *what.files)
    sources = [source, *([GridInput(reference)] if reference else [])]
    make_room(limit_of(max_memory), "judging", passing(_ARRAYS), sources, temporary_folder())
    with ProgressBar(not quiet) as progress:
        grid = source.read(what.boundary_file)
        # Boundaries that the file of the original lacks are those of the deformed grid.
        original = None if reference is None else read_grid(reference).with_patches_of(grid)
        progress("quality", 0, 0)
        assessment, notes = judge_grid(grid, original or grid, what.case)
        report = quality_report(grid, assessment, notes, str(reference) if reference else None, original)
    Warnings().tell(report["warnings"])
    files = [*source.roles, ("reference", reference), ("case", case.file)]
    # With --json the text would be redundant.
    deliver(report, reports, as_json, quiet or as_json, Delivery(start, files))
    return 0 if report["valid"] else EXIT_INVALID
