"""Consistency of displacement tables with the walls they move: units, unused points, gaps, extrapolation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import MotionError
from ..grid import BoolArray, FloatArray, IntArray
from ..grid.topology import Topology
from .frames import far_points, other_frame
from .matching import Nodes, Transfer
from .motion import PreparedMotion

_MOST = 0.5
"""A table with more than this fraction of its points off the walls was not made for them."""
_OFFSET = 0.1
"""Matched points farther away than this fraction of the shortest edge are not points of the wall."""
_SMOOTH = 0.85
"""Faces whose normals have at least this cosine belong to one smooth surface."""
_ABRUPT = 1e-2
"""A jump of the displacement by more than this fraction of the shortest edge tears the wall."""


@dataclass(frozen=True)
class _Use:
    """A table as one boundary entry uses it; ``quads`` are the faces that the entry selects."""

    match: Transfer
    nodes: Nodes
    quads: IntArray


class Tables:
    """The displacement tables of the moving boundary entries; those of a sequence change with time.

    Parameters
    ----------
    movers : selected face quads and motion of every moving boundary entry
    """

    def __init__(self, topology: Topology, movers: Sequence[tuple[IntArray, PreparedMotion]]):
        self._topology, self._movers = topology, movers
        self._checked: list[Transfer] = []
        self._told: set[str] = set()

    def warnings(self) -> list[str]:
        """Warnings about the tables now in use that no earlier ones gave rise to, see :func:`table_warnings`."""
        matches = [match for _, motion in self._movers for match in motion.matches]
        if len(matches) == len(self._checked) and all(a is b for a, b in zip(matches, self._checked, strict=True)):
            return []
        self._checked = matches
        labels = {match.label for match in matches}
        found = {_without(labels, text): text for text in table_warnings(self._topology, self._movers)}
        new = [text for key, text in found.items() if key not in self._told]
        self._told |= found.keys()
        return new


def _without(labels: set[str], text: str) -> str:
    """A warning without the names of tables: the same warning about all tables of a sequence is told once."""
    for label in labels:
        text = text.replace(label, "")
    return text


def table_warnings(topology: Topology, movers: Sequence[tuple[IntArray, PreparedMotion]]) -> list[str]:
    """Warnings about tables and the walls that they move.

    Parameters
    ----------
    movers : selected face quads and motion of every moving boundary entry

    Raises
    ------
    MotionError
        When most of a table lies off the walls, or it moves single nodes among others that stay.
    """
    uses = [_Use(match, motion.nodes, quads) for quads, motion in movers for match in motion.matches]
    tables: dict[tuple[str, int, float], list[_Use]] = {}
    for use in uses:
        points = use.match.points
        if len(points):
            tables.setdefault((use.match.label, len(points), float(points.sum())), []).append(use)
    notes = [note for table in tables.values() for note in (*_without_z(table[0]), *_unused(table))]
    for use in uses:
        notes += [*_gaps(topology, use), *_distances(use)]
    return notes


def _without_z(use: _Use) -> list[str]:
    if use.nodes.grid.dimension == 2 or not use.match.plane:
        return []
    return [
        f"{use.match.label} has two components of the displacement, the grid is three-dimensional: nodes do not move "
        f"in z. Give dz as well; a column of zeros if this is meant"
    ]


def _unused(uses: Sequence[_Use]) -> list[str]:
    """Points of one table that lie on none of the faces that it moves."""
    points, label = uses[0].match.points, uses[0].match.label
    far = np.logical_and.reduce([far_points(points, use.nodes) for use in uses])
    if not far.any():
        return []
    hint = next((text for use in uses if (text := other_frame(points, use.nodes))), "")
    first = int(np.argmax(far))
    text = (
        f"{label}: {int(far.sum())} of {len(points)} table points lie on no face that the table moves, first "
        f"{points[first].tolist()}{hint}"
    )
    partial = any(use.match.partial for use in uses)
    if far.mean() > _MOST and (partial or hint):
        raise MotionError(f"{text}; expected a table of the wall, in the grid's length unit")
    return [text]


def _gaps(topology: Topology, use: _Use) -> list[str]:
    """Moving nodes among others that the table does not move."""
    match, nodes = use.match, use.nodes
    if match.matched.all():
        return []
    local = np.full(topology.n_unique, -1)
    local[nodes.numbers] = np.arange(len(nodes.numbers))
    corners = local[topology.quads.corners[use.quads]]
    inside = match.matched[corners]
    whole, mixed = inside.all(axis=1), inside.any(axis=1) & ~inside.all(axis=1)
    held = np.zeros(len(nodes.numbers), dtype=bool)
    held[corners[whole]] = True
    single = np.flatnonzero(match.matched & ~held)
    count = int(match.matched.sum())
    if single.size:
        text = (
            f"{match.label}: {single.size} of the {count} nodes that it moves belong to no face that moves as a whole, "
            f"first {nodes.label(int(single[0]))}: their neighbours have no match and stay"
            f"{other_frame(match.points, nodes)}. {_remedy(match.how)}"
        )
        if single.size > _MOST * count:
            raise MotionError(text)
        return [text]
    return _abrupt_end(use, corners, whole, mixed)


def _remedy(how: str) -> str:
    if how == "interpolate":
        return "Set a larger tolerance, or use a table that covers the wall"
    return 'Use match = "interpolate", or a table of all nodes of the wall'


def _abrupt_end(use: _Use, corners: IntArray, whole: BoolArray, mixed: BoolArray) -> list[str]:
    """A warning if the motion ends with a jump in the middle of a smooth wall."""
    nodes, match = use.nodes, use.match
    direction = _directions(nodes.points[corners])
    along = np.zeros((len(nodes.points), 3))
    for column in corners.T:
        np.add.at(along, column[whole], direction[whole])
    size = np.linalg.norm(along, axis=1, keepdims=True)
    along /= np.where(size > 0, size, 1.0)
    step = np.linalg.norm(match.displacement, axis=1) * match.matched
    torn = (step > _ABRUPT * nodes.edge)[corners[mixed]]
    smooth = np.einsum("qcd,qd->qc", along[corners[mixed]], direction[mixed]) > _SMOOTH
    found = (torn & smooth).any(axis=1)
    if not found.any():
        return []
    ends = np.unique(corners[mixed][torn & smooth])
    worst = int(ends[np.argmax(step[ends])])
    return [
        f"{match.label}: the motion ends abruptly at {int(found.sum())} faces of a smooth wall, where nodes that move "
        f"by up to {step[worst]:.3g} (at {nodes.label(worst)}) have neighbours without a match, which stay"
    ]


def _directions(points: FloatArray) -> FloatArray:
    """Unit normals (m, 3) of quads (m, 4, 3); unit tangents of 2-D edges (m, 2, 3)."""
    if points.shape[1] == 2:
        vector = points[:, 1] - points[:, 0]
    else:
        vector = np.cross(points[:, 2] - points[:, 0], points[:, 3] - points[:, 1])
    size = np.linalg.norm(vector, axis=1, keepdims=True)
    return np.asarray(vector / np.where(size > 0, size, 1.0))


def _distances(use: _Use) -> list[str]:
    """Warnings about nodes that take the value of a distant point, or that lie beyond the table's surface."""
    match, nodes = use.match, use.nodes
    if match.how == "interpolate":
        out = match.matched & (match.beyond > nodes.edge)
        if not out.any():
            return []
        return [
            f"{match.label}: {int(out.sum())} nodes lie beyond the table, by up to {match.beyond[out].max():.3g}; "
            f"their displacement is extrapolated"
        ]
    off = match.matched & (match.distance > _OFFSET * nodes.edge)
    notes = []
    if off.any():
        notes.append(
            f"{match.label}: {int(off.sum())} of {int(match.matched.sum())} nodes lie up to "
            f"{match.distance[off].max():.3g} away from the table point whose displacement they take "
            f'(match = "{match.how}"); "interpolate" interpolates between the table points'
        )
    taken = match.used[0]
    if match.how == "nearest" and taken < 0.9 * match.matched.sum():
        notes.append(
            f"{match.label}: {int(match.matched.sum())} nodes share the displacements of {taken} table points, "
            f'stepwise; use match = "interpolate"'
        )
    return notes
