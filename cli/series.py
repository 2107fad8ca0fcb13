"""``meshdeform series``: a motion over time."""

from __future__ import annotations

import dataclasses
import time as clock
from pathlib import Path

import click

from meshdeform_core.numerics.parallel import current_ranks

from .deform import parse_steps
from .machine import use_threads
from .main import EXIT_INVALID
from .options import (
    PATH,
    CaseInput,
    GridInput,
    case_options,
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


@click.command("series")
@grid_options
@click.option("-o", "--output", type=PATH, help="Folder for the levels; made if missing.")
@case_options
@click.option(
    "--times", metavar="START:STOP:STEP",
    help="Time levels, also a,b,c; by default those of the case's sequence of displacement files.",
)  # fmt: skip
@click.option(
    "--from", "origin", type=click.Choice(("reference", "last")), default="reference", show_default=True,
    help="Make each level from the undeformed grid, or from the level before (marching).",
)  # fmt: skip
@click.option("--steps", default="1", metavar="N|auto", help="Impose each level in N steps, or as many as needed.")
@click.option(
    "--velocity", type=click.Choice(("none", "first", "second")), default="none", show_default=True,
    help="Write the grid velocity, by backward differences of this order (VTK and CGNS).",
)  # fmt: skip
@click.option("--suffix", help="Format of the levels, by suffix; that of GRID by default.")
@click.option("--single-file", is_flag=True, help="All levels in one CGNS file.")
@click.option("--resume", is_flag=True, help="Go on where an interrupted run of the same series stopped.")
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
    source: GridInput, output: Path | None, case: CaseInput, times: str | None, origin: str, steps: str, velocity: str,
    suffix: str | None, single_file: bool, resume: bool, reports: tuple[Path, ...], threads: int | None,
    max_memory: str | None, variant: tuple[str, ...], dry_run: bool, force: bool, allow_invalid: bool, quiet: bool,
    verbose: bool,
) -> int:  # fmt: skip
    """Deform GRID at every time level and write one grid per level, with an index for ParaView.

    \b
    Examples:
      meshdeform series wing.cgns -c flutter.toml --times 0:0.5:0.01 -o flutter
      meshdeform series grid.xyz -c case.toml --times 0:1:0.1 -o out --suffix .vtm --velocity second
      meshdeform series wing.cgns -c flutter.toml --times 0:0.5:0.01 -o flutter --single-file --report flutter.json
      meshdeform series wing.cgns -c flutter.toml --times 0:0.5:0.01 -o flutter --resume
      meshdeform series wing.cgns -d 'surface_*.csv' --times 0:0.5:0.01 -o flutter

    What depends on the undeformed grid only is computed once. Every file is whole whenever the run is stopped;
    OUTPUT/series.json keeps what --resume needs. Levels with invalid cells are written too (exit code 3).
    """
    start = clock.perf_counter()
    use_threads(threads)
    if output is None:
        raise click.UsageError("Missing option '-o' / '--output'.")
    if case.empty:
        raise click.UsageError("Nothing to do: give a case file (-c) or displacement files (-d).")
    if case.displacement and not times:
        raise click.UsageError("Displacement files (-d 'surface_*.csv') need their times: --times START:STOP:STEP.")
    if resume and force:
        raise click.UsageError("--resume continues a series, --force begins it anew; give one of them.")
    check_reports(reports, force or resume, *source.files, *case.files)
    count, options, limit = parse_steps(steps), parse_pairs(variant, "--variant"), parse_memory(max_memory)

    from . import series_run, work

    wanted = series_run.Wanted(output, times, origin, velocity, count, suffix, single_file, options)
    job = work.load(source, dataclasses.replace(case, times=times), limit, reports)
    run = series_run.prepare(job, source, wanted)
    if dry_run:
        click.echo(series_run.describe(run), nl=False)
        return 0
    run.manifest = current_ranks().on_first(lambda: series_run.open_manifest(run, resume, force))
    with ProgressBar(not quiet) as progress:
        report = series_run.carry_out(run, progress, start)
    for path in reports:
        work.write_report(report, path)
    work.tell(report, quiet, verbose)
    return 0 if report["valid"] or allow_invalid else EXIT_INVALID
