"""How much memory and processor time the methods take, by the sizes of a grid (docs/performance.md)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from meshdeform_core.grid import Grid
from meshdeform_core.grid.dealing import bounds_of
from meshdeform_core.memory import SMOOTHNESS_ARRAYS, MemoryLimit
from meshdeform_core.parallel import holders
from meshdeform_core.parallel.scratch import RESERVE
from meshdeform_formats.layout import Layout

_COORDINATES = 24
# Bytes per node of a series: undeformed cells, the level before, and the one that is being written. From the third
# level on there are also those from which accelerations follow.
_SERIES = 72
# Bytes of every rank of several: the MPI library, and per node on block faces a copy of the coordinates near it.
_MPI, _COPY = 34e6, 60
# One part in this many of a limit is for pages of files, at least what is reserved.
_PAGES = 4
# Bytes and processor seconds of a block, and of a zone of a CGNS file, which has dozens of nodes in the file.
_BLOCK, _ZONE = (24e3, 0.002), (110e3, 0.012)
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


@dataclass(frozen=True)
class Rates:
    """Measured rates of one method: levels of one step without a repair, from file to file.

    Attributes
    ----------
    moving : while nodes move
    start, per_node, per_face_node, further : processor seconds of the program, per node, additional ones per node on
        block faces, and per node of each further level, on the machine where the sample took ``sample`` seconds
    """

    moving: Stage
    start: float
    per_node: float
    per_face_node: float
    further: float
    sample: float

    def memory(self, grid: Grid | Layout, levels: Levels) -> float:
        """Bytes of the largest rank if all arrays are in memory: those of the stage that takes most."""
        one, nodes, *others, largest = sizes = _sizes(grid)
        # A rank holds what it fills as a whole, even if its part ends within.
        held = one, max(nodes, largest) if self.moving.largest else nodes, *others, largest
        stages = float(np.dot(self.moving, held)), float(np.dot(JUDGING, sizes))
        return max(stages) + _beside_stages(grid) + levels.bytes_per_node * nodes

    def seconds(self, grid: Grid | Layout, levels: Levels, sample: float) -> float | None:
        """Processor seconds, of all ranks together, on a machine where the sample takes ``sample`` seconds; velocities
        were not measured."""
        if levels.velocity_arrays:
            return None
        by_all = self.start + self.per_face_node * grid.n_face_nodes + _per_block(grid)[1] * grid.n_blocks
        by_one = (self.per_node + self.further * (levels.count - 1)) * grid.n_nodes
        return (by_all * holders().count + by_one) * sample / self.sample


def beside_files(grid: Grid | Layout, limit: MemoryLimit) -> float:
    """Bytes of the largest rank with large arrays in files: everything else, and pages of the files until they are
    released."""
    pages = max(limit.size // _PAGES, RESERVE)
    return min(float(np.dot(IN_FILES, _sizes(grid))) + _beside_stages(grid) + pages, limit.size - RESERVE // 3)


def _sizes(grid: Grid | Layout) -> tuple[float, ...]:
    """What the parts of a stage are multiplied with, for the largest rank."""
    ranks = holders().count
    nodes = int(np.diff(bounds_of(grid.shapes, ranks)).max()) if ranks > 1 else grid.n_nodes
    # How much of the block faces lies outside is known only from coordinates: as if equal cubes formed a cube.
    outside = grid.n_face_nodes / np.cbrt(grid.n_blocks)
    return 1, nodes, grid.n_face_nodes, outside, int(np.prod(grid.shapes, axis=1).max())


def _beside_stages(grid: Grid | Layout) -> float:
    """Bytes that blocks, libraries for CGNS files, and MPI with copies of what other ranks hold take in all stages."""
    shared = (_MPI + _COPY * grid.n_face_nodes) * (holders().count > 1)
    return shared + _per_block(grid)[0] * grid.n_blocks + _CGNS * _in_zones(grid)


def _per_block(grid: Grid | Layout) -> tuple[float, float]:
    return _ZONE if _in_zones(grid) else _BLOCK


def _in_zones(grid: Grid | Layout) -> bool:
    return grid.format is not None and grid.format.name == "cgns"


JUDGING = Stage(151e6, 57, 150)
"""While the grid is judged: faces get roles, lines at walls and interfaces are measured; the method has been freed."""
IN_FILES = Stage(241e6, 3.6, 58)
"""What is not in files where large arrays are."""
RATES = {
    "tfi": Rates(Stage(137e6, 52, 110, largest=22), 1.57, 0.45e-6, 2.8e-6, 0.29e-6, 0.27),
    "idw": Rates(Stage(139e6, 88, 50, 395), 1.96, 1.37e-6, 6.4e-6, 0.95e-6, 0.58),
    "idw-tfi": Rates(Stage(139e6, 57, 80, 395), 2.41, 0.82e-6, 5.4e-6, 0.4e-6, 0.46),
}
