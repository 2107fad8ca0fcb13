"""The wall that a displacement table fits, where the case does not say which faces the table moves."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy

from ...errors import MotionError
from ...grid import FloatArray, Grid, IntArray
from ...grid.faces.roles import Role
from ...grid.faces.surfaces import Surface, find_outside
from ...grid.topology import Topology
from ...numerics.geometry.vectors import face_sizes
from ...wording import vector
from .frames import other_frame
from .matching import AUTOMATIC, BoundaryNodes, Matching, SurfaceData, spacings
from .tuned import COVERED, ON_BOUNDARY, OWN, POINTS, REACH, SAME_NODE, SAMPLE, SOME, WHOLE


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

    Where ``matching`` is automatic, it is ``nearest`` for tables of the grid's own nodes, else ``interpolate``.

    Raises
    ------
    MotionError
        When most points lie on no outside face; with what would make them, if that is found.
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
        from ...numerics.geometry.surface import TriangleTree

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
    matching = _resolved(grid, topology, mine, points, matching)
    if matching.how != "interpolate":
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


def _resolved(grid: Grid, topology: Topology, quads: IntArray, points: FloatArray, matching: Matching) -> Matching:
    how, tolerance = matching.how, matching.tolerance
    if how == AUTOMATIC:
        nodes = np.unique(topology.quads.corners[quads])
        distance, nearest = scipy.spatial.cKDTree(grid.nodes.at(topology.first[nodes])).query(points)
        own = distance <= (tolerance or SAME_NODE * topology.edge[nodes[nearest]])
        how = "nearest" if own.mean() >= OWN else "interpolate"
    if how == "interpolate" and tolerance is None:
        tolerance = REACH * float(np.linalg.norm(np.ptp(points, axis=0)))
    return replace(matching, how=how, tolerance=tolerance)
