"""A solver's surface and nodes found again on the grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from meshdeform_core.errors import GridError, MotionError
from meshdeform_core.grid import BoolArray, FloatArray, Grid, IntArray
from meshdeform_core.grid.topology import RELATIVE_TOLERANCE, Topology
from meshdeform_core.wording import vector


@dataclass(frozen=True)
class Definition:
    """The surface that a solver defines.

    Attributes
    ----------
    points : (n, 3) undeformed; points may repeat
    faces : (n_faces, 4) their corners; triangles repeat the last one
    zone : (n_faces,) number of the zone from 0; -1 if not given
    """

    points: FloatArray
    faces: IntArray
    zone: IntArray

    @classmethod
    def of(cls, points: ArrayLike, conn: ArrayLike, sizes: ArrayLike, zones: ArrayLike | None) -> Definition:
        """From the arguments of ``setSurfaceDefinition``.

        Raises
        ------
        MotionError
            When shapes or numbers contradict each other.
        """
        pts = np.array(points, dtype=np.float64).reshape(-1, 3)
        count, flat = np.asarray(sizes, dtype=np.int64).ravel(), np.asarray(conn, dtype=np.int64).ravel()
        if not np.isin(count, (3, 4)).all() or count.sum() != len(flat):
            raise MotionError(
                f"faceSizes sum up to {count.sum()}, conn has {len(flat)} entries; expected faces of 3 or 4 corners"
            )
        if len(flat) and (flat.min() < 0 or flat.max() >= len(pts)):
            raise MotionError(f"conn has {flat.min()} to {flat.max()}; expected 0 to {len(pts) - 1}, rows of pts")
        last = np.cumsum(count) - 1
        at = np.minimum((last - count + 1)[:, None] + np.arange(4), last[:, None])
        if zones is None:
            zone = np.full(len(count), -1)
        else:
            zone = np.asarray(zones, dtype=np.int64).ravel() - 1
        if len(zone) != len(count):
            raise MotionError(f"{len(zone)} cgnsBlockIDs for {len(count)} faces; expected one each")
        return cls(pts, flat[at], zone)


def match(
    grid: Grid, topology: Topology, definition: Definition, candidates: IntArray
) -> tuple[BoolArray, IntArray, tuple[IntArray, IntArray]]:
    """Find the faces ``candidates`` of a definition among the outside faces of a grid.

    Returns which faces (n_faces,) were found, their face quads, ascending, and pairs: the points of these faces with
    their unique nodes. Points match nodes closer than ``RELATIVE_TOLERANCE`` times the shortest edge there.
    """
    outside = np.flatnonzero(topology.external)
    nodes = np.unique(topology.quads.corners[outside])
    points = np.unique(definition.faces[candidates])
    distance, nearest = cKDTree(grid.points[topology.first[nodes]]).query(definition.points[points])
    node = np.full(len(definition.points), -1, dtype=np.int64)
    node[points] = nodes[nearest]
    node[points[distance > RELATIVE_TOLERANCE * topology.edge[node[points]]]] = -1
    corners = node[definition.faces[candidates]]
    known = (corners >= 0).all(axis=1)
    keys = _keys(np.concatenate([corners[known], topology.quads.corners[outside]]))
    asked, offered = keys[: known.sum()], keys[known.sum() :]
    found = np.zeros(len(definition.faces), dtype=bool)
    found[candidates[known]] = np.isin(asked, offered)
    used = np.unique(definition.faces[found])
    return found, outside[np.isin(offered, asked)], (used, node[used])


def _keys(corners: IntArray) -> IntArray:
    """A number for each set of corners (n, 4), equal for equal sets."""
    ordered = np.sort(corners, axis=1)
    repeated = np.zeros(ordered.shape, dtype=bool)
    repeated[:, 1:] = ordered[:, 1:] == ordered[:, :-1]
    ordered[repeated] = -1
    return np.asarray(np.unique(np.sort(ordered, axis=1), axis=0, return_inverse=True)[1]).ravel()


def require_found(definition: Definition, times: IntArray) -> None:
    """Require that every face lies on exactly one grid.

    Raises
    ------
    GridError
        Stating the number of faces that were not found, or found on several components.
    """
    for number, what, advice in (
        (0, "are not faces on the outside of the grid", "the undeformed surface of the same grid, in its length unit"),
        (2, "lie on several components", "cgnsBlockIDs, which tell the zone of each face"),
    ):
        bad = np.flatnonzero(np.minimum(times, 2) == number)
        if bad.size:
            center = definition.points[definition.faces[bad[0]]].mean(axis=0)
            raise GridError(
                f"{bad.size:,} of {len(times):,} faces of the surface {what}, the first around "
                f"{vector(center)}; expected {advice}"
            )


def rows_of_file(grid: Grid, numbers: IntArray) -> IntArray:
    """Rows of ``grid.points`` of nodes (n,) numbered in the order of the file, i fastest in each zone."""
    zone = np.searchsorted(grid.offsets, numbers, side="right") - 1
    ni, nj, nk = np.asarray(grid.shapes, dtype=np.int64).T
    k, rest = np.divmod(numbers - grid.offsets[zone], (ni * nj)[zone])
    j, i = np.divmod(rest, ni[zone])
    return np.asarray(grid.offsets[zone] + (i * nj[zone] + j) * nk[zone] + k)


def rows_of_freedoms(grid: Grid, indices: ArrayLike) -> IntArray:
    """Rows of ``grid.points`` from degrees of freedom (3 n,): three, x y z, for every node.

    Raises
    ------
    GridError
        When they are not whole numbers, not x, y and z of one node after another, or beyond the grid.
    """
    freedoms = np.asarray(indices)
    if freedoms.size == 0:
        return np.empty(0, dtype=np.int64)
    if freedoms.ndim != 1 or freedoms.dtype.kind not in "iu" or len(freedoms) % 3:
        raise GridError(
            f"indices are {freedoms.shape} {freedoms.dtype}; expected whole numbers (3 n,): x, y, z of n nodes"
        )
    nodes = freedoms[::3].astype(np.int64) // 3
    if not np.array_equal(freedoms.reshape(-1, 3), 3 * nodes[:, None] + np.arange(3)):
        raise GridError("indices are not x, y, z (3 m, 3 m + 1, 3 m + 2) of one node after another")
    if nodes.min() < 0 or nodes.max() >= grid.n_nodes:
        raise GridError(
            f"indices of the nodes {nodes.min()} to {nodes.max()}; the grid has {grid.n_nodes}, numbered from 0"
        )
    return rows_of_file(grid, nodes)
