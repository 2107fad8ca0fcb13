"""Dry runs: what a run would do, warnings about motions that are bound to fail, found by tests of the boundary and by a
trial, and forecasts of memory and disk space from the sizes of the grid."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from meshdeform_core.boundary.classification import largest_displacement
from meshdeform_core.deform import Setup, Timing, impose
from meshdeform_core.grid import FileFormat, Grid
from meshdeform_core.memory import Demand, MemoryLimit, Work, readable
from meshdeform_core.methods.limits import patch_motions
from meshdeform_core.quality.listed import find_pinned
from meshdeform_core.repair.options import Limit
from meshdeform_core.stepping import Course, doubts, warnings_ahead
from meshdeform_core.wording import counted
from meshdeform_formats.grids import Layout, format_of
from meshdeform_formats.inputs import lack, least_bytes, velocity_bytes
from meshdeform_formats.report.records import Report, head_part, plan_report

from .work import place_of

TRIAL_NODES = 5_000_000
"""Largest number of nodes times steps for which the motion is tried."""


@dataclass(frozen=True)
class Outputs:
    """The grids that a run writes: path of one, if any is, precision, their number, and their velocities."""

    path: Path | None
    precision: str
    count: int = 1
    velocity: str = "none"

    def expense(self, grid: Grid | Layout, demand: Demand, sources: float, limit: MemoryLimit) -> dict[str, int]:
        """What one step without a repair takes, at every level, in bytes: memory of each of the ranks that hold a part
        of the grid; temporary files of all of them, and the output. What has been taken from the ``limit`` is for
        pictures. Refused is what does not fit even with large arrays in files.
        """
        ranks, (memory, files), written = limit.ranks.count, demand.foretold(limit, sources), 0
        if self.path is not None:
            kind = format_of(self.path)
            options = grid.format.options if grid.format and grid.format.name == kind else {}
            size = least_bytes(grid, self.path, FileFormat(kind, self.precision, options))
            written = self.count * (size and size + velocity_bytes(grid, self.velocity, self.precision))
        return {
            "ranks": ranks,
            "memory_bytes": memory + limit.taken,
            "work_bytes": ranks * files,
            "output_bytes": written,
        }


def plan_by_sizes(layout: Layout, work: Work, outputs: Outputs, limit: MemoryLimit) -> Report:
    """The report of a dry run for a grid that does not fit into memory, from the header of its file."""
    demand = Demand.of("deforming", work, layout, ranks=limit.ranks)
    # How many nodes are sources is known only from coordinates.
    expense = outputs.expense(layout, demand, demand.sizes.outside, limit)
    note = (
        f"the grid is larger than the memory ({readable(limit.size)}): only the header of its file was read; the "
        "boundary was not classified, the motion not tried"
    )
    needed, what = expense["work_bytes"] + expense["output_bytes"], "files to work in and the output take"
    missing = lack(needed, outputs.path, what) if outputs.path is not None else ""
    return head_part(layout) | {"expected": expense, "warnings": [note, *filter(None, [missing])]}


def plan(
    setup: Setup, times: Sequence[float], steps: int | str | None, outputs: Outputs, missing: str, demand: Demand,
    limit: MemoryLimit,
) -> tuple[Report, bool]:  # fmt: skip
    """What a run would do at the time of the largest displacement, and whether no valid grid exists then.

    The report has classification, parameters, node counts, early warnings, among them the space that is ``missing`` on
    the disk, and for a grid too large for a trial its expense.
    """
    prepared = setup.prepare()
    largest, time = max((largest_displacement(setup.displacement(t)), t) for t in times)
    motion, alone = setup.displacement(time), len(times) == 1
    report = plan_report(setup, prepared.account, largest, patch_motions(setup.problem, motion) if alone else ())
    # The warnings that a run gives before its first step.
    course = Course(setup, setup.motion(time), outputs.precision, Timing(), None, Limit())
    told = [*doubts(course, not alone), *warnings_ahead(course, prepared, steps)]
    found, impossible = forecast(setup, time, steps, outputs.precision)
    where = "" if alone else f"at t = {time:g}, where the displacement is largest: "
    report["warnings"] += [*(where + text for text in (*told, *found)), *filter(None, [missing])]
    if setup.grid.n_nodes > TRIAL_NODES:
        report["expected"] = outputs.expense(setup.grid, demand, len(setup.problem.source_numbers), limit)
    return report, impossible


def forecast(setup: Setup, time: float, steps: int | str | None, precision: str) -> tuple[list[str], bool]:
    """Warnings about a motion that is bound to fail, and whether the boundary alone shows that no valid grid exists.

    The method's trial imposes the motion without repair, in the requested number of steps or in one, and judges the
    grid as the run would. It does not cover smaller steps and repairs, which the run tries afterwards.
    """
    contact = setup.undeformed.contact(functools.partial(setup.displacement, time))
    pinned = find_pinned(setup.original, setup.boundary, setup.displacement(time))
    certain: list[str] = [found for found in (contact and contact.message, pinned) if found]
    count = steps if isinstance(steps, int) else 1
    if setup.grid.n_nodes * count > TRIAL_NODES:
        untried = (
            f"not tried: {counted(count, 'step')} with {setup.grid.n_nodes:,} nodes; trials are made up to "
            f"{TRIAL_NODES:,} nodes times steps"
        )
        return [*certain, untried], bool(certain)
    alone = setup.with_repair("off")
    result = impose(alone, alone.motion(time), count, precision, Timing())
    if result.valid:
        return certain, bool(certain)
    # The result of the trial, and how the run will respond to it.
    cells, mode = result.assessment.after.invalid_cells, setup.case.repair.mode
    worst = [f", the worst {place_of(dataclasses.asdict(cell))}" for cell in result.assessment.invalid[:1]]
    if certain:
        response = "no repair can mend that"
    elif mode == "off" and steps != "auto":
        response = "without repair the run is bound to fail: try --repair auto, --steps auto or another method"
    elif mode == "off":
        response = "the run divides the motion, which may not reach all of it"
    else:
        more = "" if isinstance(steps, int) else ", then smaller steps"
        response = f"the run will repair them{more}, which takes longer and may fail"
    tried = (
        f"tried with {setup.case.method.name} in {counted(result.steps, 'step')}: {counted(cells, 'cell')} "
        f"{'becomes' if cells == 1 else 'become'} invalid{''.join(worst)}; {response}"
    )
    return [*certain, tried], bool(certain)
