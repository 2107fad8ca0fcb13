"""Radial basis functions at the nodes, exactly or fast with clusters of centres, and their derivative."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
import scipy

from ...grid import FloatArray, Grid, IntArray
from ...numerics.arrays import Report
from ...numerics.exact.basis import BASES
from ...numerics.exact.radial import radial_sums
from ...numerics.fastsum.radial import FastRadial, RadialTargets, make_radial_targets
from ...parallel import Nodes, for_chunks, thread_count
from ..base import Account, Progress, Setting, of_stage
from ..kinks import Kinks
from .centres import Centres, Coefficients
from .mirror import Images
from .radial_system import RadialSystem
from .summation import fast_pays, largest_error, sum_accurately

# Nodes per chunk of exact sums, and in derivatives.
_CHUNK, _ROWS = 1024, 1 << 16


class RadialSums:
    """Sums at the target nodes ``flat``, with the greedy residual added near the walls where the ``options``, those of
    :class:`.rbf.RBF`, say so."""

    def __init__(self, grid: Grid, flat: IntArray, centres: Centres, options: Any, account: Account):
        self._grid, self.flat, self._centres = grid, flat, centres
        self._options, self._account = options, account
        self._is_fast = False
        self.targets: RadialTargets | None = None
        self._tree: tuple[FloatArray, FastRadial] | None = None
        # Distance of every target from the nearest source, and the number of that.
        self._nearest: tuple[FloatArray, IntArray] | None = None

    def prepare(self, n_centres: int) -> None:
        """Sort the target nodes for fast sums if these pay for this number of centres."""
        n_targets = sum(self._grid.nodes.gather(len(self.flat)))
        self._is_fast, self._account.settings["summation"] = fast_pays(self._options.summation, n_targets, n_centres)
        if not self._is_fast or self.targets is not None:
            return
        tolerance = Setting(self._options.summation_tolerance, "error relative to the local cell")
        self._account.settings["summation_tolerance"] = tolerance
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
            assert self.targets is not None
            targets = self.targets
            if self._tree is None or not np.array_equal(self._tree[0], fit.centres):
                self._tree = fit.centres, FastRadial(BASES[self._options.basis], fit.centres)

            def use(flat: IntArray, sums: FloatArray) -> None:
                x = targets.points[flat]
                rows[flat] = sums + self._centres.drift(x, fit.polynomial)

            sums, rows = self._tree[1], Nodes.of(out).rows

            def once() -> float:
                sums.prepare(fit.coefficients, targets, self._options.summation_tolerance)
                risk = sums.apply(use, progress=report)
                return largest_error(self._grid, targets, risk, rows, partial(self._displacement, fit))

            sum_accurately("rbf", sums, once, self._options.summation_tolerance, self._account)
        else:
            self._exact(fit, Nodes.of(out).rows, report)
        if self._options.greedy_correct and fit.reach > 0:
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

    def _add_residual(self, fit: Coefficients, out: FloatArray) -> None:
        """Add the residual of the nearest source, which fades out with the distance from it (Wendland C2)."""
        assert fit.residual is not None
        if self._nearest is None:
            tree = scipy.spatial.cKDTree(self._centres.points * self._centres.scale + self._centres.origin)
            self._nearest = tree.query(self._points[self.flat], workers=thread_count())
        distance, nearest = self._nearest
        residual, flat = fit.residual, self.flat

        def work(lo: int, hi: int) -> None:
            r = np.minimum(distance[lo:hi] / fit.reach, 1.0)
            out[flat[lo:hi]] += ((1 - r) ** 4 * (4 * r + 1))[:, None] * residual[nearest[lo:hi]]

        for_chunks(work, len(flat), _CHUNK)


class LinearRBF:
    """Derivative of the displacement of some nodes with respect to that of the sources, all of which are centres; the
    same at all displacements. Sums are exact."""

    def __init__(self, system: RadialSystem, grid: Grid, flat: IntArray, images: Images, kinks: Kinks) -> None:
        self._system, self._nodes, self._images = system, grid.nodes, images
        self.flat, self.kinks = flat, kinks

    def push(self, change: FloatArray, out: FloatArray) -> None:
        """Write the change of the nodes into their rows of ``out`` (n_nodes, 3), for a ``change`` of the sources."""
        system, rows = self._system, Nodes.of(out).rows
        coefficients, polynomial = system.solve(self._images.displaced(change), Account(), None)
        for flat, x, terms in self._portions():
            rows[flat] = radial_sums(system.kind, x, system.centres.points, coefficients) + terms @ polynomial

    def pull(self, gradient: FloatArray) -> FloatArray:
        """Gradient (n_sources, 3) from that of the nodes, rows of ``gradient`` (n_nodes, 3)."""
        system, rows = self._system, Nodes.of(gradient).rows
        upper, lower = np.zeros_like(system.centres.points), np.zeros((system.terms.shape[1], 3))
        for flat, x, terms in self._portions():
            upper += radial_sums(system.kind, system.centres.points, x, rows[flat])
            lower += terms.T @ rows[flat]
        upper, lower = (self._nodes.total(each) for each in (upper, lower))
        return self._images.gathered(system.solve_transposed(upper, lower))

    def _portions(self) -> Iterator[tuple[IntArray, FloatArray, FloatArray]]:
        """Some nodes at a time, their normalised coordinates (n, 3), and polynomial terms (n, q)."""
        centres = self._system.centres
        for first in range(0, len(self.flat), _ROWS):
            flat = self.flat[first : first + _ROWS]
            x = centres.normalised(self._nodes.rows[flat])
            yield flat, x, centres.polynomial(x)[:, : self._system.terms.shape[1]]
