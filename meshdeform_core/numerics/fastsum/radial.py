"""Fast sums of radial basis functions at target nodes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ...parallel import Nodes, agreed, for_chunks
from ..arrays import FloatArray, IntArray, Report, Shapes
from ..exact.basis import BASES
from ..exact.radial import radial_sums
from .clusters import build_tree
from .nested import Bases, find_bases, gather_up
from .passes import Boxes, Clusters, Spaces, spaces_of, sum_regions
from .targets import TargetTree, build_target_tree, leaves_of, shape_table
from .tuned import AIM, CAPACITY, RADIAL_LEAF, SKELETONS, TERMS, TRIAL_LEAVES, TRIALS

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


def make_radial_targets(
    coordinates: Any,
    shapes: Shapes,
    offsets: IntArray,
    flat: IntArray,
) -> RadialTargets:
    """Targets ``flat``, ascending, of a grid; those of this rank if the grid is in parts."""
    points, shapes = Nodes.of(coordinates).rows, shape_table(shapes)
    tree = build_target_tree(points, shapes, offsets, flat, CAPACITY)
    leaves, _, places, sizes = leaves_of(tree, points, shapes, offsets)
    return RadialTargets(coordinates, tree, leaves, places, tree.targets[places], sizes, spaces_of(tree.half, TERMS))


_FINEST = 1e-13
_CHUNK = 1

Use = Callable[[IntArray, FloatArray], object]


class FastRadial:
    """Clusters of the centres (n, 3), in units of the support radius, of one basis function."""

    def __init__(self, kind: int, centres: FloatArray) -> None:
        self._kind, self._centres = kind, centres
        self._tree = build_tree(centres, 1, RADIAL_LEAF)
        self._radius = np.sqrt((self._tree.boxes.half**2).sum(axis=1))
        self._bases: dict[float, Bases] = {}
        self.restart()

    def restart(self) -> None:
        """Return to the initial accuracy, with which the first sum for any coefficients begins."""
        self._tolerance, self._excess = SKELETONS, np.inf
        self.share = 1.0

    def refine(self, excess: float) -> None:
        """Raise the accuracy of all sums until :meth:`restart`, as the error was ``excess`` times too large.

        If the previous increase had little effect, the skeletons are refined.
        """
        if excess > 0.5 * self._excess:
            self._tolerance = max(0.01 * self._tolerance, _FINEST)
        self.share *= max(0.03, 0.6 * AIM / excess)
        self._excess = excess

    def prepare(self, coefficients: FloatArray, targets: RadialTargets, tolerance: float) -> None:
        """Plan the sums for coefficients (n, 3) at ``targets``, with points in the unit of the centres: as fine as the
        sums at trial leaves need to keep the ``tolerance``, which is relative to the sizes of the targets. The trial
        leaves of all ranks count."""
        nodes = Nodes.of(targets.coordinates)
        counts = nodes.gather(len(targets.leaves))
        first = sum(counts[: nodes.ranks.number])
        chosen = np.unique(np.linspace(0, sum(counts) - 1, TRIAL_LEAVES).astype(int)) - first
        chosen = chosen[(chosen >= 0) & (chosen < len(targets.leaves))]
        samples = targets.samples[chosen]
        exact = radial_sums(self._kind, targets.points[samples.ravel()], self._centres, coefficients)
        exact = exact.reshape(*samples.shape, 3)
        permitted = tolerance * targets.permitted(self._kind)
        every = np.ones(len(permitted), dtype=bool)
        for _ in range(TRIALS):
            tree = self._tree
            bases = self._bases.get(self._tolerance)
            if bases is None:
                acting = np.ones(len(self._radius), dtype=bool)
                bases = self._bases[self._tolerance] = find_bases(
                    self._kind, tree, self._radius, acting, self._tolerance
                )
            charges, upper = coefficients[tree.order], np.empty((len(bases.place), 3))
            gather_up(tree.span, tree.child, bases, charges, upper)
            squares = np.append(0.0, np.cumsum((upper**2).sum(axis=1)))
            strength = np.sqrt(np.diff(squares[bases.start]))
            where = tree.boxes.center, self._radius, tree.child, tree.span, tree.points
            clusters = Clusters(self._kind != BASES["tps"], *where, bases, charges, upper, strength)
            boxes = Boxes(targets.tree, *targets.spaces, self.share * permitted, every)
            found = self._on_leaves(chosen, targets, boxes, clusters)
            found = (np.linalg.norm(found - exact, axis=2) / targets.sizes[chosen]).max(initial=0.0)
            error = agreed(nodes.ranks, float(found)) / tolerance
            if error <= AIM:
                break
            self.refine(error)
        # What the sums are taken of, and the boxes of the targets with their spaces and allowed errors.
        self._plan = targets, clusters, boxes

    def apply(self, use: Use, progress: Report | None = None) -> FloatArray:
        """Call ``use`` with the flat indices (k,) of the targets of each region and the sums (k, 3) there; returns a
        bound (b,) of each leaf's error, in arbitrary units: leaves can be compared with each other."""
        targets, clusters, boxes = self._plan
        risk = np.zeros(len(boxes.allowed))

        def work(lo: int, hi: int) -> None:
            use(targets.flat(lo, hi), self._of_regions(lo, hi, targets, boxes, clusters, risk))

        for_chunks(work, len(targets.tree.region), _CHUNK, progress)
        return risk[targets.leaves]

    def _on_leaves(self, chosen: IntArray, targets: RadialTargets, boxes: Boxes, clusters: Clusters) -> FloatArray:
        """Sums at the samples of some leaves, computed in the same way as for all targets."""
        tree, leaves = targets.tree, targets.leaves[chosen]
        wanted = np.zeros(len(tree.span), dtype=bool)
        for leaf in leaves:
            wanted |= (tree.span[:, 0] <= tree.span[leaf, 0]) & (tree.span[leaf, 1] <= tree.span[:, 1])
        regions = np.searchsorted(tree.span[tree.region, 0], tree.span[leaves, 0], side="right") - 1
        found, boxes = np.empty((*targets.samples[chosen].shape, 3)), boxes._replace(wanted=wanted)
        for region in np.unique(regions):
            sums = self._of_regions(region, region + 1, targets, boxes, clusters, np.zeros(len(wanted)))
            here = regions == region
            found[here] = sums[targets.places[chosen[here]] - tree.span[tree.region[region], 0]]
        return found

    def _of_regions(
        self, lo: int, hi: int, targets: RadialTargets, boxes: Boxes, clusters: Clusters, risk: FloatArray
    ) -> FloatArray:
        """Sums (n, 3) at the targets of the regions lo <= g < hi that lie in ``wanted`` boxes."""
        sums = np.zeros((len(targets.flat(lo, hi)), 3))
        sum_regions(self._kind, lo, hi, targets.points, boxes, clusters, sums, risk)
        return sums
