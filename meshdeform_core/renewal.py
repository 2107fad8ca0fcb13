"""A new interior for a grid whose boundary is given: the original is deformed again, ignoring the old interior."""

from __future__ import annotations

import dataclasses

import numpy as np

from .boundary import Boundary, Kind
from .boundary.classification import ClassifiedPatch
from .boundary.motions.motion import GIVEN
from .boundary.tables.matching import BoundaryNodes
from .deform import Result, Timing, impose
from .grid import FloatArray, Grid
from .grid.topology import Topology
from .memory import MemoryLimit
from .methods import Progress
from .numerics.geometry.coincidence import distinct
from .overset import undeformed_of
from .setup import Case, Setup


def renewed(
    grid: Grid,
    original: Grid,
    placed: tuple[Topology, Boundary],
    case: Case,
    precision: str,
    memory: MemoryLimit,
    progress: Progress | None = None,
) -> Result | None:
    """Deform ``original`` so that nodes of moving and fixed boundaries take their positions in ``grid``, to the bit.

    ``placed`` are topology and boundary classified by the case. Faces count as moving where such nodes have moved, and
    as fixed elsewhere. Returns ``None`` if none has moved.
    """
    topology, boundary = placed
    change = np.where(boundary.known[:, None], (grid.points - original.points)[topology.first], 0.0)
    moved = np.asarray(change.any(axis=1))
    if not moved.any():
        return None
    moving = _moving_where(original, topology, boundary, moved)
    setup = Setup(undeformed_of(original, topology, moving, memory, case.repair.min_jacobian), case, ())
    result = impose(setup, lambda fraction: fraction * change, None, precision, Timing(progress=progress), progress)
    points: FloatArray = np.array(result.grid.points)
    held = topology.face_nodes[boundary.known[topology.number]]
    points[held] = grid.points[held]
    return dataclasses.replace(result, grid=original.moved(points))


def _moving_where(grid: Grid, topology: Topology, boundary: Boundary, moved: np.ndarray) -> Boundary:
    """The boundary with faces that have ``moved`` nodes (n_unique,) moving, and other moving or fixed faces fixed."""
    known = boundary.quad_kind >= Kind.FIXED
    moving = known & moved[topology.quads.corners].any(axis=1)
    quad_kind = np.where(moving, Kind.MOVING, np.where(known, Kind.FIXED, boundary.quad_kind)).astype(np.int8)
    kind = np.where(boundary.known, Kind.FIXED, boundary.kind).astype(np.int8)
    quads = np.flatnonzero(moving)
    numbers = distinct(topology.quads.corners[quads], topology.n_unique)
    kind[numbers] = Kind.MOVING
    kind[moved] = Kind.MOVING
    rest = np.flatnonzero(known & ~moving)
    patches = (
        ClassifiedPatch("moved", Kind.MOVING, numbers, quads),
        ClassifiedPatch("at rest", Kind.FIXED, distinct(topology.quads.corners[rest], topology.n_unique), rest),
        *(patch for patch in boundary.patches if patch.kind < Kind.FIXED),
    )
    movers = ((numbers, GIVEN.prepare(BoundaryNodes.of_quads(grid, topology, quads))),)
    return dataclasses.replace(boundary, kind=kind, quad_kind=quad_kind, patches=patches, movers=movers)
