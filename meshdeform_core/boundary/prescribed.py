"""The motions of all moving patches as one displacement of the boundary, checked for contradictions."""

from __future__ import annotations

import numpy as np

from ..errors import MotionError
from ..grid import BoolArray, FloatArray, Grid, IntArray
from ..grid.planes import plane_normal
from ..grid.topology import Topology
from ..numerics.arrays import lengths
from ..wording import vector
from .classification import Boundary, Kind


def prescribed_displacement(
    grid: Grid, topology: Topology, boundary: Boundary, time: float = 0.0, fraction: float = 1.0
) -> FloatArray:
    """Displacement (n_unique, 3) of all face nodes: the motion at moving nodes, zero elsewhere. Raises MotionError when
    two moving patches disagree at a shared node, or a 2-D grid would leave its plane."""
    displacement = np.zeros((topology.n_unique, 3))
    owner = np.full(topology.n_unique, -1)
    for index, (nodes, motion) in enumerate(boundary.movers):
        new, before = motion.displacement(time, fraction)[motion.moved], owner[nodes]
        both = np.flatnonzero(before >= 0)
        gap = np.linalg.norm(displacement[nodes[both]] - new[both], axis=1)
        ratio = gap / topology.edge[nodes[both]]
        if (ratio > 1e-6).any():
            worst = both[int(np.argmax(ratio))]
            node = nodes[worst]
            # The motions are those of the moving patches, in the same order.
            names = [repr(patch.name) for patch in boundary.patches if patch.kind is Kind.MOVING]
            one = owner[node]
            remedy = "give both patches the same motion there, or select these nodes in one of them only"
            for table, entry in ((one, index), (index, one)):
                if any(match.partial for match in boundary.movers[table][1].matches):
                    remedy = (
                        f"the table {names[table]} moves all boundary nodes that it matches: to move these nodes by "
                        f"the table, remove the motion of {names[entry]}, or their rows from the table to move them "
                        f"by {names[entry]}"
                    )
            raise MotionError(
                f"moving patches {names[one]} and {names[index]} disagree at their shared node "
                f"{grid.node_label(int(topology.first[node]))}: displacements {vector(displacement[node])} and "
                f"{vector(new[worst])}; {remedy}"
            )
        displacement[nodes] = new
        owner[nodes] = index
    return _completed(grid, boundary, displacement, owner >= 0)


def largest_displacement(displacement: FloatArray) -> float:
    """Largest length of the rows of ``displacement`` (n, 3)."""
    return float(lengths(displacement).max())


def given_displacement(
    grid: Grid, topology: Topology, boundary: Boundary, nodes: IntArray, values: FloatArray
) -> FloatArray:
    """Displacement (n_unique, 3) of all face nodes from that of the unique ``nodes`` (n, 3), zero elsewhere. Raises
    MotionError when a 2-D grid would leave its plane."""
    displacement = np.zeros((topology.n_unique, 3))
    displacement[nodes] = values
    given = np.zeros(topology.n_unique, dtype=bool)
    given[nodes] = True
    return _completed(grid, boundary, displacement, given)


def given_gradient(grid: Grid, boundary: Boundary, nodes: IntArray, gradient: FloatArray) -> FloatArray:
    """Transpose of :func:`given_displacement`: gradients (n, 3) of ``nodes`` from those (n_unique, 3) of all face
    nodes.

    If several periodic images of a node are given, they share its gradient, so that a displacement along the gradient
    moves them alike.
    """
    periodic, normal = boundary.periodic, plane_normal(grid)
    total = gradient.copy()
    if periodic.one.size:
        given = np.zeros(len(gradient), dtype=bool)
        given[nodes] = True
        images, root, turn = periodic.frames(len(gradient))
        home = np.zeros_like(gradient)
        np.add.at(home, root, np.einsum("nji,nj->ni", turn, total[images]))
        moving = given[images]
        count = np.bincount(root[moving], minlength=len(gradient))
        shared = home[root[moving]] / count[root[moving], None]
        total[images[moving]] = np.einsum("nij,nj->ni", turn[moving], shared)
    found = total[nodes]
    return found if normal is None else found - np.outer(found @ normal, normal)


def _completed(grid: Grid, boundary: Boundary, displacement: FloatArray, given: BoolArray) -> FloatArray:
    """The displacement completed at periodic images; in 2-D it must stay in the plane."""
    if boundary.periodic.one.size:
        nodes, root, turn = boundary.periodic.frames(len(displacement))
        moving, home = given[nodes], np.zeros_like(displacement)
        told = np.einsum("nji,nj->ni", turn[moving], displacement[nodes[moving]])
        home[root[moving]] = told
        apart = np.linalg.norm(told - home[root[moving]], axis=1)
        if apart.max(initial=0.0) > 1e-6 * np.abs(displacement).max():
            worst = int(np.argmax(apart))
            raise MotionError(
                f"two periodic images of a node move differently: {vector(told[worst])} and "
                f"{vector(home[root[moving]][worst])} in the frame of the first; give both "
                f"the same motion, or move only one of them"
            )
        image = np.isin(root, root[moving]) & ~moving
        displacement[nodes[image]] = np.einsum("nij,nj->ni", turn[image], home[root[image]])
    normal = plane_normal(grid)
    if normal is not None and np.abs(displacement @ normal).max() > 1e-9 * np.abs(displacement).max():
        raise MotionError(
            f"the motion leaves the plane of the 2-D grid by {np.abs(displacement @ normal).max():.3g}; "
            f"expected displacements normal to {vector(normal)}"
        )
    return displacement
