"""``meshdeform repair``: a grid that another program deformed."""

from __future__ import annotations

import dataclasses
import time as clock
from pathlib import Path
from typing import Any

import click

from ..checks import check_reports, check_target, keep_inputs, make_room
from ..exit_codes import EXIT_INVALID
from ..options import OUTPUT, PATH, CaseInput, GridInput, RunInput, grid_options, packed
from ..process.messages import tell
from ..process.progress import ProgressBar


@click.command("repair")
@grid_options
@click.option("--reference", type=PATH, required=True, help="The original grid, whose cells are sound.")
@click.option("-o", "--output", type=OUTPUT, help="Repaired grid; the suffix selects the format.")
@packed(CaseInput, "case", "file", "min_jacobian")
@click.option("--polish", is_flag=True, help="Improve the worst cells of a valid grid, too.")
@packed(RunInput, "run")
def command(
    source: GridInput, reference: Path, output: Path | None, case: CaseInput, polish: bool, run: RunInput
) -> int:
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
    inputs = (reference, case.file, *source.files)
    check_target(output, run, *inputs)
    check_reports(run.reports, run.force, output, *inputs)
    case = dataclasses.replace(case, repair="polish" if polish else "off" if run.dry_run else "auto")

    from ..work import deliver

    with ProgressBar(not run.quiet) as progress:
        report = repaired(source, reference, output, case, run, progress)
    run.warnings.tell(report["warnings"])
    files = [*source.roles, ("reference", reference), ("case", case.file), ("output", output)]
    deliver(report, run, start, files)
    if run.dry_run or not report["valid"]:
        where = "; dry run, nothing written" if run.dry_run else f". The grid is in {report['output']}"
        tell(f"{report['quality']['after']['invalid_cells']} cells are invalid{where}")
    return 0 if report["valid"] or run.allow_invalid or run.dry_run else EXIT_INVALID


def repaired(
    source: GridInput, reference: Path, output: Path | None, case: CaseInput, run: RunInput, progress: ProgressBar
) -> dict[str, Any]:
    """Repair and write; returns the report."""
    from meshdeform_core.memory import REPAIRING, Demand, peak_memory
    from meshdeform_core.mending import mend
    from meshdeform_core.quality.fields import CellFields
    from meshdeform_formats.grids import complete_for_export, read_grid
    from meshdeform_formats.placing import existing
    from meshdeform_formats.report.records import mended_report

    from ..work import require_room_for_invalid, variant_and_shortage, write_judged

    what = case.read()
    for path in (*run.reports, *([output] if output else [])):
        keep_inputs(path, *what.files)
    place = existing(output.absolute().parent) if output else None
    make_room(run.memory, "repairing", REPAIRING, [source, GridInput(reference)], place)
    start = clock.perf_counter()
    grid = source.read(what.boundary_file)
    # Boundaries are selected on the reference.
    original = read_grid(reference).with_patches_of(grid)
    seconds, missing = {"read": clock.perf_counter() - start}, ""
    require_room_for_invalid(output, grid, run)
    precision, whole = None, grid
    if output:
        chosen, missing = variant_and_shortage(grid, output, run)
        precision, whole = chosen.precision, complete_for_export(grid, output)
    start = clock.perf_counter()
    memory = Demand.of("repairing", REPAIRING, grid, original).left_of(run.memory)
    mended = mend(whole, original, what.case, precision, memory, progress)
    seconds["repair"] = clock.perf_counter() - start
    target = None
    if output and not run.dry_run:
        start = clock.perf_counter()

        def cells() -> CellFields:
            return CellFields(mended.grid, mended.topology, mended.original)

        target = str(write_judged(mended.grid, mended.assessment.valid, output, run, cells))
        seconds["write"] = clock.perf_counter() - start
    report = {**mended_report(mended, str(reference), seconds, peak_memory()), "output": target}
    report["warnings"] += [missing] if missing else []
    return report
