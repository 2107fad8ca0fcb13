"""From options to a run: inputs are read, a grid is deformed and written, its report delivered."""

from __future__ import annotations

import contextlib
import dataclasses
import time as clock
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click
import numpy as np

from meshdeform_core.boundary import Kind
from meshdeform_core.boundary.motions.motion import Follow
from meshdeform_core.boundary.tables import SurfaceData
from meshdeform_core.deform import Setup, deform
from meshdeform_core.errors import CaseError, FormatError
from meshdeform_core.grid import FileFormat, Grid
from meshdeform_core.grid.selection import with_components
from meshdeform_core.memory import Demand, MemoryLimit, Work, deforming, peak_memory
from meshdeform_core.methods import make_method
from meshdeform_core.parallel import ONE_PROCESS, Ranks, WholeGridNeeded, thread_count
from meshdeform_core.wording import counted
from meshdeform_formats.case import CaseFile
from meshdeform_formats.files import invalid_path
from meshdeform_formats.grids import FORMATS, complete_for_export, require_earlier_grid, variant_of, write_grid
from meshdeform_formats.inputs import digest, existing, existing_outputs, lack, least_bytes
from meshdeform_formats.report.records import Report, deformation_report, with_other
from meshdeform_formats.report.tables import Figure, Illustrate
from meshdeform_formats.report.write import as_json, as_text, run_part, write_report

from .checks import make_room
from .options import CaseInput, Files, GridInput, RunInput
from .process import EXIT_INVALID, ProgressBar, stage, tell

if TYPE_CHECKING:
    from meshdeform_core.quality.fields import CellFields

T = TypeVar("T")
STDOUT = Path("-")


@dataclass(frozen=True)
class Job:
    """A grid and the case to apply to it; ``demand`` is its memory, ``memory`` the limit left for the method."""

    grid: Grid
    case: CaseFile
    read_seconds: float
    demand: Demand
    memory: MemoryLimit


def work_of(what: CaseFile, run: RunInput, suffix: str, beside: float | None = None) -> Work:
    """What a run that writes files with a ``suffix`` does, for the model of its memory; ``beside`` as in
    :func:`.memory.deforming`."""
    unstructured = suffix.lower() in (*FORMATS["meshio"].suffixes, *FORMATS["openfoam"].suffixes)
    return deforming(what.case.method.name, bool(run.fields) or unstructured, beside)


def load(
    source: GridInput, case: CaseInput, what: CaseFile, work: Work, limit: MemoryLimit, workplace: Path | None = None
) -> Job:
    """Read the grid with the boundary information that the case, read from ``what``, names; in parts if several
    ranks share the ``limit`` of memory.

    If ``workplace`` is given, arrays of a grid larger than the memory are put into files in this folder.
    """
    ranks = limit.ranks
    if ranks.count > 1:
        # The options of the case and the contents of all files must not differ between ranks.
        files = [path for _, path in (*source.files, *case.files(what))]
        own = [(repr(dataclasses.replace(case, file=None, displacement=None)), "options of the case")]
        own += [(digest(path), str(path)) for path in files if path and path.is_file()]
        first, *others = ranks.gather([own])
        for number, other in enumerate(others, 1):
            for (mine, name), (its, its_name) in zip(first, other, strict=False):
                if mine != its:
                    raise CaseError(
                        f"rank {number} has other inputs than rank 0: {its_name} differs from {name}; expected the "
                        "same grid, case and tables on every rank"
                    )
    make_method(what.case.method)
    make_room(limit, "deforming", work, [source], workplace and existing(workplace.absolute()))
    start = clock.perf_counter()
    grid = with_components(source.read(what.boundary_file, ranks), what.case.components)
    seconds = clock.perf_counter() - start
    # Size of the data in the grid file other than coordinates, and of the tables of the case; with several ranks, the
    # most that one of them holds.
    steps = [step for spec in what.case.boundaries if spec.motion for step in spec.motion.steps]
    tables = [step.data for step in steps if isinstance(step, Follow)]
    arrays = [array for table in tables if isinstance(table, SurfaceData) for array in vars(table).values()]
    grids = [table for table in tables if isinstance(table, Grid)]
    arrays += [table.nodes.rows for table in grids]
    arrays += [field.own for each in (grid, *grids) for field in each.fields]
    size = sum(array.nbytes for array in arrays if isinstance(array, np.ndarray))
    demand = Demand.of("deforming", work, grid, data=max(ranks.gather([size])), ranks=ranks)
    return Job(grid, what, seconds, demand, demand.left_of(limit))


