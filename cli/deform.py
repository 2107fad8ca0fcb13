"""``meshdeform deform``: the main job."""

from __future__ import annotations

import time as clock
from pathlib import Path

import click

from meshdeform_core.errors import CaseError

from .machine import use_threads
from .main import EXIT_INVALID
from .options import (
    PATH,
    CaseInput,
    FiniteNumber,
    GridInput,
    case_options,
    check_output,
    check_reports,
    force_option,
    grid_options,
    memory_option,
    parse_memory,
    parse_pairs,
    quiet_option,
    report_option,
    threads_option,
    variant_option,
    verbose_option,
)  # fmt: skip
from .progress import ProgressBar


@click.command("deform")
@grid_options
@click.option("-o", "--output", type=PATH, help="Deformed grid; the suffix chooses the format.")
@case_options
@click.option("--steps", default="1", metavar="N|auto", help="Impose the motion in N steps, or as many as needed.")
@click.option(
    "--time", "at_time", type=FiniteNumber(), default=0.0, metavar="T", help="Evaluate the motion at this time."
)
@report_option
@threads_option
@memory_option
@variant_option
@click.option("--dry-run", is_flag=True, help="Show what would be done; write nothing.")
@force_option
@click.option("--allow-invalid", is_flag=True, help="Exit 0 even if cells became invalid.")
@quiet_option
@verbose_option
def command(
    source: GridInput, output: Path | None, case: CaseInput, steps: str, at_time: float, reports: tuple[Path, ...],
    threads: int | None, max_memory: str | None, variant: tuple[str, ...], dry_run: bool, force: bool,
    allow_invalid: bool, quiet: bool, verbose: bool,
) -> int:  # fmt: skip
    """Deform GRID, judge the result and write it.

    \b
    Examples:
      meshdeform deform wing.cgns -c wing.toml -o bent.cgns
      meshdeform deform grid.xyz -d displacement.csv -o deformed.xyz -m idw-tfi --report report.json
      meshdeform deform grid.cgns -c case.toml --steps auto -s method.idw.alpha=0.3 -o deformed.cgns
      meshdeform deform grid.cgns -c case.toml --dry-run

    Nodes on the outside that no boundary entry selects stay fixed. The deformed grid is written even when cells became
    invalid (exit code 3); the report lists them.
    """
    start = clock.perf_counter()
    use_threads(threads)
    if output is None and not dry_run:
        raise click.UsageError("Missing option '-o' / '--output' (or --dry-run).")
    if case.empty:
        raise click.UsageError("Nothing to do: give a case file (-c) or a displacement table (-d).")
    if not dry_run and output is not None:
        _check_target(output, force, *source.files, *case.files)
    check_reports(reports, force, output, *source.files, *case.files)
    count, options, limit = parse_steps(steps), parse_pairs(variant, "--variant"), parse_memory(max_memory)

    from . import work

    job = work.load(source, case, limit, [path for path in (output, *reports) if path is not None])
    if dry_run or output is None:
        click.echo(work.describe(job, output, count, at_time, options), nl=False)
        return 0
    with ProgressBar(not quiet) as progress:
        report = work.run(job, output, count, at_time, options, progress, start)
    for path in reports:
        work.write_report(report, path)
    work.tell(report, quiet, verbose)
    return 0 if report["valid"] or allow_invalid else EXIT_INVALID


def _check_target(output: Path, force: bool, *inputs: Path | None) -> None:
    from meshdeform_formats.grids import format_of

    format_of(output)
    check_output(output, force, *inputs)


def parse_steps(text: str) -> int | str:
    """``auto`` or a positive whole number."""
    if text == "auto":
        return text
    if not text.isascii() or not text.isdigit() or int(text) == 0:
        raise CaseError(f'--steps {text!r}: expected a whole number >= 1 or "auto"')
    return int(text)
