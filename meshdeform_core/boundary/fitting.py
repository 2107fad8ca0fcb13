"""Whether a displacement table belongs to a grid, and which walls it moves: the wall that it fits where the case does
not say; units, unused points, gaps and extrapolation of tables in use.

A table of the grid must be accepted whether its points are nodes or lie between them; a table in another unit, order or
frame must be refused with the reason. The tables to be distinguished are in ``tests/core/test_tables.py``,
``tests/core/test_tables.py`` and ``tests/core/test_early_warnings.py``; after changing a threshold, run all
three.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from ..errors import MotionError
from ..grid import Grid, IntArray
from ..grid.faces import Role, Surface, find_outside
from ..grid.topology import Topology
from ..numerics.geometry.vectors import doubled_areas, face_sizes, unit
from ..wording import Notice, counted, vector
from .frames import other_frame
from .motions.motion import PreparedMotion
from .tables import AUTOMATIC, BoundaryNodes, Matching, SurfaceData, Transfer, spacings

# Which surfaces of the grid a table lies on

SAMPLE = 5000
"""Largest number of the table's points that are located on the boundary."""
ON_BOUNDARY = 0.5
"""A table with a smaller share of its points on the boundary is refused: it belongs to another grid."""
POINTS = 0.5
"""A surface belongs to the table if at least this share of the table's points lies on it, ..."""
COVERED = 0.5
"""... or if the table covers at least this share of its area."""
SOME = 0.1
"""If there is no such surface: those with at least this fraction of the number of points on the best one."""
WHOLE = 0.9
"""A surface whose guessed role is not a wall counts as a wall if the table covers this share of its area."""

# Which nodes follow it, and how

OWN, SAME_NODE = 0.9, 1e-3
"""A table holds nodes of the grid if this share of its points lies on nodes, within this fraction of the shortest edge
there."""
REACH = 0.1
"""Nodes of the walls farther from a table than this fraction of its diagonal do not follow it."""
ASTRAY = 0.5
"""A table is refused, if there is reason to think that it belongs elsewhere, when more than this fraction of its points
lies off the walls that it moves, or of the nodes that it moves belongs to no face all of whose nodes move."""
OFFSET = 0.1
"""Matched points farther away than this fraction of the shortest edge are reported as not on the wall."""
SMOOTH = 0.85
"""Faces whose normals have at least this cosine belong to one smooth surface."""
ABRUPT = 1e-2
"""A jump of the displacement by more than this fraction of the shortest edge tears the wall."""


@dataclass(frozen=True)
class Fit:
    """Surfaces that a table fits, how it is matched, and the face quads (n,) that follow it.

    ``quads`` is ``None`` for a table of nodes: it moves the nodes that it matches, on whatever face.
    """

    surfaces: tuple[Surface, ...]
    quads: IntArray | None
    matching: Matching