def in_parts(action: Callable[[MemoryLimit], T], run: RunInput) -> T:
    """Do it within a limit of memory, with grids in parts if several ranks share it; if that is not possible, on the
    first rank alone."""
    ranks: Ranks = click.get_current_context().find_root().obj.ranks
    if ranks.count > 1:
        try:
            return action(run.memory(ranks))
        except WholeGridNeeded as reason:
            if run.verbose:
                tell(f"the first rank alone holds the whole grid: {reason}")
    return ranks.on_first(lambda: action(run.memory()))


def timed(case: CaseFile, at_time: float | None) -> CaseFile:
    """The case, with a note if ``--time`` and motion do not agree."""
    if case.case.depends_on_time == (at_time is not None):
        return case
    if case.case.depends_on_time:
        note = "the motion depends on t and was evaluated at t = 0; choose another time with --time"
    else:
        note = f"the motion does not depend on t: --time {at_time:g} has no effect"
    return dataclasses.replace(case, case=dataclasses.replace(case.case, notes=(*case.case.notes, note)))


def print_plan(report: Report, impossible: bool, run: RunInput, more: str = "") -> int:
    """Print the result of a dry run, the report as JSON on stdout if requested, and the text; returns the exit code, 3
    if no valid grid exists (``impossible``)."""
    to_stdout = run.as_json or STDOUT in run.reports
    if to_stdout:
        click.echo(as_json(report), nl=False)
    if not (to_stdout and run.quiet):
        text = as_text({**report, "warnings": []})
        click.echo(f"{text}{more}dry run   nothing written", err=to_stdout)
    run.warn(report["warnings"])
    return EXIT_INVALID if impossible and not run.allow_invalid else 0


def variant_and_shortage(grid: Grid, output: Path, run: RunInput) -> tuple[FileFormat, str]:
    """How an output is written, and a message on the space that it lacks on the disk, which only a dry run goes on
    after; empty if it fits."""
    variant = variant_of(grid, output, run.variant_options)
    missing = lack(least_bytes(grid, output, variant), output, "the grid takes")
    if missing and not run.dry_run:
        raise FormatError(f"cannot write {output}: {missing}")
    return variant, missing


def require_room_for_invalid(output: Path | None, grid: Grid, run: RunInput) -> None:
    """Refuse to replace anything but the invalid grid of an earlier run by that of this run."""
    if output is not None and not (run.force or run.dry_run or run.allow_invalid):
        require_earlier_grid(invalid_path(output), grid)


def write_judged(grid: Grid, valid: bool, output: Path, run: RunInput, cells: Callable[[], CellFields]) -> Path:
    """Write a grid under its name, or beside it if it is invalid; returns the path.

    The invalid grid that an earlier run has left goes when the grid is valid.
    """
    beside = invalid_path(output)
    target = output if valid or run.allow_invalid else beside
    with stage("write"):
        dressed = grid
        if run.fields:
            from meshdeform_formats.fields import with_fields

            dressed = with_fields(cells(), run.fields)
        write_grid(dressed, target, run.variant_options)

    def remove_earlier() -> None:
        # Anything but the invalid grid of an earlier run stays.
        with contextlib.suppress(FormatError):
            if existing_outputs(beside) == [beside]:
                require_earlier_grid(beside, grid)
                beside.unlink()

    if valid:
        grid.nodes.ranks.on_first(remove_earlier)
    return target


def run(job: Job, output: Path, case: CaseInput, options: RunInput, progress: ProgressBar) -> tuple[Report, Illustrate]:
    """Deform and write; returns the report and a function that draws its pictures."""
    chosen, _ = variant_and_shortage(job.grid, output, options)
    result = deform(
        complete_for_export(job.grid, output, options.variant_options),
        job.case.case,
        time=case.at_time or 0.0,
        steps=case.steps,
        precision=chosen.precision,
        memory=job.memory,
        progress=progress,
        warn=options.warn,
    )
    options.warn(result.warnings)
    before = clock.perf_counter()
    target = write_judged(result.grid, result.valid, output, options, lambda: cells_of(result.setup, result.grid))
    seconds = {"read": job.read_seconds, "write": clock.perf_counter() - before}

    def illustrate() -> list[Figure]:
        from meshdeform_formats.report.page import deformation_figures

        return deformation_figures(result)

    peak = max(job.grid.nodes.ranks.gather([peak_memory()]))
    return deformation_report(result, seconds, peak) | {"output": str(target)}, illustrate


