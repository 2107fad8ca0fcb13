"""Fast sums of radial basis functions at target nodes."""

import numpy as np

from .bricks import Bricks
from .fastsum import Targets
from .parallel import Shared, for_chunks
from .radial import radial_sums
from .tree import build_tree, gather_charges
from .treesum import Charges, Reach, radial_basis, sum_bricks

_CHUNK = 16
_TRIALS = 6
_TRIAL_BRICKS = 24


class FastRadial:
    """Clusters of the centres of one basis function.

    Parameters
    ----------
    kind : number of the basis function, see :data:`.basis.BASES`
    centres : (n, 3) in units of the support radius
    order : interpolation points per side of a cube
    """

    def __init__(self, kind, centres, order):
        self._kind = kind
        self._function = radial_basis(kind)
        self._centres = centres
        self._tree = build_tree(centres, order)

    def evaluate(self, coefficients, targets: Targets, tolerance, use, result, progress=None):
        """Sums at target nodes, handed chunk by chunk to ``use`` with their flat indices.

        Parameters
        ----------
        coefficients : (n, 3)
        targets : with points in the unit of the centres
        tolerance : allowed error relative to the local cell size
        result : (n_nodes, ...) array of which ``use`` fills these rows

        Returns
        -------
        error : the largest found against exact sums at samples of the bricks, relative to the cell size
        """
        strength = self._rms(coefficients)
        limit = tolerance * targets.sizes.min(axis=1)
        trial = np.unique(np.linspace(0, len(limit) - 1, _TRIAL_BRICKS).astype(int))
        flat = targets.samples[trial]
        exact = radial_sums(self._kind, targets.points[flat.ravel()], self._centres, coefficients)
        share = 1.0
        for _ in range(_TRIALS):
            error = self._trial_error(coefficients, strength, targets, trial, limit * share, exact) / tolerance
            if error <= 0.25:
                break
            share *= max(0.03, 0.15 / error)
        self._sum(targets.points, targets.bricks, coefficients, strength, limit * share, use, result, progress)
        return error * tolerance

    def _trial_error(self, coefficients, strength, targets, trial, allowed, exact):
        """Largest error at the samples of some bricks, relative to the cell size."""
        bricks = targets.bricks
        few = Bricks(
            np.append(0, np.cumsum(np.diff(bricks.start)[trial])),
            np.concatenate([bricks.targets[bricks.start[b] : bricks.start[b + 1]] for b in trial]),
            bricks.center[trial], bricks.axes[trial], bricks.half[trial], bricks.per_side[trial],
        )  # fmt: skip
        found = np.zeros((len(targets.points), 3))

        def use(flat, sums):
            found[flat] = sums

        self._sum(targets.points, few, coefficients, strength, allowed[trial], use, found)
        gap = np.linalg.norm(found[targets.samples[trial].ravel()] - exact, axis=1)
        return float((gap / targets.sizes[trial].ravel()).max())

    def _rms(self, coefficients):
        """Root of the summed squares of each cluster's coefficients: what they do if their signs are random."""
        squares = np.append(0.0, np.cumsum((coefficients[self._tree.order] ** 2).sum(axis=1)))
        return np.sqrt(squares[self._tree.span[:, 1]] - squares[self._tree.span[:, 0]])

    def _sum(self, points, bricks, coefficients, strength, allowed, use, result, progress=None):
        tree, m = self._tree, len(self._tree.span)
        reach = Reach(strength, np.ones(m), np.zeros(m))
        source = coefficients[tree.order]
        proxy = np.empty((len(tree.proxies), 3))
        gather_charges(tree, source, proxy)
        charges = Charges(source, proxy)
        nothing, risk = np.zeros(len(allowed)), np.zeros(len(allowed))

        def work(lo, hi):
            start, stop = bricks.start[lo], bricks.start[hi]
            sums = np.zeros((stop - start, 3))
            sum_bricks(lo, hi, points, bricks, tree, reach, charges, self._function, allowed, nothing, sums, risk)
            use(bricks.targets[start:stop], sums)

        for_chunks(work, len(allowed), _CHUNK, progress, [Shared(result, bricks.targets_of)])