def fit_table(grid: Grid, topology: Topology, data: SurfaceData, matching: Matching) -> Fit:
    """The outside surfaces on which a table lies, by distance relative to their faces.

    Where ``matching`` is automatic, it is ``nearest`` for tables of the grid's own nodes, else ``interpolate``. Raises
    MotionError when most points lie on no outside face; with what would make them, if that is found.
    """
    surfaces = find_outside(grid, topology).surfaces
    points = data.points[:: max(1, len(data.points) // SAMPLE)]
    owner = np.repeat(np.arange(len(surfaces)), [len(surface.quads) for surface in surfaces])
    quads = np.concatenate([np.empty(0, dtype=np.int64), *(surface.quads for surface in surfaces)])
    corners = grid.nodes.at(topology.first[topology.quads.corners[quads]])
    center, reach = corners.mean(axis=1), np.linalg.norm(np.ptp(corners, axis=1), axis=1)
    distance, nearest = scipy.spatial.cKDTree(center).query(points)
    on = distance <= reach[nearest]
    if on.mean() < ON_BOUNDARY:
        hint = other_frame(data.points, BoundaryNodes.of_quads(grid, topology, quads))
        whole_table = len(on) == len(data.points)
        how_many = f"{int((~on).sum())} of {len(on)}" if whole_table else f"{1 - on.mean():.0%} of {len(data.points)}"
        raise MotionError(
            f"{data.label}: {how_many} table points lie on no outside face of the grid, first "
            f"{vector(points[int(np.argmin(on))])}{hint}; expected a table of the wall, in the grid's length unit"
        )
    votes = np.bincount(owner[nearest[on]], minlength=len(surfaces)) / len(points)
    size = face_sizes(corners)
    whole = np.bincount(owner, size, minlength=len(surfaces))
    # Faces within their size of the table's triangles, or within the spacing of its points of one of them.
    tree = scipy.spatial.cKDTree(points)
    away, beside = tree.query(center)
    is_under = away <= np.maximum(reach, spacings(tree)[beside])
    if len(data.triangles):
        from ..numerics.geometry.surface import TriangleTree

        is_under |= TriangleTree(data.points, data.triangles).closest(center)[2] <= reach
    under = np.bincount(owner, size * is_under, minlength=len(surfaces))
    covered = np.divide(under, whole, out=np.zeros_like(whole), where=whole > 0)
    chosen = (votes >= POINTS) | (covered >= COVERED)
    if not chosen.any():
        chosen = votes >= SOME * votes.max()
    # The rim of a wall also lies on symmetry and end planes. A guessed role may be wrong where the table covers all.
    walls = chosen & np.array(
        [
            surface.role in (Role.WALL, Role.UNKNOWN) or (not surface.declared and part >= WHOLE)
            for surface, part in zip(surfaces, covered, strict=True)
        ]
    )
    chosen = walls if walls.any() else chosen
    mine = quads[chosen[owner]]
    found = tuple(surface for surface, taken in zip(surfaces, chosen, strict=True) if taken)
    _require_wall(grid, topology, data, found, surfaces)
    how, tolerance = matching.how, matching.tolerance
    if how == AUTOMATIC:
        nodes = np.unique(topology.quads.corners[mine])
        distance, nearest = scipy.spatial.cKDTree(grid.nodes.at(topology.first[nodes])).query(points)
        own = distance <= (tolerance or SAME_NODE * topology.edge[nodes[nearest]])
        how = "nearest" if own.mean() >= OWN else "interpolate"
    if how == "interpolate" and tolerance is None:
        tolerance = REACH * float(np.linalg.norm(np.ptp(points, axis=0)))
    matching = replace(matching, how=how, tolerance=tolerance)
    if how != "interpolate":
        return Fit(found, None, matching)
    return Fit(found, mine, replace(matching, walls=tuple(surface.name for surface in found)))


def _require_wall(
    grid: Grid, topology: Topology, data: SurfaceData, found: tuple[Surface, ...], surfaces: tuple[Surface, ...]
) -> None:
    """Refuse a table on a symmetry plane, or on the far field if it would lie on a wall in another frame."""
    walls = [surface.quads for surface in surfaces if surface.role is Role.WALL]
    if not walls or any(surface.role in (Role.WALL, Role.UNKNOWN) for surface in found):
        return
    hint = other_frame(data.points, BoundaryNodes.of_quads(grid, topology, np.concatenate(walls)))
    if hint or all(surface.role is Role.SYMMETRY for surface in found):
        places = ", ".join(f"{surface.name!r} ({surface.role.value})" for surface in found)
        raise MotionError(
            f"{data.label}: its points lie on {places}{hint}; expected a table of a wall; "
            f"a face that is meant to move is selected in a case file"
        )


@dataclass(frozen=True)
class _Use:
    """A table as one boundary entry uses it; ``place`` identifies it within its entry: all of a sequence share one."""

    match: Transfer
    nodes: BoundaryNodes
    place: str

    def notice(self, what: str, text: str) -> Notice:
        """A warning about the table."""
        return Notice(f"{self.match.label}{text}", f"{what} of {self.place}")


class Tables:
    """The displacement tables of the motions of all moving boundary entries; those of a sequence change with time."""

    def __init__(self, motions: Sequence[PreparedMotion]):
        self._motions = motions
        self._checked: list[Transfer] = []
        self._found: list[Notice] = []

    def warnings(self) -> list[Notice]:
        """Warnings about the tables now in use and the walls that they move. Raises MotionError when most of a table
        lies off the walls, or it moves single nodes among others that remain at rest."""
        uses = [
            _Use(match, motion.nodes, f"table {number} of entry {entry}")
            for entry, motion in enumerate(self._motions)
            for number, match in enumerate(motion.matches)
        ]
        matches = [use.match for use in uses]
        if len(matches) == len(self._checked) and all(a is b for a, b in zip(matches, self._checked, strict=True)):
            return self._found
        tables: dict[tuple[str, int, float], list[_Use]] = {}
        for use in uses:
            points = use.match.points
            if len(points):
                tables.setdefault((use.match.label, len(points), float(points.sum())), []).append(use)
        self._found = [
            *(notice for table in tables.values() for notice in _whole_table(table)),
            *(notice for use in uses for notice in (*_gaps(use), *_distances(use))),
        ]
        self._checked = matches
        return self._found


def _whole_table(uses: Sequence[_Use]) -> Iterator[Notice]:
    """A table without the third component of displacements, and points that lie on none of the faces that it moves."""
    first, points = uses[0], uses[0].match.points
    if first.nodes.grid.dimension == 3 and first.match.plane:
        text = (
            " has two components of the displacement, the grid is three-dimensional: nodes do not move in z. "
            "Give dz as well; a column of zeros if this is meant"
        )
        yield first.notice("missing z", text)
    far = np.ones(len(points), dtype=bool)
    for use in uses:
        # Farther from every node than the longest face edge there.
        distance, nearest = scipy.spatial.cKDTree(use.nodes.points).query(points)
        far &= distance > use.nodes.longest[nearest]
    if not far.any():
        return
    hint = next((text for use in uses if (text := other_frame(points, use.nodes))), "")
    text = (
        f": {int(far.sum())} of {len(points)} table points lie on no face that the table moves, first "
        f"{vector(points[int(np.argmax(far))])}{hint}"
    )
    if far.mean() > ASTRAY and (hint or any(use.match.matching.partial for use in uses)):
        raise MotionError(f"{first.match.label}{text}; expected a table of the wall, in the grid's length unit")
    yield first.notice("unused points", text)


def _gaps(use: _Use) -> Iterator[Notice]:
    """Moving nodes among others that the table does not move; or a motion that ends with a jump on a smooth wall."""
    match, nodes = use.match, use.nodes
    inside = match.matched[nodes.faces]
    whole = np.all(inside, axis=1)
    mixed = np.any(inside, axis=1) & ~whole
    held = np.zeros(len(nodes.numbers), dtype=bool)
    held[nodes.faces[whole]] = True
    single = np.flatnonzero(match.matched & ~held)
    if single.size:
        count, remedy = int(match.matched.sum()), 'Use match = "interpolate", or a table of all nodes of the wall'
        if match.how == "interpolate":
            remedy = "Set a larger tolerance, or use a table that covers the wall"
        text = (
            f": {single.size} of the {count} nodes that it moves belong to no face that moves as a whole, "
            f"first {nodes.label(int(single[0]))}: their neighbours have no match and do not move"
            f"{other_frame(match.points, nodes)}. {remedy}"
        )
        if single.size > ASTRAY * count:
            raise MotionError(f"{match.label}{text}")
        yield use.notice("single nodes", text)
        return
    # Does the motion end with a jump in the middle of a smooth wall?
    x, corners = nodes.points[nodes.faces], nodes.faces[mixed]
    # Normals of faces; tangents of 2-D edges.
    direction = unit(x[:, 1] - x[:, 0] if x.shape[1] == 2 else doubled_areas(x))
    along = unit(nodes.summed(direction * whole[:, None]))
    step = np.linalg.norm(match.displacement, axis=1) * match.matched
    smooth = np.einsum("qcd,qd->qc", along[corners], direction[mixed]) > SMOOTH
    torn = (step > ABRUPT * nodes.edge)[corners] & smooth
    if torn.any():
        worst = int(corners[torn][np.argmax(step[corners[torn]])])
        text = (
            f": the motion ends abruptly at {counted(int(torn.any(axis=1).sum()), 'face')} of a smooth wall, where "
            f"nodes that move by up to {step[worst]:.3g} (at {nodes.label(worst)}) have neighbours without a match, "
            f"which do not move"
        )
        yield use.notice("abrupt end", text)


def _distances(use: _Use) -> Iterator[Notice]:
    """Nodes that take the value of a distant point, or that lie beyond the table's surface."""
    match, nodes = use.match, use.nodes
    out = match.matched & (match.beyond > nodes.edge)
    if match.how == "interpolate" and out.any():
        text = (
            f": {int(out.sum()):,} nodes lie beyond the table, by up to {match.beyond[out].max():.3g}; their "
            f"displacement is extrapolated"
        )
        yield use.notice("extrapolation", text)
    off = match.matched & (match.distance > OFFSET * nodes.edge)
    if match.how != "interpolate" and off.any():
        text = (
            f": {int(off.sum())} of {int(match.matched.sum())} nodes lie up to {match.distance[off].max():.3g} away "
            f'from the table point whose displacement they take (match = "{match.how}"); "interpolate" interpolates '
            f"between the table points"
        )
        yield use.notice("distance", text)