def cells_of(setup: Setup, after: Grid) -> CellFields:
    """The cells of a deformed grid for measuring against the original."""
    from meshdeform_core.quality.fields import CellFields

    moving = np.flatnonzero(setup.boundary.quad_kind == Kind.MOVING)
    return CellFields(after, setup.topology, setup.grid, moving, setup.original)


def deliver(
    report: Report, run: RunInput, start: float, files: Files,
    illustrate: Illustrate = tuple, ranks: Ranks = ONE_PROCESS,
) -> None:  # fmt: skip
    """Write the reports; if JSON is requested on stdout, the text goes to stderr.

    ``start`` is that of the command by ``time.perf_counter``, ``files`` are pairs of role and path, ``illustrate``
    draws the pictures of a page, and ``ranks`` shared the work (this process alone by default).
    """
    paths, to_stdout = [path for path in run.reports if path != STDOUT], run.as_json or STDOUT in run.reports
    if paths or to_stdout:
        # The checksums of files take time.
        arguments: tuple[str, ...] = click.get_current_context().find_root().obj.arguments
        report["run"] = ranks.on_first(lambda: run_part(arguments, files, ranks.count))
    if "timing" in report:
        report["timing"] = with_other(report["timing"], clock.perf_counter() - start)
    # If there are several ranks, drawing takes all of them.
    pictures = illustrate() if ranks.count > 1 and any(path.suffix == ".html" for path in paths) else ()
    for path in paths:
        ranks.on_first(partial(write_report, report, path, (lambda: pictures) if pictures else illustrate))
    if to_stdout:
        click.echo(as_json(report), nl=False)
    if not run.quiet:
        # Warnings are already on stderr.
        click.echo(as_text({**report, "warnings": []}, run.verbose), nl=False, err=to_stdout)


def conclude(
    report: Report, run: RunInput, start: float, files: Files, ranks: Ranks,
    illustrate: Illustrate = tuple,
) -> int:  # fmt: skip
    """Deliver the report, print the verdict; returns the exit code."""
    deliver(report, run, start, files, illustrate, ranks)
    bad = [level for level in report.get("levels", ()) if not level["valid"]]
    if bad:
        first = bad[0]
        tell(
            f"{len(bad)} of {len(report['levels'])} levels are not valid, first level {first['number']} "
            f"(t = {first['time']:g}): {_flaw(first, first['quality'])}. It is in {first['file']}"
        )
    elif not report["valid"]:
        tell(f"{_flaw(report, report['quality']['after'])}. The grid is in {report['output']}")
    if run.verbose:
        if ranks.count > 1:
            tell(f"{ranks.count} ranks, the first with {thread_count()} threads")
        for stage, seconds in report["timing"].items():
            tell(f"{stage} {seconds:.3f} s")
    return 0 if report["valid"] or run.allow_invalid else EXIT_INVALID


def _flaw(result: dict[str, Any], quality: dict[str, Any]) -> str:
    if result["reached"] < 1.0:
        return f"only {result['reached']:.1%} of the motion was imposed; the grid is the one reached"
    where = f", the worst {place_of(result['invalid_cells'][0])}" if result["invalid_cells"] else ""
    repaired = any(attempt["repair"] for attempt in result.get("attempts", ()))
    advice = "a smaller motion" if repaired else "--repair auto, --steps auto"
    return (
        f"{counted(quality['invalid_cells'], 'cell')} became invalid{where}; "
        f"try {advice}, or another method (see `meshdeform methods`)"
    )


def place_of(cell: dict[str, Any]) -> str:
    """Position of an invalid cell: nearest patch, centre, block and indices."""
    center = ", ".join(f"{x:.4g}" for x in cell["center"])
    near = f"near {cell['nearest_patch']!r} " if cell["nearest_patch"] else ""
    return f"{near}around ({center}): {cell['block']} {tuple(cell['ijk'])}"
