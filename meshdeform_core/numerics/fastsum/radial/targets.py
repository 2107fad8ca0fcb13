"""Targets of radial sums: trees of the requested nodes of every block, in regions."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ....parallel import Nodes
from ...arrays import FloatArray, IntArray, Shapes
from ..clusters.target_tree import TargetTree, build_target_tree
from ..clusters.targets import node_sizes, sample_places, shape_table
from ..tuned import CAPACITY, TERMS
from .polynomials import Spaces, spaces_of

# Leading singular term of each function at the origin: power of the distance, and size relative to that of r^2 log r.
_SINGULAR = {0: (2.0, 1.0), 1: (1.0, 0.5), 2: (3.0, 15.0), 3: (2.0, 20.0), 4: (3.0, 60.0), 5: (4.0, 60.0)}


class RadialTargets(NamedTuple):
    """Target nodes in trees, and where the accuracy of each leaf is judged.

    Attributes
    ----------
    coordinates : (n_nodes, 3) array, or one in parts
    tree : of the targets
    leaves : (b,) tree nodes that are leaves and hold targets
    places : (b, 9) positions in the tree's list of targets, spread over each leaf
    samples : (b, 9) the targets at these positions
    sizes : (b, 9) length of the shortest edge at each sample
    spaces : polynomial spaces, and the number (m,) of the space of each tree node's box
    """

    coordinates: Any
    tree: TargetTree
    leaves: np.ndarray
    places: np.ndarray
    samples: np.ndarray
    sizes: np.ndarray
    spaces: tuple[Spaces, np.ndarray]

    @property
    def points(self) -> FloatArray:
        """Coordinates (n_nodes, 3); of a grid in parts, only the rows that this rank holds."""
        return np.asarray(Nodes.of(self.coordinates).rows)

    @property
    def every(self) -> IntArray:
        """Flat indices of all targets."""
        return self.tree.targets

    def permitted(self, kind: int) -> FloatArray:
        """Length (m,) relative to which errors of a basis function are measured in each tree node.

        The shortest edge at its samples, divided by the size of the function's singular part at the radius of its box.
        """
        size, child = np.full(len(self.tree.span), np.inf), self.tree.child
        size[self.leaves] = self.sizes.min(axis=1)
        for n in range(len(size) - 1, -1, -1):
            if child[n, 0] >= 0:
                size[n] = size[child[n]].min()
        power, factor = _SINGULAR[kind]
        return size / (factor * np.maximum((self.tree.half**2).sum(axis=1), 1e-300) ** (0.5 * power))

    def flat(self, first: int, last: int) -> IntArray:
        """Flat indices of the targets in the regions first <= g < last."""
        roots = self.tree.region[[first, last - 1]]
        return self.tree.targets[self.tree.span[roots[0], 0] : self.tree.span[roots[1], 1]]

    def nodes(self, first: int, last: int) -> range:
        """Numbers of the tree nodes of the regions first <= g < last."""
        return range(self.tree.region[first], self.tree.region[last])


def make_radial_targets(
    coordinates: Any,
    shapes: Shapes,
    offsets: IntArray,
    flat: IntArray,
) -> RadialTargets:
    """Targets ``flat``, ascending, of a grid; those of this rank if the grid is in parts."""
    points, shapes = Nodes.of(coordinates).rows, shape_table(shapes)
    tree = build_target_tree(points, shapes, offsets, flat, CAPACITY)
    leaves = np.flatnonzero((tree.child[:, 0] < 0) & (tree.span[:, 1] > tree.span[:, 0]))
    leaves = leaves[np.argsort(tree.span[leaves, 0])]
    places = sample_places(np.append(tree.span[leaves, 0], len(tree.targets)))
    samples = tree.targets[places]
    sizes = node_sizes(points, shapes, offsets, samples.ravel()).reshape(samples.shape)
    return RadialTargets(coordinates, tree, leaves, places, samples, sizes, spaces_of(tree.half, TERMS))
