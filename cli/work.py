"""What the deforming commands do once their options are known."""

from __future__ import annotations

import time as clock
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from meshdeform_core.deform import Timing, impose, set_up
from meshdeform_core.grid import Grid
from meshdeform_core.memory import MemoryLimit
from meshdeform_core.methods import make_method
from meshdeform_core.numerics.parallel import current_ranks, thread_count
from meshdeform_formats.case import CaseFile
from meshdeform_formats.grids import complete_for_export, variant_of, write_grid
from meshdeform_formats.report import Report, deformation_report, plan_report
from meshdeform_formats.report import write_report as _write_report
from meshdeform_formats.report_text import as_text

from .machine import peak_memory
from .options import CaseInput, GridInput, keep_inputs
from .progress import ProgressBar

__all__ = ["Job", "describe", "load", "run", "tell", "write_report"]


@dataclass(frozen=True)
class Job:
    """A grid that was read and the case to apply to it."""

    grid: Grid
    case: CaseFile
    read_seconds: float
    memory: MemoryLimit


def load(source: GridInput, case: CaseInput, memory: MemoryLimit, outputs: Sequence[Path]) -> Job:
    """Read the case first (it is small and most often wrong), then the grid with its boundary information.

    ``outputs`` must not be files that the case names.
    """
    what = case.read()
    for path in outputs:
        keep_inputs(path, *what.files)
    make_method(what.case.method)
    start = clock.perf_counter()
    grid = source.read(what.boundary_file)
    # Coordinates before and after, displacement, arc lengths, quality: measured peaks stay below this.
    memory.require(
        8 * grid.points.nbytes, f"deforming {grid.n_nodes:,} nodes", "allow more, or use a machine that has it"
    )
    return Job(grid, what, clock.perf_counter() - start, memory)


def describe(job: Job, output: Path | None, time: float, variant: dict[str, str]) -> str:
    """What would be done: classification, parameters, node counts."""
    if output is not None:
        variant_of(job.grid, output, variant)
    setup = set_up(job.grid, job.case.case, memory=job.memory)
    prepared = make_method(job.case.case.method).prepare(setup.problem)
    displacement = setup.displacement(time)
    largest = float((displacement**2).sum(axis=1).max() ** 0.5)
    return as_text(plan_report(setup, prepared.account, {"max_displacement": largest})) + "dry run   nothing written\n"


def run(
    job: Job, output: Path, steps: int | str, time: float, variant: dict[str, str], progress: ProgressBar, start: float
) -> Report:
    """Deform, write, report. ``start`` is when the command began (``perf_counter``)."""
    precision = variant_of(job.grid, output, variant).precision
    timing = Timing()
    grid = complete_for_export(job.grid, output)
    result = impose(set_up(grid, job.case.case, timing, job.memory), time, steps, precision, timing, progress)
    before = clock.perf_counter()
    current_ranks().on_first(lambda: write_grid(result.grid, output, variant))
    now = clock.perf_counter()
    seconds = {"read": job.read_seconds, "write": now - before, "total": now - start}
    return deformation_report(result, seconds, peak_memory())


def write_report(report: Report, path: Path) -> None:
    """Write the report, json, html or text by suffix."""
    current_ranks().on_first(lambda: _write_report(report, path))


def tell(report: Report, quiet: bool, verbose: bool) -> None:
    """The report on stdout, what must not be missed on stderr."""
    if not quiet:
        click.echo(as_text(report), nl=False)
    if not report["valid"]:
        click.echo(f"meshdeform: {_verdict(report)}", err=True)
    if verbose:
        if (count := current_ranks().count) > 1:
            click.echo(f"meshdeform: {count} ranks, the first with {thread_count()} threads", err=True)
        for stage, seconds in report["timing"].items():
            click.echo(f"meshdeform: {stage} {seconds:.3f} s", err=True)


def _verdict(report: dict[str, Any]) -> str:
    if "levels" not in report:
        return _flaw(report, report["quality"]["after"])
    bad = [level for level in report["levels"] if not level["valid"]]
    first = bad[0]
    return (
        f"{len(bad)} of {len(report['levels'])} levels are not valid, first level {first['number']} "
        f"(t = {first['time']:g}): {_flaw(first, first['quality'])}"
    )


def _flaw(result: dict[str, Any], quality: dict[str, Any]) -> str:
    if result["reached"] < 1.0:
        return f"the motion was imposed to {result['reached']:.1%} only; the grid written is the one reached"
    first = result["invalid_cells"][0]
    return (
        f"{quality['invalid_cells']} cells became invalid, first {first['block']} {tuple(first['ijk'])} near "
        f"{first['nearest_patch']!r}; try --steps auto, or another method (see `meshdeform methods`)"
    )
