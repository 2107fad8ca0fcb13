"""Fast sums of radial basis functions at target nodes: a linear map of the coefficients, and its transpose."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ....parallel import Nodes, agreed, empty, for_chunks
from ...arrays import FloatArray, IntArray, Report
from ...exact.basis import BASES
from ...exact.radial import radial_sums
from ..clusters.tree import build_tree
from ..tuned import AIM, RADIAL_LEAF, SKELETONS, TRIAL_LEAVES, TRIALS
from .nested import Bases, find_bases, gather_up
from .passes import Boxes, Clusters, scatter_to_centres, spread_region, sum_regions
from .targets import RadialTargets

_FINEST = 1e-13
_CHUNK = 1
_MOST_PORTIONS = 64

Use = Callable[[IntArray, FloatArray], object]


class _Plan(NamedTuple):
    """Targets, clusters with their charges, and the boxes of the targets with their spaces and allowed errors."""

    targets: RadialTargets
    clusters: Clusters
    boxes: Boxes


class FastRadial:
    """Clusters of the centres of one basis function.

    Parameters
    ----------
    kind : number of the basis function, see :data:`.basis.BASES`
    centres : (n, 3) in units of the support radius
    """

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
            clusters = self._clusters(coefficients)
            boxes = Boxes(targets.tree, *targets.spaces, self.share * permitted, every)
            found = self._on_leaves(chosen, targets, boxes, clusters)
            found = (np.linalg.norm(found - exact, axis=2) / targets.sizes[chosen]).max(initial=0.0)
            error = agreed(nodes.ranks, float(found)) / tolerance
            if error <= AIM:
                break
            self.refine(error)
        self._plan = _Plan(targets, clusters, boxes)

    def apply(self, use: Use, coefficients: FloatArray | None = None, progress: Report | None = None) -> FloatArray:
        """Call ``use`` with the flat indices (k,) of the targets of each region and the sums (k, 3) there.

        Parameters
        ----------
        coefficients : (n, 3) other than those prepared for, but no rougher; the same clusters are far

        Returns
        -------
        risk : (b,) bound of each leaf's error, in arbitrary units: leaves can be compared with each other
        """
        targets, clusters, boxes = self._plan
        if coefficients is not None:
            charges, upper = coefficients[self._tree.order], np.empty_like(clusters.upper)
            gather_up(clusters.span, clusters.child, clusters.bases, charges, upper)
            clusters = clusters._replace(charges=charges, upper=upper)
        risk = np.zeros(len(boxes.allowed))

        def work(lo: int, hi: int) -> None:
            use(targets.flat(lo, hi), self._of_regions(lo, hi, targets, boxes, clusters, risk))

        for_chunks(work, len(targets.tree.region) - 1, _CHUNK, progress)
        return risk[targets.leaves]

    def transpose(self, gradient: FloatArray) -> FloatArray:
        """Gradient (n, 3) of the coefficients from that of the nodes (n_nodes, 3)."""
        targets, clusters, boxes = self._plan
        n, total = len(clusters.points), len(clusters.bases.place)
        regions = len(targets.tree.region) - 1
        # The sums of all portions together are no larger than the coordinates.
        portions = int(np.clip(3 * len(targets.points) // (3 * (n + total)), 1, min(_MOST_PORTIONS, regions)))
        # Row numbers take the place of charges, so that lists say which centres and skeletons they hold.
        number = np.zeros((n + total, 3))
        number[:, 0] = np.arange(n + total)
        clusters = clusters._replace(charges=number[:n], upper=number[n:])
        cut = np.linspace(0, regions, portions + 1).astype(np.int64)
        parts = empty((portions, n + total, 3))

        def work(lo: int, hi: int) -> None:
            for portion in range(lo, hi):
                parts[portion] = 0.0
                for region in range(cut[portion], cut[portion + 1]):
                    given = np.ascontiguousarray(gradient[targets.flat(region, region + 1)])
                    spread_region(self._kind, region, targets.points, boxes, clusters, given, parts[portion])

        for_chunks(work, portions, 1)
        whole = np.asarray(sum(parts[portion] for portion in range(portions)))
        charges, upper = whole[:n].copy(), whole[n:].copy()
        scatter_to_centres(clusters.child, clusters.span, clusters.bases, upper, charges)
        found = np.empty_like(charges)
        found[self._tree.order] = charges
        return found

    def _clusters(self, coefficients: FloatArray) -> Clusters:
        """:class:`Clusters` with these charges (n, 3)."""
        tree = self._tree
        bases = self._bases.get(self._tolerance)
        if bases is None:
            acting = np.ones(len(self._radius), dtype=bool)
            bases = self._bases[self._tolerance] = find_bases(self._kind, tree, self._radius, acting, self._tolerance)
        charges, upper = coefficients[tree.order], np.empty((len(bases.place), 3))
        gather_up(tree.span, tree.child, bases, charges, upper)
        squares = np.append(0.0, np.cumsum((upper**2).sum(axis=1)))
        strength = np.sqrt(np.diff(squares[bases.start]))
        where = tree.boxes.center, self._radius, tree.child, tree.span, tree.points
        return Clusters(self._kind != BASES["tps"], *where, bases, charges, upper, strength)

    def _on_leaves(self, chosen: IntArray, targets: RadialTargets, boxes: Boxes, clusters: Clusters) -> FloatArray:
        """Sums at the samples of some leaves, computed in the same way as for all targets."""
        tree, leaves = targets.tree, targets.leaves[chosen]
        wanted = np.zeros(len(tree.span), dtype=bool)
        for leaf in leaves:
            wanted |= (tree.span[:, 0] <= tree.span[leaf, 0]) & (tree.span[leaf, 1] <= tree.span[:, 1])
        regions = np.searchsorted(tree.region, leaves, side="right") - 1
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
