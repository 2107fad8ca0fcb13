"""Consistency of displacement tables with the walls they move: units, unused points, gaps, extrapolation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import MotionError
from ..grid import BoolArray, IntArray
from ..grid.topology import Topology
from ..notices import Notice
from ..numerics.arrays import places_among
from ..numerics.geometry.vectors import doubled_areas, unit
from ..wording import counted, vector
from .motions.motion import PreparedMotion
from .tables.frames import far_points, other_frame
from .tables.matching import BoundaryNodes, Transfer
from .tables.tuned import ABRUPT, ASTRAY, OFFSET, SMOOTH


@dataclass(frozen=True)
class _Use:
    """A table as one boundary entry uses it.

    Attributes
    ----------
    quads : the faces that the entry selects
    place : identifies the table within its entry; all tables of a sequence share one
    """

    match: Transfer
    nodes: BoundaryNodes
    quads: IntArray
    place: str

    def notice(self, what: str, text: str) -> Notice:
        """A warning about the table."""
        return Notice(f"{self.match.label}{text}", f"{what} of {self.place}")


class Tables:
    """The displacement tables of the moving boundary entries; those of a sequence change with time.

    Parameters
    ----------
    movers : selected face quads and motion of every moving boundary entry
    """

    def __init__(self, topology: Topology, movers: Sequence[tuple[IntArray, PreparedMotion]]):
        self._topology, self._movers = topology, movers
        self._checked: list[Transfer] = []
        self._found: list[Notice] = []

    def warnings(self) -> list[Notice]:
        """Warnings about the tables now in use, see :func:`table_warnings`."""
        matches = [match for _, motion in self._movers for match in motion.matches]
        if len(matches) != len(self._checked) or any(a is not b for a, b in zip(matches, self._checked, strict=True)):
            self._found = table_warnings(self._topology, self._movers)
            self._checked = matches
        return self._found


def table_warnings(topology: Topology, movers: Sequence[tuple[IntArray, PreparedMotion]]) -> list[Notice]:
    """Warnings about tables and the walls that they move.

    Parameters
    ----------
    movers : selected face quads and motion of every moving boundary entry

    Raises
    ------
    MotionError
        When most of a table lies off the walls, or it moves single nodes among others that remain at rest.
    """
    uses = [
        _Use(match, motion.nodes, quads, f"table {number} of entry {entry}")
        for entry, (quads, motion) in enumerate(movers)
        for number, match in enumerate(motion.matches)
    ]
    tables: dict[tuple[str, int, float], list[_Use]] = {}
    for use in uses:
        points = use.match.points
        if len(points):
            tables.setdefault((use.match.label, len(points), float(points.sum())), []).append(use)
    notes = list[Notice]()
    for table in tables.values():
        first = table[0]
        if first.nodes.grid.dimension == 3 and first.match.plane:
            text = (
                " has two components of the displacement, the grid is three-dimensional: nodes do not move in z. Give "
                "dz as well; a column of zeros if this is meant"
            )
            notes.append(first.notice("missing z", text))
        notes += _unused(table)
    for use in uses:
        notes += [*_gaps(topology, use), *_distances(use)]
    return notes


def _unused(uses: Sequence[_Use]) -> list[Notice]:
    """Points of one table that lie on none of the faces that it moves."""
    points = uses[0].match.points
    far = np.logical_and.reduce([far_points(points, use.nodes) for use in uses])
    if not far.any():
        return []
    hint = next((text for use in uses if (text := other_frame(points, use.nodes))), "")
    first = int(np.argmax(far))
    text = (
        f": {int(far.sum())} of {len(points)} table points lie on no face that the table moves, first "
        f"{vector(points[first])}{hint}"
    )
    partial = any(use.match.partial for use in uses)
    if far.mean() > ASTRAY and (partial or hint):
        raise MotionError(f"{uses[0].match.label}{text}; expected a table of the wall, in the grid's length unit")
    return [uses[0].notice("unused points", text)]


def _gaps(topology: Topology, use: _Use) -> list[Notice]:
    """Moving nodes among others that the table does not move."""
    match, nodes = use.match, use.nodes
    if match.matched.all():
        return []
    local = places_among(nodes.numbers, topology.n_unique)
    corners = local[topology.quads.corners[use.quads]]
    inside = match.matched[corners]
    whole = np.all(inside, axis=1)
    mixed = np.any(inside, axis=1) & ~whole
    held = np.zeros(len(nodes.numbers), dtype=bool)
    held[corners[whole]] = True
    single = np.flatnonzero(match.matched & ~held)
    count = int(match.matched.sum())
    if single.size:
        remedy = 'Use match = "interpolate", or a table of all nodes of the wall'
        if match.how == "interpolate":
            remedy = "Set a larger tolerance, or use a table that covers the wall"
        text = (
            f": {single.size} of the {count} nodes that it moves belong to no face that moves as a whole, "
            f"first {nodes.label(int(single[0]))}: their neighbours have no match and do not move"
            f"{other_frame(match.points, nodes)}. {remedy}"
        )
        if single.size > ASTRAY * count:
            raise MotionError(f"{match.label}{text}")
        return [use.notice("single nodes", text)]
    return _abrupt_end(use, corners, whole, mixed)


def _abrupt_end(use: _Use, corners: IntArray, whole: BoolArray, mixed: BoolArray) -> list[Notice]:
    """A warning if the motion ends with a jump in the middle of a smooth wall."""
    nodes, match = use.nodes, use.match
    x = nodes.points[corners]
    # Normals of faces; tangents of 2-D edges.
    direction = unit(x[:, 1] - x[:, 0] if x.shape[1] == 2 else doubled_areas(x))
    along = np.zeros((len(nodes.points), 3))
    for column in corners.T:
        np.add.at(along, column[whole], direction[whole])
    along = unit(along)
    step = np.linalg.norm(match.displacement, axis=1) * match.matched
    torn = (step > ABRUPT * nodes.edge)[corners[mixed]]
    smooth = np.einsum("qcd,qd->qc", along[corners[mixed]], direction[mixed]) > SMOOTH
    found = (torn & smooth).any(axis=1)
    if not found.any():
        return []
    ends = np.unique(corners[mixed][torn & smooth])
    worst = int(ends[np.argmax(step[ends])])
    text = (
        f": the motion ends abruptly at {counted(int(found.sum()), 'face')} of a smooth wall, where nodes that move "
        f"by up to {step[worst]:.3g} (at {nodes.label(worst)}) have neighbours without a match, which do not move"
    )
    return [use.notice("abrupt end", text)]


def _distances(use: _Use) -> list[Notice]:
    """Warnings about nodes that take the value of a distant point, or that lie beyond the table's surface."""
    match, nodes = use.match, use.nodes
    if match.how == "interpolate":
        out = match.matched & (match.beyond > nodes.edge)
        if not out.any():
            return []
        text = (
            f": {int(out.sum()):,} nodes lie beyond the table, by up to {match.beyond[out].max():.3g}; their "
            f"displacement is extrapolated"
        )
        return [use.notice("extrapolation", text)]
    off = match.matched & (match.distance > OFFSET * nodes.edge)
    notes = []
    if off.any():
        text = (
            f": {int(off.sum())} of {int(match.matched.sum())} nodes lie up to {match.distance[off].max():.3g} away "
            f'from the table point whose displacement they take (match = "{match.how}"); "interpolate" interpolates '
            f"between the table points"
        )
        notes.append(use.notice("distance", text))
    taken = match.used[0]
    if match.how == "nearest" and taken < 0.9 * match.matched.sum():
        text = (
            f": {int(match.matched.sum())} nodes share the displacements of {taken} table points, stepwise; use "
            f'match = "interpolate"'
        )
        notes.append(use.notice("shared points", text))
    return notes
