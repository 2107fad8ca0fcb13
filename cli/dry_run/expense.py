"""What a deformation takes, told from the sizes of its grid: memory, disk, processor time."""

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
from meshdeform_core.parallel import sharing
from meshdeform_core.parallel.loops import OneRank
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
# In files: the coordinates before and after, a verdict and a measure of every cell; in memory nearly all of the limit.
_IN_FILES = 24 + 24 + 5


@dataclass(frozen=True)
class Rates:
    """Of one method, in one step without a repair, file to file: measured with 10 and 1000 blocks of up to 20 million
    nodes (docs/performance.md).

    Attributes
    ----------
    program, node, face_node, block : bytes of the program, for each node, in addition for each node on block faces, and
        for each block
    start, per_node, per_face_node, per_block : processor seconds of the same, where the sample took ``sample`` seconds
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
        """Bytes, where all arrays are in memory."""
        return self.program + self.node * grid.n_nodes + self.face_node * grid.n_face_nodes + self.block * grid.n_blocks

    def seconds(self, grid: Grid | Layout, sample: float) -> float:
        """Processor seconds, where the sample takes ``sample`` seconds."""
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
    """Largest resident size, files to work in while it runs, and the size of the output, all in bytes; processor
    seconds of all threads together, ``None`` for methods whose time the sizes do not tell."""

    memory_bytes: int
    work_bytes: int
    output_bytes: int
    cpu_seconds: float | None


def expense_of(grid: Grid | Layout, case: Case, output: Path | None, precision: str, limit: MemoryLimit) -> Expense:
    """What one step without a repair takes.

    The processor time is that of this machine: it is scaled by a small sample, which is deformed by the same method
    now, a second of work.

    Raises
    ------
    MethodError
        When the memory does not suffice, not even with large arrays in files.
    """
    size = 24 * grid.n_nodes
    demand = Demand(f"deforming {grid.n_nodes:,} nodes", grid.n_nodes, size, grid.n_face_nodes)
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
    # Pages of files are returned some way below the limit: two thirds of the reserve were seen in use.
    least = limit.size - RESERVE // 3
    return Expense(
        int(min(memory, least) if files else memory), _IN_FILES * grid.n_nodes if files else 0, written, seconds
    )


def _sample_seconds(method: Options) -> float:
    """Processor seconds in which one thread deforms the sample: the best of a few, as the first may compile."""
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
    """The report of a dry run for a grid that does not fit into memory: its coordinates are not read."""
    precision = variant.get("precision", layout.precision)
    expense = expense_of(layout, case, output, precision, limit)
    note = (
        f"the grid is larger than the memory ({readable(limit.size)}): only the header of its file was read; the "
        "boundary was not classified, the motion not tried"
    )
    return head_part(layout) | {"expected": dataclasses.asdict(expense), "warnings": [note]}
