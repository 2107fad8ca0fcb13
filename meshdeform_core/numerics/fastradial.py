"""Fast sums of radial basis functions at target nodes."""

from typing import NamedTuple

import numpy as np

from .bricks import Bricks
from .fastsum import Targets, sample_places
from .parallel import Shared, for_chunks
from .radial import radial_sums
from .tree import build_tree, gather_charges
from .treesum import Charges, Reach, radial_basis, sum_bricks

_CHUNK = 16
# Errors of clusters cancel as much as the coefficients do, which only a trial shows: this part of the tolerance is
# aimed at on some bricks, because others can be worse.
_TRIALS, _AIM = 6, 0.25
_TRIAL_BRICKS = 24


class _Trial(NamedTuple):
    chosen: np.ndarray
    points: np.ndarray
    bricks: Bricks
    places: np.ndarray
    exact: np.ndarray
    sizes: np.ndarray


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
        limit = tolerance * targets.sizes.min(axis=1)
        trial = self._trial(targets, coefficients)
        for _ in range(_TRIALS):
            error = self._trial_error(trial, charges, strength, limit * self.share) / tolerance
            if error <= _AIM:
                break
            self.share *= max(0.03, 0.6 * _AIM / error)
        return self._sum(targets.points, targets.bricks, charges, strength, limit * self.share, use, result, progress)

    def _trial(self, targets, coefficients):
        """Some bricks spread over all, with their own targets and the exact sums at their samples."""
        bricks = targets.bricks
        chosen = np.unique(np.linspace(0, len(targets.sizes) - 1, _TRIAL_BRICKS).astype(int))
        flat = [bricks.targets[bricks.start[b] : bricks.start[b + 1]] for b in chosen]
        start = np.append(0, np.cumsum([len(each) for each in flat]))
        own = Bricks(
            start, np.arange(start[-1]), bricks.center[chosen], bricks.axes[chosen], bricks.half[chosen],
            bricks.per_side[chosen],
        )  # fmt: skip
        points, places = targets.points[np.concatenate(flat)], sample_places(start).ravel()
        exact = radial_sums(self._kind, points[places], self._centres, coefficients)
        return _Trial(chosen, points, own, places, exact, targets.sizes[chosen].ravel())

    def _trial_error(self, trial, charges, strength, allowed):
        """Largest error at the samples of the trial's bricks, relative to the cell size."""
        found = np.zeros((len(trial.points), 3))

        def use(flat, sums):
            found[flat] = sums

        self._sum(trial.points, trial.bricks, charges, strength, allowed[trial.chosen], use, found)
        return float((np.linalg.norm(found[trial.places] - trial.exact, axis=1) / trial.sizes).max())

    def _rms(self, coefficients):
        """Root of the summed squares of each cluster's coefficients: what they do if their signs are random."""
        squares = np.append(0.0, np.cumsum((coefficients[self._tree.order] ** 2).sum(axis=1)))
        return np.sqrt(squares[self._tree.span[:, 1]] - squares[self._tree.span[:, 0]])

    def _charges(self, coefficients):
        source = coefficients[self._tree.order]
        proxy = np.empty((len(self._tree.proxies), 3))
        gather_charges(self._tree, source, proxy)
        return Charges(source, proxy)

    def _sum(self, points, bricks, charges, strength, allowed, use, result, progress=None):
        tree, m = self._tree, len(self._tree.span)
        reach = Reach(strength, np.ones(m), np.zeros(m))
        nothing, risk = np.zeros(len(allowed)), np.zeros(len(allowed))

        def work(lo, hi):
            start, stop = bricks.start[lo], bricks.start[hi]
            sums = np.zeros((stop - start, 3))
            sum_bricks(lo, hi, points, bricks, tree, reach, charges, self._function, allowed, nothing, sums, risk)
            use(bricks.targets[start:stop], sums)

        for_chunks(work, len(allowed), _CHUNK, progress, [Shared(result, bricks.targets_of), Shared(risk)])
        return risk
