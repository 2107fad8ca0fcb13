"""Thin plates between blocks: faces that the case declares to be walls on both sides instead of an interface."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from ..errors import CaseError
from ..grid import Grid, Patch
from ..grid.selection import quads_of_pattern
from ..grid.topology import Topology, quads_of_patches
from ..grid.windows import rectangles


def with_plates(grid: Grid, topology: Topology, patterns: Sequence[str]) -> tuple[Grid, Topology]:
    """The plates that the case names (``grid.plates``) as outside faces: walls on both sides among the grid's patches.

    One of the two sides is enough. Nodes of the two sides remain coincident: a plate has no thickness, and its sides
    cannot separate.

    Raises
    ------
    CaseError
        When a pattern matches nothing, or no face that two blocks share.
    """
    patches = list(grid.patches)
    for pattern in patterns:
        quads = quads_of_pattern(grid, topology.quads, pattern, "grid.plates")
        shared = quads[topology.partner[quads] >= 0]
        if shared.size == 0:
            raise CaseError(
                f"grid.plates: {pattern!r} selects no face that is shared by two blocks; "
                f"faces on the outside need no entry (see `meshdeform info`)"
            )
        new = np.full(len(topology.partner), -1)
        new[shared] = new[topology.partner[shared]] = 0
        new[quads_of_patches(topology.quads, grid.patches)[0]] = -1
        names = {patch.name for patch in patches}
        name = next(name for n in range(len(names) + 1) if (name := f"plate{n + 1}") not in names)
        if (new == 0).any():
            patches.append(Patch(name, tuple(rectangles(grid, topology.quads, new).windows()), bc_type="wall"))
        topology = topology.opened(shared)
    return (dataclasses.replace(grid, patches=tuple(patches)) if patterns else grid), topology
