"""Evaluation of radial basis functions at the nodes: exactly, or fast with clusters of centres."""

from __future__ import annotations

from functools import partial

import numpy as np
import scipy

from ...grid import FloatArray, Grid, IntArray
from ...numerics.arrays import Report
from ...numerics.exact.basis import BASES
from ...numerics.exact.radial import radial_sums
from ...numerics.fastsum.radial.sums import FastRadial
from ...numerics.fastsum.radial.targets import RadialTargets, make_radial_targets
from ...parallel import Nodes, for_chunks, thread_count
from ..base import Account, Progress, Setting, of_stage
from .centres import Centres, Coefficients, SumOptions
from .summation import fast_pays, largest_error, sum_accurately

_CHUNK = 1024


class RadialSums:
    """Sums at the target nodes ``flat``, with the greedy residual added near the walls where the options say so."""

    def __init__(self, grid: Grid, flat: IntArray, centres: Centres, options: SumOptions, account: Account):
        self._grid, self.flat, self._centres = grid, flat, centres
        self._options, self._account = options, account
        self._is_fast = False
        self.targets: RadialTargets | None = None
        self._tree: tuple[FloatArray, FastRadial] | None = None
        self._nearest: tuple[FloatArray, IntArray] | None = None

    def prepare(self, n_centres: int) -> None:
        """Sort the target nodes for fast sums if these pay for this number of centres."""
        n_targets = sum(self._grid.nodes.gather(len(self.flat)))
        self._is_fast, self._account.settings["summation"] = fast_pays(self._options.summation, n_targets, n_centres)
        if not self._is_fast or self.targets is not None:
            return
        self._account.settings["summation_tolerance"] = Setting(
            self._options.tolerance, "error relative to the local cell"
        )
        grid = self._grid
        grid.hold_neighbours()
        points = grid.nodes.like(3)
        Nodes.of(points).each(lambda rows: np.copyto(points[rows], self._centres.normalised(grid.points[rows])))
        grid.hold_neighbours(points)
        targets = make_radial_targets(points, grid.shapes, grid.offsets, self.flat)
        self.targets = targets._replace(sizes=targets.sizes * self._centres.scale)

    def evaluate(self, fit: Coefficients, out: FloatArray, progress: Progress | None) -> None:
        """Write the displacement of the targets into ``out`` (n_nodes, 3)."""
        report = of_stage(progress, "rbf")
        self.prepare(len(fit.centres))
        if self._is_fast:
            self._fast(fit, out, report)
        if not self._is_fast:
            self._exact(fit, Nodes.of(out).rows, report)
        if self._options.correct and fit.reach > 0:
            self._add_residual(fit, Nodes.of(out).rows)

    @property
    def _points(self) -> FloatArray:
        """Coordinates (n_nodes, 3); of a grid in parts, only the rows that this rank holds."""
        return np.asarray(self._grid.nodes.rows)

    def _displacement(self, fit: Coefficients, flat: IntArray) -> FloatArray:
        """Displacement (n, 3) of the nodes ``flat`` by exact sums."""
        x = self._centres.normalised(self._points[flat])
        moved = radial_sums(BASES[self._options.basis], x, fit.centres, fit.coefficients)
        return np.asarray(moved + self._centres.drift(x, fit.polynomial))

    def _exact(self, fit: Coefficients, out: FloatArray, report: Report | None) -> None:
        def work(lo: int, hi: int) -> None:
            flat = self.flat[lo:hi]
            out[flat] = self._displacement(fit, flat)

        for_chunks(work, len(self.flat), _CHUNK, report)

    def _fast(self, fit: Coefficients, out: FloatArray, report: Report | None) -> None:
        assert self.targets is not None
        targets = self.targets
        if self._tree is None or not np.array_equal(self._tree[0], fit.centres):
            self._tree = fit.centres, FastRadial(BASES[self._options.basis], fit.centres)

        def use(flat: IntArray, sums: FloatArray) -> None:
            x = targets.points[flat]
            rows[flat] = sums + self._centres.drift(x, fit.polynomial)

        sums, rows = self._tree[1], Nodes.of(out).rows

        def once() -> float:
            sums.prepare(fit.coefficients, targets, self._options.tolerance)
            risk = sums.apply(use, progress=report)
            return largest_error(self._grid, targets, risk, rows, partial(self._displacement, fit))

        sum_accurately("rbf", sums, once, self._options.tolerance, self._account)

    def nearest(self) -> tuple[FloatArray, IntArray]:
        """Distance (n,) of every target from the nearest source, and its number (n,)."""
        if self._nearest is None:
            tree = scipy.spatial.cKDTree(self._centres.points * self._centres.scale + self._centres.origin)
            self._nearest = tree.query(self._points[self.flat], workers=thread_count())
        return self._nearest

    def _add_residual(self, fit: Coefficients, out: FloatArray) -> None:
        """Add the residual of the nearest source, which fades out with the distance from it (Wendland C2)."""
        assert fit.residual is not None
        distance, nearest = self.nearest()
        residual, flat = fit.residual, self.flat

        def work(lo: int, hi: int) -> None:
            r = np.minimum(distance[lo:hi] / fit.reach, 1.0)
            out[flat[lo:hi]] += ((1 - r) ** 4 * (4 * r + 1))[:, None] * residual[nearest[lo:hi]]

        for_chunks(work, len(flat), _CHUNK)
