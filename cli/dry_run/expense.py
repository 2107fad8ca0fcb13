"""Memory, disk space and processor time of a deformation, estimated from the sizes of its grid."""

from __future__ import annotations

import dataclasses
import time as clock
from dataclasses import dataclass
from importlib.resources import as_file
from pathlib import Path

from meshdeform_core.deform import Case, deform
from meshdeform_core.grid import FileFormat, Grid
from meshdeform_core.memory import Demand, MemoryLimit, readable
from meshdeform_core.methods import Options
from meshdeform_core.parallel import OneRank, sharing
from meshdeform_core.parallel.scratch import RESERVE
from meshdeform_core.repair import RepairOptions
from meshdeform_formats.case import read_case
from meshdeform_formats.grids import format_of
from meshdeform_formats.layout import Layout
from meshdeform_formats.placing import least_bytes
from meshdeform_formats.report import Report
from meshdeform_formats.report.parts import head_part
from meshdeform_samples import folder, load

_SAMPLE, _SIZE, _TIMES = "hemisphere", 32, 3
# Bytes per node in files: coordinates before and after, and the verdict and one measure of every cell.
_IN_FILES = 24 + 24 + 5


@dataclass(frozen=True)
class Rates:
    """Measured rates of one method: one step without a repair, from file to file, with 10 and 1000 blocks of up to
    20 million nodes (docs/performance.md).

    Attributes
    ----------
    program, node, face_node, block : bytes of the program itself, per node, additional ones per node on block faces,
        and per block
    start, per_node, per_face_node, per_block : processor seconds likewise, on the machine where the sample took
        ``sample`` seconds
    """

    program: float
    node: float
    face_node: float
    block: float
    start: float
    per_node: float
    per_face_node: float
    per_block: float
    sample: float

    def memory(self, grid: Grid | Layout) -> float:
        """Bytes if all arrays are in memory."""
        return self.program + self.node * grid.n_nodes + self.face_node * grid.n_face_nodes + self.block * grid.n_blocks

    def seconds(self, grid: Grid | Layout, sample: float) -> float:
        """Processor seconds on a machine where the sample takes ``sample`` seconds."""
        there = self.start + self.per_block * grid.n_blocks
        there += self.per_node * grid.n_nodes + self.per_face_node * grid.n_face_nodes
        return there * sample / self.sample


RATES = {
    "tfi": Rates(250e6, 68, 250, 450e3, 2.6, 0.61e-6, 9e-6, 0.012, 0.21),
    "idw": Rates(254e6, 105, 250, 450e3, 2.6, 1.04e-6, 16e-6, 0.012, 0.5),
    "idw-tfi": Rates(261e6, 74, 250, 450e3, 1.9, 0.83e-6, 16e-6, 0.012, 0.45),
}


@dataclass(frozen=True)
class Expense:
    """Largest resident size, temporary files, and size of the output, all in bytes; processor seconds of all threads
    together, ``None`` for methods whose time does not follow from the sizes."""

    memory_bytes: int
    work_bytes: int
    output_bytes: int
    cpu_seconds: float | None


def expense_of(grid: Grid | Layout, case: Case, output: Path | None, precision: str, limit: MemoryLimit) -> Expense:
    """The expense of one step without a repair.

    The processor time is scaled to this machine by deforming a small sample with the same method, which takes about a
    second.

    Raises
    ------
    MethodError
        When the memory does not suffice even with large arrays in files.
    """
    demand = Demand.of("deforming", grid)
    files = demand.in_memory > limit.size
    if files:
        limit.require(demand.beside_files(limit), demand.what, "allow more, or use a machine that has it")
    rates = RATES.get(case.method.name)
    memory = rates.memory(grid) if rates else demand.in_memory
    seconds = rates.seconds(grid, _sample_seconds(case.method)) if rates else None
    written = 0
    if output is not None:
        options = grid.format.options if grid.format and grid.format.name == format_of(output) else {}
        written = least_bytes(grid, output, FileFormat(format_of(output), precision, options))
    # Pages of mapped files are released some way below the limit: measured, two thirds of the reserve remain in use.
    least = limit.size - RESERVE // 3
    return Expense(
        int(min(memory, least) if files else memory), _IN_FILES * grid.n_nodes if files else 0, written, seconds
    )


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
    layout: Layout, case: Case, output: Path | None, variant: dict[str, str], limit: MemoryLimit
) -> Report:
    """The report of a dry run for a grid that does not fit into memory, from the header of its file."""
    precision = variant.get("precision", layout.precision)
    expense = expense_of(layout, case, output, precision, limit)
    note = (
        f"the grid is larger than the memory ({readable(limit.size)}): only the header of its file was read; the "
        "boundary was not classified, the motion not tried"
    )
    return head_part(layout) | {"expected": dataclasses.asdict(expense), "warnings": [note]}
