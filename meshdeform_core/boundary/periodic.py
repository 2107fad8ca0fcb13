"""Periodic boundaries: pairs of nodes that move alike."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import CaseError
from ..grid import BoolArray, FloatArray, Grid, IntArray
from ..grid.connections import connected_nodes, periodic_rotation
from ..grid.topology import RELATIVE_TOLERANCE, Topology
from ..numerics.geometry.coincidence import close_pairs


@dataclass(frozen=True)
class Periodic:
    """Pairs of unique nodes that move alike up to a rotation: ``d[two] = rotation @ d[one]``.

    Attributes
    ----------
    one, two : (n,) unique node numbers
    rotation : (n, 3, 3)
    """

    one: IntArray
    two: IntArray
    rotation: FloatArray

    @classmethod
    def none(cls) -> Periodic:
        none = np.empty(0, dtype=np.int64)
        return cls(none, none, np.empty((0, 3, 3)))

    def __add__(self, other: Periodic) -> Periodic:
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        return Periodic(*(np.concatenate(pair) for pair in pairs))

    def frames(self, n_unique: int) -> tuple[IntArray, IntArray, FloatArray]:
        """Periodic nodes, the smallest node in each one's set of images, and the rotation from it.

        Corner nodes have several images; they are found by following the pairs until nothing changes.
        """
        nodes = np.unique(np.r_[self.one, self.two])
        root = np.arange(n_unique)
        turn = np.tile(np.eye(3), (n_unique, 1, 1))
        pairs = (self.one, self.two, self.rotation), (self.two, self.one, self.rotation.transpose(0, 2, 1))
        changed = True
        while changed:
            changed = False
            for source, target, rotation in pairs:
                better = root[source] < root[target]
                if better.any():
                    s, t = source[better], target[better]
                    root[t] = root[s]
                    turn[t] = rotation[better] @ turn[s]
                    changed = True
        return nodes, root[nodes], turn[nodes]

    def constrain(self, displacement: FloatArray, free: BoolArray) -> None:
        """Give all images of a node the mean of their displacements, in place, where they are ``free`` (n_unique,).

        The mean is taken in the frame of one image; the choice of image does not matter.
        """
        if self.one.size == 0:
            return
        nodes, root, turn = self.frames(len(displacement))
        total = np.zeros_like(displacement)
        count = np.zeros(len(displacement))
        np.add.at(total, root, np.einsum("nji,nj->ni", turn, displacement[nodes]))
        np.add.at(count, root, 1.0)
        mean = np.einsum("nij,nj->ni", turn, total[root] / count[root, None])
        displacement[nodes[free[nodes]]] = mean[free[nodes]]


def periodic_pairs(grid: Grid, topology: Topology, one: IntArray, two: IntArray, owner: str) -> Periodic:
    """Pair the unique nodes ``one`` and ``two`` of the sides of a periodic boundary by the translation or rotation that
    maps one onto the other. Raises CaseError when no translation, and no rotation about a coordinate axis, does."""
    p, q = grid.nodes.at(topology.first[one]), grid.nodes.at(topology.first[two])
    centers = p.mean(axis=0), q.mean(axis=0)
    changes = [(np.eye(3), centers[1] - centers[0])]
    for axis in range(3):
        # Rotation about this axis through the origin that maps one centroid onto the other.
        a, b = (axis + 1) % 3, (axis + 2) % 3
        before, after = (np.arctan2(center[b], center[a]) for center in centers)
        cos, sin = np.cos(after - before), np.sin(after - before)
        rotation = np.eye(3)
        rotation[[a, a, b, b], [a, b, a, b]] = [cos, -sin, sin, cos]
        changes.append((rotation, np.zeros(3)))
    tolerance = np.r_[topology.edge[one], topology.edge[two]] * RELATIVE_TOLERANCE
    for rotation, shift in changes if len(one) == len(two) else []:
        pairs = np.sort(close_pairs(np.concatenate([p @ rotation.T + shift, q]), tolerance), axis=1)
        pairs = pairs[(pairs[:, 0] < len(one)) & (pairs[:, 1] >= len(one))]
        if len(pairs) == len(one):
            matched = two[pairs[:, 1] - len(one)]
            return Periodic(one[pairs[:, 0]], matched, np.tile(rotation, (len(one), 1, 1)))
    raise CaseError(
        f"boundary {owner!r}: its two periodic sides ({len(one)} and {len(two)} nodes) do not match by a translation "
        f"or by a rotation about a coordinate axis; expected select = [one side, other side] with equal node layouts"
    )


def find_periodicity(grid: Grid, topology: Topology, name: str, quads: IntArray, sides: Sequence[IntArray]) -> Periodic:
    """Pairs of one periodic boundary with these face ``quads``: as declared in the file, otherwise by matching its two
    ``sides``, the quads of its ``select`` patterns. Raises CaseError when the file declares nothing and there are not
    two sides that match."""
    nodes = np.unique(topology.quads.corners[quads])
    declared = Periodic.none()
    for connection in grid.connections:
        if connection.periodic is not None:
            own, donor = (topology.numbers_of(flat) for flat in connected_nodes(grid, connection))
            inside = np.isin(own, nodes) & np.isin(donor, nodes)
            rotation = np.tile(periodic_rotation(connection.periodic), (int(inside.sum()), 1, 1))
            declared += Periodic(own[inside], donor[inside], rotation)
    if np.isin(nodes, np.r_[declared.one, declared.two]).all():
        return declared
    if len(sides) != 2:
        raise CaseError(
            f"boundary {name!r} is periodic but has {len(sides)} select patterns, and the file declares no "
            f"periodic connection for them; expected select = [one side, other side]"
        )
    one, two = (np.unique(topology.quads.corners[np.intersect1d(quads, side)]) for side in sides)
    return periodic_pairs(grid, topology, one, two, name)
