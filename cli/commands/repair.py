"""``meshdeform repair``: a grid that another program deformed."""

from __future__ import annotations

import functools
import time as clock
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..exit_codes import EXIT_INVALID
from ..options import OUTPUT, PATH, CaseInput, GridInput, RunInput, grid_options, run_options
from ..outputs import check_reports, keep_inputs
from ..process.machine import use_threads
from ..process.messages import tell
from ..process.progress import ProgressBar, writing
from ..room import make_room
from .deform import check_target

if TYPE_CHECKING:
    from meshdeform_core.grid import Grid
    from meshdeform_core.mending import Mended


@click.command("repair")
@grid_options
@click.option("--reference", type=PATH, required=True, help="The original grid, whose cells are sound.")
@click.option("-o", "--output", type=OUTPUT, help="Repaired grid; the suffix selects the format.")
@click.option("-c", "--case", "case_file", type=PATH, help="Case file: which faces move, slide or repeat.")
@click.option("--polish", is_flag=True, help="Improve the worst cells of a valid grid, too.")
@click.option(
    "--min-jacobian", type=float, metavar="R", help="Count a cell as invalid below R times its undeformed Jacobian."
)
@run_options
def command(
    source: GridInput, reference: Path, output: Path | None, case_file: Path | None, polish: bool,
    min_jacobian: float | None, run: RunInput,
) -> int:  # fmt: skip
    """Make GRID, which another program deformed, valid; its boundary stays in place.

    \b
    Examples:
      meshdeform repair bent.cgns --reference wing.cgns -o repaired.cgns
      meshdeform repair bent.xyz --reference wing.xyz -c case.toml -o repaired.xyz --report repair.json

    GRID and the reference have the same blocks. Cells that are sound in the reference but not in GRID are repaired by
    moving the nodes around them. If there are many, or if that fails, the reference is deformed anew with the boundary
    of GRID. Nodes on outside faces stay in place; with a case file, those on slip and symmetry boundaries slide, and
    those on periodic boundaries move alike. A grid that is still invalid is written next to OUT, with .invalid before
    the suffix (exit code 3).
    """
    start = clock.perf_counter()
    use_threads(run.threads)
    if output is None and not run.dry_run:
        raise click.UsageError("Missing option '-o' / '--output' (or --dry-run).")
    inputs = (reference, case_file, *source.files)
    if output is not None and not run.dry_run:
        check_target(output, run, *inputs)
    check_reports(run.reports, run.force, output, *inputs)
    settings = () if min_jacobian is None else (f"repair.min_jacobian={min_jacobian!r}",)
    mode = "polish" if polish else "off" if run.dry_run else "auto"
    case = CaseInput(case_file, None, None, (*settings, f'repair.mode="{mode}"'))
    from ..reporting import Delivery, deliver

    with ProgressBar(not run.quiet) as progress:
        report = repaired(source, reference, output, case, run, progress)
    run.warnings.tell(report["warnings"])
    files = [*source.roles, ("reference", reference), ("case", case_file), ("output", output)]
    deliver(report, run.reports, run.as_json, run.quiet, Delivery(start, files), run.verbose)
    if run.dry_run or not report["valid"]:
        where = "; dry run, nothing written" if run.dry_run else f". The grid is in {report['output']}"
        tell(f"{report['quality']['after']['invalid_cells']} cells are invalid{where}")
    return 0 if report["valid"] or run.allow_invalid or run.dry_run else EXIT_INVALID


def repaired(
    source: GridInput, reference: Path, output: Path | None, case: CaseInput, run: RunInput, progress: ProgressBar
) -> dict[str, Any]:
    """Repair and write; returns the report."""
    from meshdeform_core.memory import Demand, peak_memory
    from meshdeform_core.mending import mend
    from meshdeform_formats.files import invalid_path
    from meshdeform_formats.grids import complete_for_export, read_grid, require_earlier_grid, variant_of
    from meshdeform_formats.placing import existing, require_space, shortage
    from meshdeform_formats.report import mended_report

    what = case.read()
    for path in (*run.reports, *([output] if output else [])):
        keep_inputs(path, *what.files)
    sources = [source, GridInput(reference, None, ())]
    make_room(run.memory, "repairing", sources, existing(output.absolute().parent) if output else None)
    start = clock.perf_counter()
    grid = source.read(what.boundary_file)
    # Boundaries are selected on the reference.
    original = read_grid(reference).with_patches_of(grid)
    seconds = {"read": clock.perf_counter() - start}
    if output is not None and not (run.force or run.dry_run or run.allow_invalid):
        require_earlier_grid(invalid_path(output), grid)
    options = run.variant_options
    chosen = variant_of(grid, output, options) if output else None
    missing = shortage(grid, output, chosen) if output and chosen and run.dry_run else ""
    if output and chosen and not run.dry_run:
        require_space(grid, output, chosen)
    precision = chosen.precision if chosen else None
    memory = Demand.of("repairing", grid, original).left_of(run.memory)
    start = clock.perf_counter()
    whole = complete_for_export(grid, output) if output else grid
    mended = mend(whole, original, what.case, precision, memory, progress)
    seconds["repair"] = clock.perf_counter() - start
    target = None
    if output is not None and not run.dry_run:
        start = clock.perf_counter()
        target = _write(mended, output, options, run)
        seconds["write"] = clock.perf_counter() - start
    name = None if target is None else str(target)
    report = {**mended_report(mended, str(reference), seconds, peak_memory()), "output": name}
    report["warnings"] += [missing] if missing else []
    return report


def _write(mended: Mended, output: Path, variant: dict[str, str], run: RunInput) -> Path:
    """Write the grid with the requested fields; returns the path of the file."""
    from meshdeform_core.quality.fields import CellFields
    from meshdeform_formats.fields import with_fields
    from meshdeform_formats.files import invalid_path
    from meshdeform_formats.grids import write_grid

    target = output if mended.assessment.valid or run.allow_invalid else invalid_path(output)
    cells = functools.partial(CellFields, mended.grid, mended.topology, mended.original)
    grid: Grid = with_fields(cells(), run.fields) if run.fields else mended.grid
    with writing(grid.points.nbytes):
        write_grid(grid, target, variant)
    return target
