"""How the blocks of a grid are joined: what is known of it before its boundary is."""

from __future__ import annotations

from dataclasses import dataclass

from ..parallel import current_ranks
from .blocks import Grid
from .extent import require_extent
from .openings import Opening, find_openings
from .overset import Overlap
from .topology import Topology, find_topology


@dataclass(frozen=True, eq=False)
class Joints:
    """Topology and openings of a grid whose nodes coincide within ``tolerance``, relative to the local edge."""

    tolerance: float
    topology: Topology
    openings: tuple[Opening | Overlap, ...]


def find_joints(grid: Grid, tolerance: float) -> Joints:
    """Find both; on several ranks once per machine.

    Raises
    ------
    GridError
        When the grid has no extent in one of its dimensions.
    """
    require_extent(grid)
    topology = current_ranks().once(lambda: find_topology(grid, tolerance))
    return Joints(tolerance, topology, current_ranks().once(lambda: find_openings(grid, topology)))
