"""Commands that move grids: ``deform``, ``series`` and ``repair``."""

from __future__ import annotations

import dataclasses
import time as clock
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from meshdeform_core.memory import SWEPT_BYTES, VELOCITY_BYTES

from .checks import check_order, check_reports, check_target, keep_boundaries, make_room, too_large
from .options import OUTPUT, PATH, CaseInput, GridInput, RunInput, SeriesInput, grid_options, packed
from .process import EXIT_INVALID, ProgressBar, tell

if TYPE_CHECKING:
    from meshdeform_core.memory import MemoryLimit
    from meshdeform_formats.case import CaseFile


@click.command("deform")
@grid_options
@click.option("-o", "--output", type=OUTPUT, help="Deformed grid; the suffix selects the format.")
@packed(CaseInput, "case")
@packed(RunInput, "run")
def deform_command(source: GridInput, output: Path | None, case: CaseInput, run: RunInput) -> int:
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
    # The case first: it is small and most often wrong.
    what = case.read()
    files = [*source.files, *case.files(what)]
    check_target(output, run, files)
    check_reports(run.reports, run.force, [*files, ("output", output)])

    from . import work

    doing = work.work_of(what, run, output.suffix if output else "")

    def load(limit: MemoryLimit, workplace: Path | None = None) -> work.Job:
        job = work.load(source, case, what, doing, limit, workplace)
        work.require_room_for_invalid(output, job.grid, run)
        return dataclasses.replace(job, case=work.timed(job.case, case.at_time))

    def foretell(limit: MemoryLimit) -> int:
        from meshdeform_core.deform import set_up

        from .dry_run import Outputs, plan, plan_by_sizes

        if layout := too_large(limit, doing, source):
            outputs = Outputs(output, run.variant_options.get("precision", layout.precision))
            return work.print_plan(plan_by_sizes(layout, doing, outputs, limit), False, run)
        with ProgressBar(not run.quiet):
            job = load(limit)
            setup = set_up(job.grid, job.case.case, memory=job.memory)
            outputs, missing = Outputs(output, job.grid.precision), ""
            if output is not None:
                variant, missing = work.variant_and_shortage(job.grid, output, run)
                outputs = Outputs(output, variant.precision)
            planned = plan(setup, [case.at_time or 0.0], case.steps, outputs, missing, job.demand, limit)
        return work.print_plan(*planned, run)

    def deform(limit: MemoryLimit) -> int:
        assert output is not None
        with ProgressBar(not run.quiet) as progress:
            job = load(limit, output.parent)
            write_boundaries = keep_boundaries(job.grid, output, run.force, files)
            report, illustrate = work.run(job, output, case, run, progress)
            job.grid.nodes.ranks.on_first(write_boundaries)
        written = [*files, ("output", Path(report["output"]))]
        return work.conclude(report, run, start, written, job.grid.nodes.ranks, illustrate)

    return work.in_parts(foretell if run.dry_run else deform, run)


@click.command("series")
@grid_options
@packed(SeriesInput, "wanted")
@packed(CaseInput, "case", without="at_time")
@packed(RunInput, "run")
def series_command(source: GridInput, case: CaseInput, wanted: SeriesInput, run: RunInput) -> int:
    """Deform GRID at every time level and write one grid per level, with an index for ParaView.

    \b
    Examples:
      meshdeform series wing.cgns -c flutter.toml --times 0:0.5:0.01 -o flutter
      meshdeform series grid.xyz -c case.toml --times 0:1:0.1 -o out --suffix .vtm --velocity second
      meshdeform series wing.cgns -c flutter.toml --times 0:0.5:0.01 -o flutter --report flutter.json
      meshdeform series wing.cgns -c flutter.toml --times 0:0.5:0.01 -o flutter --resume
      meshdeform series wing.cgns -d 'surface_*.csv' --times 0:0.5:0.01 -o flutter

    Everything that depends only on the undeformed grid is computed once. Files are complete whenever the run is
    stopped; OUTPUT/series.json holds the state for --resume. Levels with invalid cells are written with .invalid before
    the suffix (exit code 3).
    """
    start = clock.perf_counter()
    if case.empty:
        raise click.UsageError("Nothing to do: give a case file (-c) or displacement files (-d).")
    check_order(source, case)
    if case.displacement and not wanted.times:
        raise click.UsageError("Displacement files (-d 'surface_*.csv') need their times: --times START:STOP:STEP.")
    if wanted.resume and run.force:
        raise click.UsageError("--resume continues a series, --force restarts it; give one of them.")
    case = dataclasses.replace(case, times=wanted.times)
    what = case.read()
    files = [*source.files, *case.files(what)]
    check_reports(run.reports, run.force or wanted.resume, files)

    from . import series_run, work

    beside = VELOCITY_BYTES * (wanted.velocity != "none") + SWEPT_BYTES * (wanted.velocity == "swept")
    doing, begun = work.work_of(what, run, wanted.suffix or "", beside), False

    def load(limit: MemoryLimit, workplace: Path | None = None) -> series_run.Run:
        job = work.load(source, case, what, doing, limit, workplace)
        plan = series_run.prepare(job, source, case, wanted, run)
        run.warn(plan.setup.warnings)
        return plan

    def foretell(limit: MemoryLimit) -> int:
        from .dry_run import Outputs, plan, plan_by_sizes

        if layout := too_large(limit, doing, source):
            output = wanted.output / series_run.name_of(source.path, wanted, layout.format)
            precision = run.variant_options.get("precision", layout.precision)
            outputs = Outputs(output, precision, len(series_run.times_of(what, wanted)), wanted.velocity)
            return work.print_plan(plan_by_sizes(layout, doing, outputs, limit), False, run)
        with ProgressBar(not run.quiet):
            ready = load(limit)
            times, levels = ready.schedule.times, ready.files
            outputs = Outputs(levels.path(0), levels.variant.precision, len(times), wanted.velocity)
            planned = plan(ready.setup, times, case.steps, outputs, ready.shortage(0), ready.job.demand, limit)
            paths = f"{levels.path(0)} ... {levels.path(len(times) - 1)}"
            text = f"series    {len(times)} levels from t = {times[0]:g} to {times[-1]:g}: {paths}\n"
        return work.print_plan(*planned, run, text)

    def deform(limit: MemoryLimit) -> int:
        nonlocal begun
        with ProgressBar(not run.quiet) as progress:
            plan = load(limit, wanted.output)
            # The first rank alone continues what all of them have begun.
            begin = partial(series_run.open_manifest, plan, wanted.resume or begun, run.force and not begun)
            plan.manifest = plan.job.grid.nodes.ranks.on_first(begin)
            plan.files.recall(plan.manifest.levels)
            grid, force = plan.job.grid, wanted.resume or begun or run.force
            grid.nodes.ranks.on_first(keep_boundaries(grid, plan.files.plain, force, files))
            begun = True
            report = series_run.carry_out(plan, progress)
        return work.conclude(report, run, start, [*files, ("index", plan.files.view)], plan.job.grid.nodes.ranks)

    return work.in_parts(foretell if run.dry_run else deform, run)


