"""Fast sums of radial basis functions at target nodes."""

import numpy as np

from ...parallel import Shared, for_chunks
from ..radial import radial_sums
from .acceptance import radial_basis
from .sums import CHUNK, Targets
from .tree import build_tree
from .treesum import gather, sum_radial
from .walk import Reach, list_clusters

# Errors of clusters cancel as much as the coefficients do, which only a trial shows: this part of the tolerance is
# aimed at on some bricks, because others can be worse.
_TRIALS, _AIM = 6, 0.25
_TRIAL_BRICKS = 24


class FastRadial:
    """Clusters of the centres of one basis function.

    Parameters
    ----------
    kind : number of the basis function, see :data:`.basis.BASES`
    centres : (n, 3) in units of the support radius
    order : interpolation points per side of a cube

    Attributes
    ----------
    share : what one cluster may cause, as a multiple of the tolerance; found by trial, kept for later coefficients
    """

    def __init__(self, kind, centres, order):
        self._kind = kind
        self._function = radial_basis(kind)
        self._centres = centres
        self._order = order
        self._tree = build_tree(centres, order)
        self.share = 1.0

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
        risk : (b,) bound of each brick's error, in units that only allow comparing
        """
        strength, charges = self._rms(coefficients), self._charges(coefficients)
        chosen = np.unique(np.linspace(0, len(targets.sizes) - 1, _TRIAL_BRICKS).astype(int))
        trial = targets.subset(chosen, self._order)
        exact = radial_sums(self._kind, trial.points[trial.samples.ravel()], self._centres, coefficients)
        limit = tolerance * targets.sizes.min(axis=1)
        for _ in range(_TRIALS):
            found = self._trial_sums(trial, charges, strength, self.share * limit[chosen])
            error = (np.linalg.norm(found - exact, axis=1) / trial.sizes.ravel()).max() / tolerance
            if error <= _AIM:
                break
            self.share *= max(0.03, 0.6 * _AIM / error)
        return self._sum(targets, charges, strength, self.share * limit, use, result, progress)

    def _trial_sums(self, trial, charges, strength, allowed):
        """Sums at the samples of the trial's bricks."""
        found = np.zeros((len(trial.points), 3))

        def use(flat, sums):
            found[flat] = sums

        self._sum(trial, charges, strength, allowed, use, found)
        return found[trial.samples.ravel()]

    def _rms(self, coefficients):
        """Root of the summed squares of each cluster's coefficients: what they do if their signs are random."""
        squares = np.append(0.0, np.cumsum((coefficients[self._tree.order] ** 2).sum(axis=1)))
        return np.sqrt(squares[self._tree.span[:, 1]] - squares[self._tree.span[:, 0]])

    def _charges(self, coefficients):
        return gather(self._tree, coefficients[self._tree.order])

    def _sum(self, targets, charges, strength, allowed, use, result, progress=None):
        tree, m = self._tree, len(self._tree.span)
        reach = Reach(strength, np.ones(m), np.zeros(m))
        nothing, risk = np.zeros(len(allowed)), np.zeros(len(allowed))
        points, bricks, regions = targets.points, targets.bricks, targets.regions

        def work(lo, hi):
            flat = targets.flat(lo, hi)
            sums = np.zeros((len(flat), 3))
            lists = list_clusters(lo, hi, regions, bricks, tree, reach, self._function, allowed, nothing, risk)
            sum_radial(lo, hi, points, bricks, regions, tree, charges, lists, self._function, sums)
            use(flat, sums)

        shared = [Shared(result, targets.flat), Shared(risk, targets.numbers)]
        for_chunks(work, targets.n_regions, CHUNK, progress, shared)
        return risk
