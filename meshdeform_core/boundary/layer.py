"""Grids of one layer of cells whose two end planes mirror each other: a straight extrusion, or a wedge.

Where the motion of the boundary is mirrored, too, so is that of all nodes: a straight extrusion that moves in its
plane, a wedge that moves along its planes. Nodes of one plane are then computed, and those of the other follow them to
the last bit, whatever the errors of approximated sums.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..grid import FloatArray, Grid, IntArray, Side
from ..grid.planes import FLATNESS, snapped
from ..grid.topology import Topology
from ..grid.windows import end_planes, side_numbers
from ..numerics.arrays import lengths
from .classification import Boundary

_ALIKE = 1e-9
"""Largest difference of mirrored displacements, relative to the largest displacement."""


@dataclass(frozen=True)
class Layer:
    """Pairs of nodes (n, 2) of which the second is the mirror image of the first, by unique numbers.

    ``free`` are those whose displacement is sought, ``known`` those of sources; ``normal`` is that of the plane between
    the two, ``middle`` (k,) are nodes in it, such as those on the axis of a wedge.
    """

    free: IntArray
    known: IntArray
    middle: IntArray
    normal: FloatArray

    @property
    def followers(self) -> IntArray:
        """The nodes that follow others."""
        return np.asarray(self.free[:, 1])

    def follow(self, displacement: FloatArray) -> None:
        """Give the followers, in place, the mirrored displacement (n_unique, 3) of those that they follow."""
        displacement[self.followers] = self._mirrored(displacement[self.free[:, 0]])
        own = displacement[self.middle]
        displacement[self.middle] = 0.5 * (own + self._mirrored(own))

    def mirrors(self, displacement: FloatArray) -> bool:
        """Whether the displacement (n_unique, 3) of the sources is mirrored."""
        one, two = displacement[self.known[:, 0]], displacement[self.known[:, 1]]
        largest = float(lengths(displacement).max(initial=0.0))
        return bool(np.abs(two - self._mirrored(one)).max(initial=0.0) <= _ALIKE * largest)

    def _mirrored(self, vectors: FloatArray) -> FloatArray:
        return np.asarray(vectors - np.outer(2.0 * (vectors @ self.normal), self.normal))


def find_layer(grid: Grid, topology: Topology, boundary: Boundary) -> Layer | None:
    """The layer that a grid consists of; ``None`` if it is thicker, or its planes do not mirror each other."""
    sides = end_planes(grid, topology)
    if not sides:
        return None
    planes = [[side_numbers(grid, topology, n // 6, Side(n % 6)).ravel() for n in sides[end::2]] for end in (0, 1)]
    pairs = np.unique(np.stack([np.concatenate(plane) for plane in planes], axis=1), axis=0)
    x = grid.nodes.at(topology.first)
    across = x[pairs[:, 1]] - x[pairs[:, 0]]
    longest = across[int(np.argmax(lengths(across)))]
    normal = snapped(longest[None] / np.linalg.norm(longest))[0]
    pairs = np.where((across @ normal < 0.0)[:, None], pairs[:, ::-1], pairs)
    one, two = x[pairs[:, 0]], x[pairs[:, 1]]
    thickness, middle = (two - one) @ normal, 0.5 * (one + two) @ normal
    off = np.abs(two - one - np.outer(thickness, normal)).max(), np.ptp(middle)
    if max(off) > FLATNESS * float(np.ptp(x, axis=0).max()):
        return None
    same = pairs[:, 0] == pairs[:, 1]
    middle, pairs = pairs[same, 0], np.unique(pairs[~same], axis=0)
    kind = boundary.kind[pairs]
    if len(np.unique(pairs)) < pairs.size or (kind[:, 0] != kind[:, 1]).any():
        return None
    known = boundary.known[pairs[:, 1]]
    free = middle[~boundary.known[middle]]
    return None if known.all() else Layer(pairs[~known], pairs[known], free, normal)
