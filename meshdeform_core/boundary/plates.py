"""Thin plates between blocks: coincident faces that are walls on both sides instead of an interface."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..errors import CaseError
from ..grid import Grid
from ..grid.selection import quads_of_patches, quads_of_pattern
from ..grid.topology import Topology


def open_two_sided_walls(grid: Grid, topology: Topology) -> tuple[Topology, list[str]]:
    """Open the plates that the file declares: the faces coincide, and both are walls."""
    wall = np.zeros(len(topology.partner), dtype=bool)
    walls = [patch for patch in grid.patches if any(word in patch.bc_type.lower() for word in ("wall", "solid"))]
    wall[quads_of_patches(topology.quads, walls)[0]] = True
    shared = np.flatnonzero(wall & (topology.partner >= 0))
    both = shared[wall[topology.partner[shared]]]
    if both.size == 0:
        return topology, []
    note = f"{both.size // 2} face quads are walls on both sides (a thin plate); they are treated as outside faces"
    return topology.opened(both), [note]


def open_plates(grid: Grid, topology: Topology, patterns: Sequence[str]) -> Topology:
    """Open the plates that the case names (``grid.plates``); one of the two sides is enough.

    Nodes of the two sides remain coincident: a plate has no thickness, and its sides cannot separate.

    Raises
    ------
    CaseError
        When a pattern matches nothing, or no face that two blocks share.
    """
    for pattern in patterns:
        quads = quads_of_pattern(grid, topology.quads, pattern, "grid.plates")
        shared = quads[topology.partner[quads] >= 0]
        if shared.size == 0:
            raise CaseError(
                f"grid.plates: {pattern!r} selects no face that is shared by two blocks; "
                f"faces on the outside need no entry (see `meshdeform info`)"
            )
        topology = topology.opened(shared)
    return topology
