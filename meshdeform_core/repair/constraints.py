"""Constraints of a repair: nodes that are held, that slide in planes or on surfaces, or that are periodic images."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ..boundary import Boundary, Kind
from ..boundary.slip import CurvedSurface
from ..grid import BoolArray, FloatArray, Grid, IntArray
from ..grid.topology import Topology
from ..quality import Original


@dataclass(frozen=True, eq=False)
class Constraints:
    """Constraints on the unique nodes of a grid.

    Attributes
    ----------
    grid, topology : undeformed
    held : (n_unique,) nodes that repairs do not move: moving, fixed, and those at edges of curved slip surfaces
    walls : (n_unique,) nodes of moving and fixed faces that are likely to be walls, not far field
    removed : (n_unique, 3, 3) projectors onto the directions in which a node must not move
    root : (n_unique,) the periodic image of a node with the smallest number, whose unknown all images share
    turn : node -> rotation (3, 3) from its root, unless that is the identity
    sliding : curved surfaces with the nodes that are not held
    """

    grid: Grid
    topology: Topology
    held: BoolArray
    walls: BoolArray
    removed: FloatArray
    root: IntArray
    turn: dict[int, FloatArray] = field(default_factory=dict)
    sliding: tuple[CurvedSurface, ...] = ()

    def without_sliding(self) -> Constraints:
        """The constraints with the nodes that slide on curved surfaces held instead."""
        held = self.held.copy()
        for each in self.sliding:
            held[each.nodes] = True
        return replace(self, held=held, sliding=())

    @classmethod
    def of(cls, original: Original, boundary: Boundary) -> Constraints:
        """The constraints of a classified boundary."""
        grid, topology = original.grid, original.topology
        held = boundary.kind >= Kind.FIXED
        root, turn = np.arange(topology.n_unique), {}
        # A node may slide if it is on a single curved surface and on no plane or periodic boundary.
        count = np.zeros(topology.n_unique, dtype=np.int64)
        for surface in boundary.slip.curved:
            count[surface.nodes] += 1
        for nodes, _ in boundary.slip.groups:
            count[nodes] += 2
        if boundary.periodic.one.size:
            nodes, roots, turns = boundary.periodic.frames(topology.n_unique)
            root[nodes] = roots
            turn = dict(zip(nodes.tolist(), turns, strict=True))
            count[nodes] += 2
        sliding = []
        for surface in boundary.slip.curved:
            held[surface.nodes] |= count[surface.nodes] > 1
            held[surface.corners[surface.creased]] = True
            sliding.append(replace(surface, nodes=surface.nodes[~held[surface.nodes]]))
        removed = np.zeros((topology.n_unique, 3, 3))
        for nodes, projector in boundary.slip.groups:
            removed[nodes] += projector
        for node, rotation in turn.items():
            if root[node] != node:
                removed[root[node]] += rotation.T @ removed[node] @ rotation
        several = np.flatnonzero(np.einsum("nii->n", removed) > 1.5)
        # Projectors (n, 3, 3) onto the ranges of sums of projectors; exact if these are along coordinate axes.
        sums = removed[several]
        values, vectors = np.linalg.eigh(sums)
        kept = np.where(values[:, None, :] > 1e-9, vectors, 0.0)
        exact = np.abs(sums - np.round(sums)).max(axis=(1, 2), initial=0.0) < 1e-12
        spans = np.asarray(kept @ kept.transpose(0, 2, 1))
        spans[exact] = np.round(spans[exact])
        removed[several] = spans
        quads = original.moving_wall_quads(boundary) | original.fixed_wall_quads(boundary)
        walls = np.zeros(topology.n_unique, dtype=bool)
        walls[topology.quads.corners[quads]] = True
        return cls(grid, topology, held, walls, removed, root, turn, tuple(sliding))
