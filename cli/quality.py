"""``meshdeform quality``: how good is a grid?"""

from __future__ import annotations

import json
from pathlib import Path

import click

from meshdeform_core.errors import GridError

from .main import EXIT_INVALID
from .options import (
    PATH,
    boundary_file_option,
    case_options,
    check_output,
    force_option,
    grid_argument,
    json_option,
    quiet_option,
    threads_option,
)  # fmt: skip


@click.command("quality")
@grid_argument
@click.option("--reference", type=PATH, help="The original grid: judge GRID against it.")
@case_options
@click.option("--report", "reports", type=PATH, multiple=True, help="Report, .json .txt or .html (repeatable).")
@boundary_file_option
@threads_option
@force_option
@json_option
@quiet_option
def command(
    grid: Path, reference: Path | None, case_file: Path | None, displacement: Path | None, method: str | None,
    overrides: tuple[str, ...], reports: tuple[Path, ...], boundary_file: Path | None, threads: int | None,
    force: bool, as_json: bool, quiet: bool,
) -> int:  # fmt: skip
    """Judge GRID, alone or against its original.

    \b
    Examples:
      meshdeform quality deformed.cgns --reference original.cgns
      meshdeform quality deformed.cgns --reference original.cgns -c case.toml --report quality.html
      meshdeform quality grid.xyz --json

    With --reference a cell is invalid if a corner Jacobian that was positive became zero or negative (exit code 3).
    Alone, cells with such corners are counted as inherited. A case file (-c) tells where the moving walls are.
    """
    for path in reports:
        check_output(path, force, grid, reference, case_file)
    from meshdeform_formats.report import write_report
    from meshdeform_formats.report_text import as_text

    from .work import use_threads

    use_threads(threads)
    report = judge(grid, reference, case_file, overrides, boundary_file)
    for path in reports:
        write_report(report, path)
    if not quiet:
        click.echo(json.dumps(report, indent=2) if as_json else as_text(report), nl=as_json)
    return 0 if report["valid"] else EXIT_INVALID


def judge(
    path: Path, reference: Path | None, case_file: Path | None, overrides: tuple[str, ...], boundary_file: Path | None
) -> dict:
    """The quality report of the grid at ``path`` against ``reference``, or on its own."""
    from meshdeform_core.boundary import classify
    from meshdeform_core.quality import assess
    from meshdeform_core.topology import find_topology
    from meshdeform_formats.case import read_case
    from meshdeform_formats.grids import read_grid_with_boundaries
    from meshdeform_formats.report import quality_report

    case = read_case(case_file, overrides)
    original = read_grid_with_boundaries(reference or path, boundary_file or case.boundary_file)
    grid = read_grid_with_boundaries(path, None) if reference else original
    if grid.shapes != original.shapes:
        raise GridError(
            f"{path} has blocks {list(grid.shapes)}, its reference {reference} has {list(original.shapes)}; "
            f"expected the same blocks in the same order"
        )
    topology = find_topology(original, case.case.tolerance)
    boundary = None
    notes = (*original.notes, *(grid.notes if reference else ()))
    if case.case.boundaries:
        topology, boundary = classify(original, topology, case.case.boundaries, case.case.constants)
        notes += boundary.notes
    after = grid.points if reference else original.points
    return quality_report(grid, assess(original, after, topology, boundary), notes)
