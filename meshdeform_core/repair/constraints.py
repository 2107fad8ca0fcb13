"""Constraints that a repair must respect: held nodes, sliding planes, periodic images that move alike."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..boundary import Boundary, Kind
from ..grid import BoolArray, FloatArray, Grid, IntArray
from ..grid.topology import Topology


@dataclass(frozen=True, eq=False)
class Constraints:
    """Constraints on the unique nodes of a grid.

    Attributes
    ----------
    grid, topology : undeformed
    held : (n_unique,) nodes that stay where they are: moving, fixed, and those on curved slip surfaces
    walls : (n_unique,) moving nodes
    removed : (n_unique, 3, 3) projectors on the directions in which a node must not move
    root : (n_unique,) the smallest of the periodic images of a node, which has the unknown of all of them
    turn : node -> rotation (3, 3) from its root, where that is not the identity
    """

    grid: Grid
    topology: Topology
    held: BoolArray
    walls: BoolArray
    removed: FloatArray
    root: IntArray
    turn: dict[int, FloatArray] = field(default_factory=dict)

    @classmethod
    def of(cls, grid: Grid, topology: Topology, boundary: Boundary) -> Constraints:
        """The constraints of a classified boundary."""
        held = boundary.kind >= Kind.FIXED
        for surface in boundary.slip.curved:
            held[surface.nodes] = True
        root, turn = np.arange(topology.n_unique), {}
        if boundary.periodic.one.size:
            nodes, roots, turns = boundary.periodic.frames(topology.n_unique)
            root[nodes] = roots
            turn = dict(zip(nodes.tolist(), turns, strict=True))
        removed = np.zeros((topology.n_unique, 3, 3))
        for nodes, projector in boundary.slip.groups:
            removed[nodes] += projector
        for node, rotation in turn.items():
            if root[node] != node:
                removed[root[node]] += rotation.T @ removed[node] @ rotation
        several = np.flatnonzero(np.einsum("nii->n", removed) > 1.5)
        removed[several] = _spans(removed[several])
        return cls(grid, topology, held, boundary.kind == Kind.MOVING, removed, root, turn)


def _spans(sums: FloatArray) -> FloatArray:
    """Projectors on the spans of sums of projectors (n, 3, 3); along axes there is no round-off."""
    values, vectors = np.linalg.eigh(sums)
    kept = np.where(values[:, None, :] > 1e-9, vectors, 0.0)
    exact = np.abs(sums - np.round(sums)).max(axis=(1, 2), initial=0.0) < 1e-12
    spans = np.asarray(kept @ kept.transpose(0, 2, 1))
    spans[exact] = np.round(spans[exact])
    return spans
