"""How IDW sums over its sources: exactly, or fast with clusters of sources."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..grid import FloatArray, Grid, IntArray
from ..numerics import fastsum
from ..numerics.direct import weighted_sums
from ..numerics.parallel import Shared, for_chunks
from ..numerics.rigid import finish
from .base import Account, Progress, Setting

_CHUNK = 2048
_WORST_BRICKS = 24
_RANDOM_NODES = 64
_MAX_RETRIES = 3


@dataclass(frozen=True)
class Fit:
    """A displacement as the sums need it.

    ``path`` source positions (n, 3) at the start of every step, relative to ``origin`` (3,): one step, unless the
    weights are found anew on the way; ``values`` (k, n) per source; ``weights`` (a, b, kappa) per group; ``shift`` and
    ``turn`` (n,) displacement and rotation angle of each source; ``mean`` (3,) displacement that was taken out.
    """

    path: tuple[FloatArray, ...]
    values: FloatArray
    weights: tuple[tuple[float, float, float], ...]
    shift: FloatArray
    turn: FloatArray
    origin: FloatArray
    mean: FloatArray


@dataclass(frozen=True)
class Bound:
    """Sources and targets of one undeformed grid: ``flat`` nodes of ``grid``; sources (n, 3) with strength (n,)."""

    grid: Grid
    flat: IntArray
    sources: FloatArray
    strength: FloatArray
    groups: tuple[IntArray, ...]
    rotation: str
    divisions: int
    reweight: bool

    @property
    def repeats(self) -> int:
        """How often the mean rigid motion of one set of sums is applied."""
        return self.divisions if self.rotation == "division" and not self.reweight else 1


@dataclass(frozen=True)
class ExactSums:
    """Every target with every source."""

    bound: Bound

    def evaluate(self, fit: Fit, out: FloatArray, progress: Progress | None) -> None:
        """Write the displacement of the targets into ``out`` (n_nodes, 3)."""

        def work(lo: int, hi: int) -> None:
            flat = self.bound.flat[lo:hi]
            out[flat] = self.displacement(fit, flat)

        report = None if progress is None else (lambda done, total: progress("idw", done, total))
        flat = self.bound.flat
        for_chunks(work, len(flat), _CHUNK, report, [Shared(out, lambda lo, hi: flat[lo:hi])])

    def displacement(self, fit: Fit, flat: IntArray) -> FloatArray:
        """Displacement (n, 3) of the nodes ``flat``."""
        bound = self.bound
        x = bound.grid.points[flat] - fit.origin
        moved, total = np.empty_like(x), np.zeros_like(x)
        for sources in fit.path:
            sums = np.zeros((len(x), 1 + len(fit.values)))
            for group, weights in zip(bound.groups, fit.weights, strict=True):
                sums += weighted_sums(
                    x + total, sources[group], bound.strength[group], weights, fit.values[:, group]
                )  # fmt: skip
            finish(bound.rotation, sums, x + total, moved, bound.repeats)
            total += moved
        return np.asarray(total + fit.mean)


class FastSums:
    """Clusters of sources seen from bricks of targets; the error is checked against exact sums at the worst nodes."""

    def __init__(self, bound: Bound, tolerance: float, account: Account):
        self.bound = bound
        self._tolerance = tolerance
        self._account = account
        self._sums = self._sorted(bound.sources, bound.grid.points)
        self._random = np.random.default_rng(0).permutation(len(bound.flat))[:_RANDOM_NODES]

    def _sorted(self, sources: FloatArray, points: FloatArray) -> fastsum.FastSums:
        grid, order = self.bound.grid, fastsum.interpolation_order(self._tolerance)
        targets = fastsum.make_targets(points, grid.shapes, grid.offsets, self.bound.flat, order)
        return fastsum.FastSums(sources, self.bound.groups, targets, self._tolerance)

    def evaluate(self, fit: Fit, out: FloatArray, progress: Progress | None) -> None:
        """Write the displacement of the targets into ``out`` (n_nodes, 3)."""
        for _ in range(1 + _MAX_RETRIES):
            risk = self._sum(fit, out, progress)
            error = self._sampled_error(fit, out, risk)
            if error <= self._tolerance:
                break
            # Rare: clusters whose errors add up. From now on each may cause less.
            self._sums.share *= 0.25 * self._tolerance / error
        else:
            self._account.warnings.append(
                f"fast sums: an error of {error:.2g} of a cell was found, {self._tolerance:g} is allowed; "
                f'use method.idw.summation = "exact"'
            )
        self._account.settings["sampled_error"] = Setting(error, "against exact sums at the worst nodes, in cells")

    def _sum(self, fit: Fit, out: FloatArray, progress: Progress | None) -> FloatArray:
        """Displacements into ``out``; returns a bound of the error of each brick, in any unit."""
        report = None if progress is None else (lambda done, total: progress("idw", done, total))
        bound, sums, points = self.bound, self._sums, self.bound.grid.points
        for step, sources in enumerate(fit.path):
            if step:
                points = bound.grid.points.copy()
                points[bound.flat] += out[bound.flat] - fit.mean
                sums = self._sorted(sources + fit.origin, points)
                sums.share = self._sums.share

            def use(flat: IntArray, values: FloatArray, points: FloatArray = points, step: int = step) -> None:
                x = points[flat] - fit.origin
                moved = np.empty_like(x)
                finish(bound.rotation, values, x, moved, bound.repeats)
                out[flat] = moved + (out[flat] if step else fit.mean)

            risk = sums.evaluate(bound.strength, fit.weights, fit.values, fit.shift, fit.turn, use, out, report)
        return np.asarray(risk)

    def _sampled_error(self, fit: Fit, out: FloatArray, risk: FloatArray) -> float:
        """Largest error in cells at samples of the bricks with the largest bounds and at random nodes."""
        targets = self._sums.targets
        worst = np.argsort(risk)[-_WORST_BRICKS:]
        flat = np.concatenate([targets.samples[worst].ravel(), self.bound.flat[self._random]])
        grid = self.bound.grid
        size = fastsum.node_sizes(grid.points, fastsum.shape_table(grid.shapes), grid.offsets, flat)
        exact = ExactSums(self.bound).displacement(fit, flat)
        return float((np.linalg.norm(out[flat] - exact, axis=1) / size).max(initial=0.0))