@click.command("repair")
@grid_options
@click.option("--reference", type=PATH, required=True, help="The original grid, whose cells are sound.")
@click.option("-o", "--output", type=OUTPUT, help="Repaired grid; the suffix selects the format.")
@packed(CaseInput, "case", "file", "min_jacobian")
@click.option("--polish", is_flag=True, help="Improve the worst cells of a valid grid, too.")
@packed(RunInput, "run")
def repair_command(
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
    what = dataclasses.replace(case, repair="polish" if polish else "off" if run.dry_run else "auto").read()
    files = [*source.files, ("reference", reference), *case.files(what)]
    check_target(output, run, files)
    check_reports(run.reports, run.force, [*files, ("output", output)])

    from .work import deliver

    with ProgressBar(not run.quiet) as progress:
        report = _repaired(source, reference, output, what, run, progress)
    run.warn(report["warnings"])
    deliver(report, run, start, [*files, ("output", output)])
    if run.dry_run or not report["valid"]:
        where = "; dry run, nothing written" if run.dry_run else f". The grid is in {report['output']}"
        tell(f"{report['quality']['after']['invalid_cells']} cells are invalid{where}")
    return 0 if report["valid"] or run.allow_invalid or run.dry_run else EXIT_INVALID


def _repaired(
    source: GridInput, reference: Path, output: Path | None, what: CaseFile, run: RunInput, progress: ProgressBar
) -> dict[str, Any]:
    """Repair and write; returns the report."""
    from meshdeform_core.memory import REPAIRING, Demand, peak_memory
    from meshdeform_core.mending import mend
    from meshdeform_core.quality.fields import CellFields
    from meshdeform_formats.grids import complete_for_export, read_grid
    from meshdeform_formats.inputs import existing
    from meshdeform_formats.report.records import mended_report

    from .work import require_room_for_invalid, variant_and_shortage, write_judged

    place = existing(output.absolute().parent) if output else None
    make_room(run.memory(), "repairing", REPAIRING, [source, GridInput(reference)], place)
    start = clock.perf_counter()
    grid = source.read(what.boundary_file)
    # Boundaries are selected on the reference.
    original = read_grid(reference).with_patches_of(grid)
    seconds, missing = {"read": clock.perf_counter() - start}, ""
    require_room_for_invalid(output, grid, run)
    precision, whole = None, grid
    if output:
        chosen, missing = variant_and_shortage(grid, output, run)
        precision, whole = chosen.precision, complete_for_export(grid, output, run.variant_options)
        files = [*source.files, ("reference", reference), ("boundaries", what.boundary_file)]
        write_boundaries = keep_boundaries(grid, output, run.force or run.dry_run, files)
    start = clock.perf_counter()
    memory = Demand.of("repairing", REPAIRING, grid, original).left_of(run.memory())
    mended = mend(whole, original, what.case, precision, memory, progress)
    seconds["repair"] = clock.perf_counter() - start
    target = None
    if output and not run.dry_run:
        start = clock.perf_counter()

        def cells() -> CellFields:
            return CellFields(mended.grid, mended.topology, mended.original)

        target = str(write_judged(mended.grid, mended.assessment.valid, output, run, cells))
        write_boundaries()
        seconds["write"] = clock.perf_counter() - start
    report = {**mended_report(mended, str(reference), seconds, peak_memory()), "output": target}
    report["warnings"] += [missing] if missing else []
    return report
