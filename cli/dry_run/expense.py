"""Memory and disk space that a deformation takes, estimated from the sizes of its grid."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from meshdeform_core.deform import Case
from meshdeform_core.grid import FileFormat, Grid
from meshdeform_core.grid.dealing import bounds_of
from meshdeform_core.memory import COORDINATE_ARRAYS, SMOOTHNESS_ARRAYS, Demand, MemoryLimit, readable
from meshdeform_core.parallel import current_ranks
from meshdeform_core.parallel.scratch import RESERVE
from meshdeform_formats.grids import Layout, format_of
from meshdeform_formats.placing import lack, least_bytes, velocity_bytes
from meshdeform_formats.report.records import Report, head_part

_COORDINATES = 24
# Bytes per node of a series: undeformed cells, the level before, and the one that is being written. From the third
# level on there are also those from which accelerations follow.
_SERIES = 72
# Bytes of every rank of several: the MPI library, and per node on block faces a copy of the coordinates near it.
_MPI, _COPY = 34e6, 60
# One part in this many of a limit is for pages of files, at least what is reserved.
_PAGES = 4
# Bytes of a block, and of a zone of a CGNS file, which has dozens of nodes in the file.
_BLOCK, _ZONE = 24e3, 110e3
_CGNS = 11e6
"""Bytes of the libraries that read CGNS files."""


class Stage(NamedTuple):
    """Bytes that are in memory when a stage takes most, as a sum of parts.

    Attributes
    ----------
    program : of the program with its libraries and loops
    node : per node
    face_node : per node on block faces
    outside : further ones per node on outside faces, which are mostly sources
    largest : per node of the largest block, where blocks are filled as a whole
    """

    program: float
    node: float
    face_node: float
    outside: float = 0.0
    largest: float = 0.0


@dataclass(frozen=True)
class Levels:
    """Number of grids that a run writes, their velocities, and the number of coordinate arrays that these take."""

    count: int = 1
    velocity: str = "none"
    velocity_arrays: int = 0

    @property
    def bytes_per_node(self) -> int:
        """What a node takes in memory beside a single level."""
        arrays = self.velocity_arrays + SMOOTHNESS_ARRAYS * (self.count > 2)
        return _COORDINATES * arrays + _SERIES * (self.count > 1)


ONE = Levels()
# Bytes per node in files: coordinates before and after, the verdict and one measure of every cell; further ones of a
# series. Bytes per node on block faces in those of every rank.
_IN_FILES, _OF_SERIES, _OF_FACES = 2 * _COORDINATES + 4, 32, 38


@dataclass(frozen=True)
class Expense:
    """Largest resident size, of each of the ``ranks`` that hold a part of the grid; temporary files of all of them, and
    size of the output, all in bytes. ``bound``: the memory is the most that the run may take, as that of the method
    does not follow from the sizes."""

    ranks: int
    memory_bytes: int
    work_bytes: int
    output_bytes: int
    bound: bool


def expense_of(
    grid: Grid | Layout, case: Case, output: Path | None, precision: str, limit: MemoryLimit, levels: Levels = ONE
) -> Expense:
    """The expense of one step without a repair, at every level; what has been taken from the ``limit`` is for pictures.

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
    ranks, moving = current_ranks(), MOVING.get(case.method.name)
    memory = memory_of(moving, grid, levels) if moving else demand.in_memory
    per_node = _IN_FILES + (_COORDINATES * more + _OF_SERIES if levels.count > 1 else 0)
    work = per_node * grid.n_nodes + _OF_FACES * grid.n_face_nodes * ranks.count if files else 0
    written = levels.count * _written(grid, output, precision, levels.velocity) if output is not None else 0
    memory = min(memory, _beside_files(grid, limit)) if files else memory
    return Expense(ranks.count, int(memory) + limit.taken, work, written, moving is None)


def _written(grid: Grid | Layout, output: Path, precision: str, velocity: str) -> int:
    """Bytes of the coordinates of one level, and of its velocities."""
    options = grid.format.options if grid.format and grid.format.name == format_of(output) else {}
    size = least_bytes(grid, output, FileFormat(format_of(output), precision, options))
    return size and size + velocity_bytes(grid, velocity, precision)


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


def memory_of(moving: Stage, grid: Grid | Layout, levels: Levels) -> float:
    """Bytes of the largest rank if all arrays are in memory: those of the stage that takes most."""
    one, nodes, *others, largest = sizes = _sizes(grid)
    # A rank holds what it fills as a whole, even if its part ends within.
    held = one, max(nodes, largest) if moving.largest else nodes, *others, largest
    stages = float(np.dot(moving, held)), float(np.dot(JUDGING, sizes))
    return max(stages) + _beside_stages(grid) + levels.bytes_per_node * nodes


def _beside_files(grid: Grid | Layout, limit: MemoryLimit) -> float:
    """Bytes of the largest rank with large arrays in files: everything else, and pages of the files until they are
    released."""
    pages = max(limit.size // _PAGES, RESERVE)
    return min(float(np.dot(IN_FILES, _sizes(grid))) + _beside_stages(grid) + pages, limit.size - RESERVE // 3)


def _sizes(grid: Grid | Layout) -> tuple[float, ...]:
    """What the parts of a stage are multiplied with, for the largest rank."""
    ranks = current_ranks().count
    nodes = int(np.diff(bounds_of(grid.shapes, ranks)).max()) if ranks > 1 else grid.n_nodes
    # How much of the block faces lies outside is known only from coordinates: as if equal cubes formed a cube.
    outside = grid.n_face_nodes / np.cbrt(grid.n_blocks)
    return 1, nodes, grid.n_face_nodes, outside, int(np.prod(grid.shapes, axis=1).max())


def _beside_stages(grid: Grid | Layout) -> float:
    """Bytes that blocks, libraries for CGNS files, and MPI with copies of what other ranks hold take in all stages."""
    shared = (_MPI + _COPY * grid.n_face_nodes) * (current_ranks().count > 1)
    in_zones = grid.format is not None and grid.format.name == "cgns"
    return shared + (_ZONE if in_zones else _BLOCK) * grid.n_blocks + _CGNS * in_zones


JUDGING = Stage(151e6, 57, 150)
"""While the grid is judged: faces get roles, lines at walls and interfaces are measured; the method has been freed."""
IN_FILES = Stage(241e6, 3.6, 58)
"""What is not in files where large arrays are."""
MOVING = {
    "tfi": Stage(137e6, 52, 110, largest=22),
    "idw": Stage(139e6, 88, 50, 395),
    "idw-tfi": Stage(139e6, 57, 80, 395),
}
"""While nodes move, by method."""
