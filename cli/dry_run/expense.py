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
from meshdeform_core.parallel import OneRank, sharing
from meshdeform_core.parallel.scratch import RESERVE
from meshdeform_core.repair import RepairOptions
from meshdeform_formats.case import read_case
from meshdeform_formats.grids import format_of
from meshdeform_formats.layout import Layout
from meshdeform_formats.placing import lack, least_bytes, velocity_bytes
from meshdeform_formats.report import Report
from meshdeform_formats.report.parts import head_part
from meshdeform_samples import folder, load

_SAMPLE, _SIZE, _TIMES = "hemisphere", 32, 3
# Bytes per node in files: coordinates before and after, and the verdict and one measure of every cell.
_COORDINATES = 24
_IN_FILES = 2 * _COORDINATES + 5
# Bytes per node of a series: undeformed cells, the level before, and the one that is being written. From the third
# level on there are also those from which accelerations follow.
_SERIES = 72


@dataclass(frozen=True)
class Levels:
    """Number of grids that a run writes, their velocities, and the number of coordinate arrays that these take."""

    count: int = 1
    velocity: str = "none"
    velocity_arrays: int = 0


ONE = Levels()


@dataclass(frozen=True)
class Rates:
    """Measured rates of one method: levels of one step without a repair, from file to file (docs/performance.md).

    Attributes
    ----------
    program, node, face_node : bytes of the program itself, per node, and additional ones per node on block faces
    start, per_node, per_face_node, further : processor seconds likewise, and per node of each further level, on the
        machine where the sample took ``sample`` seconds
    """

    program: float
    node: float
    face_node: float
    start: float
    per_node: float
    per_face_node: float
    further: float
    sample: float

    def memory(self, grid: Grid | Layout, levels: Levels) -> float:
        """Bytes if all arrays are in memory."""
        arrays = levels.velocity_arrays + SMOOTHNESS_ARRAYS * (levels.count > 2)
        node = self.node + _COORDINATES * arrays + _SERIES * (levels.count > 1)
        return self.program + node * grid.n_nodes + self.face_node * grid.n_face_nodes + _per_block(grid)[0]

    def seconds(self, grid: Grid | Layout, levels: Levels, sample: float) -> float | None:
        """Processor seconds on a machine where the sample takes ``sample`` seconds; velocities were not measured."""
        if levels.velocity_arrays:
            return None
        node = self.per_node + self.further * (levels.count - 1)
        there = self.start + node * grid.n_nodes + self.per_face_node * grid.n_face_nodes + _per_block(grid)[1]
        return there * sample / self.sample


def _per_block(grid: Grid | Layout) -> tuple[float, float]:
    """Bytes and processor seconds that blocks take besides their nodes: a CGNS zone has dozens of nodes in its file."""
    zones = grid.format is not None and grid.format.name == "cgns"
    return (160e3 * grid.n_blocks, 0.012 * grid.n_blocks) if zones else (33e3 * grid.n_blocks, 0.002 * grid.n_blocks)


RATES = {
    "tfi": Rates(183e6, 59, 240, 1.57, 0.57e-6, 4.6e-6, 0.29e-6, 0.27),
    "idw": Rates(156e6, 91, 305, 1.96, 1.37e-6, 6.4e-6, 0.95e-6, 0.58),
    "idw-tfi": Rates(191e6, 60, 350, 2.41, 0.74e-6, 6.4e-6, 0.4e-6, 0.46),
}


@dataclass(frozen=True)
class Expense:
    """Largest resident size, temporary files, and size of the output, all in bytes; processor seconds of all threads
    together. These are ``None`` for methods whose time does not follow from the sizes; their memory is a bound."""

    memory_bytes: int
    work_bytes: int
    output_bytes: int
    cpu_seconds: float | None


def expense_of(
    grid: Grid | Layout, case: Case, output: Path | None, precision: str, limit: MemoryLimit, levels: Levels = ONE
) -> Expense:
    """The expense of one step without a repair, at every level.

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
    rates = RATES.get(case.method.name)
    memory = rates.memory(grid, levels) if rates else demand.in_memory
    seconds = rates.seconds(grid, levels, _sample_seconds(case.method)) if rates else None
    # Pages of mapped files are released some way below the limit: measured, two thirds of the reserve remain in use.
    least = limit.size - RESERVE // 3
    work = (_IN_FILES + (_COORDINATES * more)) * grid.n_nodes if files else 0
    written = levels.count * _written(grid, output, precision, levels.velocity) if output is not None else 0
    return Expense(int(min(memory, least) if files else memory), work, written, seconds)


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
