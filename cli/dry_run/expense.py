"""Memory, disk space and processor time of a deformation, estimated from the sizes of its grid."""

from __future__ import annotations

import dataclasses
import time as clock
from dataclasses import dataclass
from importlib.resources import as_file
from pathlib import Path

from meshdeform_core.deform import Case, deform
from meshdeform_core.grid import FileFormat, Grid
from meshdeform_core.memory import COORDINATE_ARRAYS, SMOOTHNESS_ARRAYS, Demand, MemoryLimit, readable
from meshdeform_core.methods import Options
from meshdeform_core.parallel import OneRank, holders, sharing
from meshdeform_core.repair import RepairOptions
from meshdeform_formats.case import read_case
from meshdeform_formats.grids import format_of
from meshdeform_formats.layout import Layout
from meshdeform_formats.placing import lack, least_bytes, velocity_bytes
from meshdeform_formats.report import Report, head_part
from meshdeform_samples import folder, load

from .rates import ONE, RATES, Levels, beside_files

_SAMPLE, _SIZE, _TIMES = "hemisphere", 32, 3
# Bytes per node in files: coordinates before and after, the verdict and one measure of every cell; further ones of a
# series. Bytes per node on block faces in those of every rank.
_COORDINATES = 24
_IN_FILES, _OF_SERIES, _OF_FACES = 2 * _COORDINATES + 4, 32, 38


@dataclass(frozen=True)
class Expense:
    """Largest resident size, of each of the ``ranks`` that hold a part of the grid; temporary files of all of them, and
    size of the output, all in bytes; processor seconds of all ranks and threads together. These are ``None`` for
    methods whose time does not follow from the sizes; their memory is a bound."""

    ranks: int
    memory_bytes: int
    work_bytes: int
    output_bytes: int
    cpu_seconds: float | None


def expense_of(
    grid: Grid | Layout, case: Case, output: Path | None, precision: str, limit: MemoryLimit, levels: Levels = ONE
) -> Expense:
    """The expense of one step without a repair, at every level; what has been taken from the ``limit`` is for pictures.

    The processor time is scaled to this machine by deforming a small sample with the same method, which takes about a
    second.

    Raises
    ------
    MethodError
        When the memory does not suffice even with large arrays in files.
    """
    more = SMOOTHNESS_ARRAYS + levels.velocity_arrays if levels.count > 1 else 0
    demand = Demand.of("deforming", grid, arrays=COORDINATE_ARRAYS + more)
    files = demand.in_memory > limit.size
    if files:
        limit.require(demand.beside_files(limit), demand.what, "allow more, or use a machine that has it")
    ranks, rates = holders(), RATES.get(case.method.name)
    memory = rates.memory(grid, levels) if rates else demand.in_memory
    seconds = None
    if rates:
        seconds = rates.seconds(grid, levels, ranks.on_first(lambda: _sample_seconds(case.method)))
    per_node = _IN_FILES + (_COORDINATES * more + _OF_SERIES if levels.count > 1 else 0)
    work = per_node * grid.n_nodes + _OF_FACES * grid.n_face_nodes * ranks.count if files else 0
    written = levels.count * _written(grid, output, precision, levels.velocity) if output is not None else 0
    memory = min(memory, beside_files(grid, limit)) if files else memory
    return Expense(ranks.count, int(memory) + limit.taken, work, written, seconds)


def _written(grid: Grid | Layout, output: Path, precision: str, velocity: str) -> int:
    """Bytes of the coordinates of one level, and of its velocities."""
    options = grid.format.options if grid.format and grid.format.name == format_of(output) else {}
    size = least_bytes(grid, output, FileFormat(format_of(output), precision, options))
    return size and size + velocity_bytes(grid, velocity, precision)


def _sample_seconds(method: Options) -> float:
    """Processor seconds of one thread for the sample: the smallest of a few runs, as the first may compile loops."""
    grid = load(_SAMPLE).generate(_SIZE)
    with as_file(folder(_SAMPLE) / "case.toml") as path:
        case = read_case(path, (), None, None, None, None).case
    case = dataclasses.replace(case, method=method, repair=RepairOptions("off"))
    found = []
    with sharing(OneRank(), 1):
        for _ in range(_TIMES):
            begin = clock.process_time()
            deform(grid, case)
            found.append(clock.process_time() - begin)
    return min(found)


def plan_by_sizes(
    layout: Layout,
    case: Case,
    output: Path | None,
    variant: dict[str, str],
    limit: MemoryLimit,
    levels: Levels = ONE,
) -> Report:
    """The report of a dry run for a grid that does not fit into memory, from the header of its file."""
    precision = variant.get("precision", layout.precision)
    expense = expense_of(layout, case, output, precision, limit, levels)
    note = (
        f"the grid is larger than the memory ({readable(limit.size)}): only the header of its file was read; the "
        "boundary was not classified, the motion not tried"
    )
    warnings = [note]
    needed = expense.work_bytes + expense.output_bytes
    if output is not None and (missing := lack(needed, output, "files to work in and the output take")):
        warnings.append(missing)
    return head_part(layout) | {"expected": dataclasses.asdict(expense), "warnings": warnings}
