"""Faces that no boundary entry selects: where they are, and whether fixing them deserves a warning."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..errors import CaseError
from ..grid import Grid, IntArray, Window
from ..grid.connectivity.openings import Opening, describe_group, patched_groups
from ..grid.connectivity.overset import Overlap
from ..grid.planes import plane_normal, plane_of
from ..grid.selection import select_quads
from ..grid.topology import Topology, quads_of_windows
from ..grid.windows import rectangles
from ..wording import listed

Region = tuple[Window, IntArray]


def regions(grid: Grid, topology: Topology, quads: IntArray) -> list[Region]:
    """Rectangles of nodes that cover ``quads``, with the quads in each, largest first."""
    label = np.full(len(topology.partner), -1)
    label[quads] = 0
    pieces = rectangles(grid, topology.quads, label)
    found = [(window, pieces.quads_of(number)) for number, window in enumerate(pieces.windows())]
    return sorted(found, key=lambda region: -len(region[1]))


def unselected_notes(grid: Grid, topology: Topology, quads: IntArray, moving: IntArray, expected: bool) -> list[str]:
    """Warnings about faces ``quads`` that are fixed because nothing selects them.

    Parameters
    ----------
    moving : unique numbers of the nodes that move
    expected : the case is only a table, and the other faces are meant to be fixed
    """
    places = regions(grid, topology, quads)
    notes = []
    if not expected:
        ranges = listed((f"{grid.window_label(window)} ({len(found):,})" for window, found in places), noun="ranges")
        notes.append(
            f"{quads.size:,} external face quads are not selected by any boundary entry; they are fixed: {ranges}"
        )
    moves = np.zeros(topology.n_unique, dtype=bool)
    moves[moving] = True
    touching = [window for window, found in places if moves[topology.quads.corners[found]].any()]
    if touching:
        normal = plane_normal(grid)
        corners = (topology.quads.corners[quads_of_windows(topology.quads, [window])[0]] for window in touching)
        points = (grid.nodes.at(topology.first[np.unique(some)]) for some in corners)
        flat = all(plane_of(x, normal) is not None for x in points)
        remedy = (
            'they are flat: symmetry planes and end planes need kind = "symmetry" or "slip"'
            if flat
            else 'give them a kind: "slip" lets their nodes follow, "fixed" confirms that they stay'
        )
        if expected:
            remedy += " in a case file; `meshdeform init --table` writes one"
        names = listed(grid.window_label(window) for window in touching)
        notes.append(f"faces that no boundary entry selects touch moving nodes but are fixed: {names}; {remedy}")
    return notes


def opening_notes(
    grid: Grid,
    topology: Topology,
    openings: Sequence[Opening | Overlap],
    unselected: IntArray,
    moving: IntArray,
    declared: bool | Sequence[str],
) -> list[str]:
    """Warnings about outside faces that nearly coincide with others.

    Parameters
    ----------
    unselected, moving : face quads that nothing selects, and those of moving entries
    declared : the value of ``grid.open``: faces that are meant to be open (``True``: all)

    Raises
    ------
    CaseError
        When no boundary entry selects such a face, as the grid would tear at this fixed wall.
    """
    if declared is True or not openings:
        return []
    meant = select_quads(grid, topology, declared, "grid.open") if declared else np.empty(0, dtype=np.int64)
    told = []
    for opening in openings:
        if any(np.isin(opening.quads, known).all() for known in (meant, moving)):
            continue
        text = opening.describe(grid)
        apart = overlap_advice(grid) if isinstance(opening, Overlap) else ""
        if np.isin(opening.quads, unselected).any():
            count = f" ({len(openings)} such places, see `meshdeform info`)" if len(openings) > 1 else ""
            close = "Close the gap with that tolerance, or say" if opening.matching else "Say"
            raise CaseError(
                f"{text}{count}. Nothing selects them, so they would be fixed walls, at which the grid tears. {close} "
                f"that they are walls: [grid] open = true, or a list of faces; or select them in a boundary entry"
                f"{apart}"
            )
        told.append(opening)
    groups = ((describe_group(grid, group), group[0]) for group in patched_groups(told))
    return [text + (overlap_advice(grid) if isinstance(first, Overlap) else "") for text, first in groups]


def overlap_advice(grid: Grid) -> str:
    """What to do about blocks that overlap; empty if the grid is divided into components."""
    return "" if grid.components else "; blocks that overlap on purpose: name their groups in [grid] components"
