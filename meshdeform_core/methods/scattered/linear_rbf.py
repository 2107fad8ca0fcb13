"""Derivative of radial basis functions: linear in the displacement, but for the greedy choice of centres."""

from __future__ import annotations

import numpy as np

from ...grid import FloatArray, IntArray
from ...numerics.exact.basis import BASES
from ...numerics.exact.radial import radial_sums
from ...numerics.fastsum.radial.sums import FastRadial
from ...numerics.fastsum.radial.targets import RadialTargets
from ...parallel import Nodes, agreed
from ..base import Account
from ..kinks import Kinks
from .centres import REACH
from .mirror import Images
from .radial_system import RadialSystem
from .rbf_sums import RadialSums
from .summation import DERIVATIVE_TOLERANCE, MAX_RETRIES, doubtful

_ROWS = 1 << 16


class RadialMap:
    """The linear map from values at centres (m, 3) to those at points (n, 3), by exact sums, and its transpose."""

    def __init__(self, system: RadialSystem, points: FloatArray) -> None:
        self._system, self._kind = system, BASES[system.options.basis]
        self._x = system.centres.normalised(points)
        self._terms = system.centres.polynomial(self._x)[:, : system.terms.shape[1]]

    def push(self, values: FloatArray) -> FloatArray:
        """Interpolated values (n, 3)."""
        coefficients, polynomial = self._system.solve(values, Account(), None)
        sums = radial_sums(self._kind, self._x, self._system.centres.points, coefficients)
        return np.asarray(sums + self._terms @ polynomial)

    def pull(self, gradient: FloatArray) -> FloatArray:
        """Gradient (m, 3) of the values from that (n, 3) at the points."""
        return self._system.solve_transposed(*self.gathered(gradient))

    def gathered(self, gradient: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Gradients of the coefficients (m, 3) and of the polynomial (q, 3) from that (n, 3) at the points."""
        upper = radial_sums(self._kind, self._system.centres.points, self._x, np.ascontiguousarray(gradient))
        return upper, self._terms.T @ gradient


class LinearRBF:
    """Derivative of the displacement of some nodes with respect to that of the sources, all of which are centres; the
    same at all displacements.

    If the method uses fast sums, so does the derivative, provided their error, checked against exact sums at some
    nodes, is below :data:`.summation.DERIVATIVE_TOLERANCE` of the derivative; otherwise sums are exact.
    """

    def __init__(
        self, system: RadialSystem, points: FloatArray, sums: RadialSums, images: Images, kinks: Kinks
    ) -> None:
        self._system, self._points, self._nodes, self.flat = system, points, Nodes.of(points), sums.flat
        self._images, self.kinks = images, kinks
        self._fast = self._accurate(sums.targets) if sums.targets else None
        self._exact = None if self._fast else RadialMap(system, self._nodes.rows[self.flat])

    def _accurate(self, targets: RadialTargets) -> FastRadial | None:
        """Fast sums, refined until the error at the nodes where they are compared with exact sums is small enough;
        ``None`` if it remains too large.

        Errors are relative to the derivative for the same, random, change: its coefficients, and its values between the
        sources, are many times larger than the change itself.
        """
        system, centres = self._system, self._system.centres
        rough = np.random.default_rng(0).uniform(-1.0, 1.0, centres.points.shape)
        coefficients, polynomial = system.solve(rough, Account(), None)
        kind, found = BASES[system.options.basis], Nodes.of(self._nodes.like(3)).rows

        def exactly(flat: IntArray) -> FloatArray:
            return radial_sums(kind, targets.points[flat], centres.points, coefficients)

        some = doubtful(self._points, targets, np.zeros(len(targets.leaves)))
        ranks = self._nodes.ranks
        size = agreed(ranks, float(np.abs(exactly(some) + self._terms(some) @ polynomial).max(initial=0.0)))
        allowed = DERIVATIVE_TOLERANCE * size
        for _ in range(1 + MAX_RETRIES):
            fast = FastRadial(kind, centres.points)
            # Errors count alike everywhere.
            fast.prepare(coefficients, targets._replace(sizes=np.ones_like(targets.sizes)), allowed)

            def keep(flat: IntArray, sums: FloatArray) -> None:
                found[flat] = sums

            risk = fast.apply(keep)
            flat = doubtful(self._points, targets, risk)
            # All ranks must decide alike, even if their processors round differently.
            gap = float(np.abs(found[flat] - exactly(flat)).max(initial=0.0))
            error = agreed(ranks, gap) / size
            if error <= DERIVATIVE_TOLERANCE:
                return fast
            if not np.isfinite(error):
                break
            allowed *= 0.25 * DERIVATIVE_TOLERANCE / error
        return None

    def push(self, change: FloatArray, out: FloatArray) -> None:
        """Write the change of the nodes into their rows of ``out`` (n_nodes, 3), for a ``change`` of the sources."""
        values, rows = self._images.displaced(change), Nodes.of(out).rows
        if self._exact:
            rows[self.flat] = self._exact.push(values)
            return
        assert self._fast is not None
        coefficients, polynomial = self._system.solve(values, Account(), None)

        def use(flat: IntArray, sums: FloatArray) -> None:
            rows[flat] = sums + self._terms(flat) @ polynomial

        self._fast.apply(use, coefficients)

    def pull(self, gradient: FloatArray) -> FloatArray:
        """Gradient (n_sources, 3) from that of the nodes, rows of ``gradient`` (n_nodes, 3)."""
        rows = Nodes.of(gradient).rows
        if self._exact:
            upper, lower = self._exact.gathered(rows[self.flat])
        else:
            assert self._fast is not None
            upper, lower = self._fast.transpose(rows), np.zeros((self._system.terms.shape[1], 3))
            for first in range(0, len(self.flat), _ROWS):
                flat = self.flat[first : first + _ROWS]
                lower += self._terms(flat).T @ rows[flat]
        upper, lower = (self._nodes.total(each) for each in (upper, lower))
        return self._images.gathered(self._system.solve_transposed(upper, lower))

    def _terms(self, flat: IntArray) -> FloatArray:
        """Polynomial terms (n, q) at some nodes."""
        centres = self._system.centres
        return centres.polynomial(centres.normalised(self._nodes.rows[flat]))[:, : self._system.terms.shape[1]]


class LinearGreedy:
    """Derivative of the displacement of some nodes at one displacement (n_sources, 3) of the sources.

    It includes the interpolation between the chosen centres, the residual at all sources, which nodes near them take
    over, and the distance over which they do, which grows with the largest residual. The choice of centres is held
    fixed.
    """

    def __init__(
        self, system: RadialSystem, points: FloatArray, sums: RadialSums, images: Images, kinks: Kinks, active: IntArray
    ) -> None:
        self._images, self._sums, self.flat, self.kinks, self._active = images, sums, sums.flat, kinks, active
        self._inside, self._at_sources = RadialMap(system, points[sums.flat]), RadialMap(system, images.points)
        self._corrects = False

    def correct(self, values: FloatArray) -> None:
        """Include the residual that the reduction leaves at the sources for their values (n, 3)."""
        left = values - self._at_sources.push(values[self._active])
        length = np.linalg.norm(left, axis=1)
        self._worst = int(np.argmax(length))
        reach = REACH * float(length[self._worst])
        self._corrects = reach > 0.0
        if self._corrects:
            distance, self._nearest = self._sums.nearest()
            r = np.minimum(distance / reach, 1.0)
            self._share = ((1.0 - r) ** 4 * (4.0 * r + 1.0))[:, None]
            # The correction of a node depends on the reach, and the reach on the largest residual.
            self._growth = (20.0 * r**2 * (1.0 - r) ** 3 / reach)[:, None] * left[self._nearest]
            self._of_reach = REACH * left[self._worst] / length[self._worst]

    def push(self, change: FloatArray, out: FloatArray) -> None:
        """Write the change of the nodes into their rows of ``out`` (n_nodes, 3), for a ``change`` of the sources."""
        values = self._images.displaced(change)
        moved = self._inside.push(values[self._active])
        if self._corrects:
            left = values - self._at_sources.push(values[self._active])
            moved += self._share * left[self._nearest] + self._growth * (self._of_reach @ left[self._worst])
        out[self.flat] = moved

    def pull(self, gradient: FloatArray) -> FloatArray:
        """Gradient (n_sources, 3) from that of the nodes, rows of ``gradient`` (n_nodes, 3)."""
        g, values = gradient[self.flat], np.zeros((len(self._images.owner), 3))
        of_active = self._inside.pull(g)
        if self._corrects:
            np.add.at(values, self._nearest, self._share * g)
            values[self._worst] += self._of_reach * (self._growth * g).sum()
            of_active -= self._at_sources.pull(values)
        values[self._active] += of_active
        return self._images.gathered(values)
