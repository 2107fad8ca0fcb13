"""Derivative of radial basis functions, which are linear, so that only the transposes are new."""

from __future__ import annotations

import dataclasses

import numpy as np

from ...grid import FloatArray, IntArray
from ...numerics.exact.basis import BASES
from ...numerics.exact.radial import radial_sums
from ...numerics.fastsum.radial.frozen import FrozenRadial
from ...numerics.fastsum.radial.targets import RadialTargets
from ...parallel import agreed, alike, apart, rows_of, summed
from ..base import Account, Problem
from ..scattered.block_rbf import PreparedBlockRBF
from ..scattered.centres import Centres, SystemOptions
from ..scattered.radial_system import RadialSystem
from ..scattered.rbf import PreparedRBF
from ..scattered.rbf_sums import RadialSums
from ..scattered.summation import MAX_RETRIES, doubtful
from .kinks import Kinks
from .sums import TOLERANCE

_TOLERANCE = 1e-13
"""Tolerance of iterative solutions, to which forward and transposed derivatives agree."""
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
        return solved_transposed(self._system, *self.gathered(gradient))

    def gathered(self, gradient: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Gradients of the coefficients (m, 3) and of the polynomial (q, 3) from that (n, 3) at the points."""
        upper = radial_sums(self._kind, self._system.centres.points, self._x, np.ascontiguousarray(gradient))
        return upper, self._terms.T @ gradient


def solved_transposed(system: RadialSystem, upper: FloatArray, lower: FloatArray) -> FloatArray:
    """Gradient (m, 3) of the values at centres from those of coefficients (m, 3) and polynomial (q, 3).

    The matrix [A P; P^T 0] is symmetric. A combination of the columns of P satisfies the lower rows of the right-hand
    side; the solver takes what remains.
    """
    terms = system.terms
    part = terms @ np.linalg.solve(terms.T @ terms, lower)
    return np.asarray(part + system.solve(upper - system.multiply(part), Account(), None)[0])


def accurate(options: SystemOptions, centres: Centres, problem: Problem) -> RadialSystem:
    """The system with a direct solution, or an iterative one to round-off; it is factorised here, once."""
    system = RadialSystem(dataclasses.replace(options, solver="auto", tolerance=_TOLERANCE), centres, problem.memory)
    system.solve(np.zeros_like(centres.points), Account(), None)
    return system


class RBFDerivative:
    """Derivative of the displacement of some nodes with respect to that of the sources, all of which are centres; the
    same at all displacements.

    If the method uses fast sums, so does the derivative, provided their error, checked against exact sums at some
    nodes, is below :data:`.sums.TOLERANCE` of the derivative; otherwise sums are exact.
    """

    def __init__(self, method: PreparedRBF, problem: Problem, sums: RadialSums, kinks: Kinks | None = None) -> None:
        self._images, self._points, self.flat = method.images, problem.grid.points, sums.flat
        self._own = rows_of(self._points)
        self.kinks = kinks or Kinks()
        sums.prepare(len(method.centres.points))
        self._n = len(problem.source_numbers)
        self._system = accurate(method.options.system, method.centres, problem)
        self._fast = self._accurate(sums.targets) if sums.targets else None
        self._exact = None if self._fast else RadialMap(self._system, self._own[self.flat])

    def _accurate(self, targets: RadialTargets) -> FrozenRadial | None:
        """Fast sums, refined until the error at the nodes where they are compared with exact sums is small enough;
        ``None`` if it remains too large.

        Errors are relative to the derivative for the same, random, change: its coefficients, and its values between the
        sources, are many times larger than the change itself.
        """
        system, centres = self._system, self._system.centres
        rough = np.random.default_rng(0).uniform(-1.0, 1.0, centres.points.shape)
        coefficients, polynomial = system.solve(rough, Account(), None)
        kind, found = BASES[system.options.basis], rows_of(alike(self._points))

        def exactly(flat: IntArray) -> FloatArray:
            return radial_sums(kind, targets.points[flat], centres.points, coefficients)

        some = doubtful(self._points, targets, np.zeros(len(targets.leaves)))
        size = agreed(float(np.abs(exactly(some) + self._terms(some) @ polynomial).max(initial=0.0)))
        allowed = TOLERANCE * size
        for _ in range(1 + MAX_RETRIES):
            fast = FrozenRadial(kind, centres.points, targets, coefficients, allowed)

            def keep(flat: IntArray, sums: FloatArray) -> None:
                found[flat] = sums

            with apart(self._points):
                risk = fast.push(coefficients, keep, found)
            flat = doubtful(self._points, targets, risk)
            # All ranks must decide alike, even if their processors round differently.
            gap = float(np.abs(found[flat] - exactly(flat)).max(initial=0.0))
            error = agreed(gap) / size
            if error <= TOLERANCE:
                return fast
            if not np.isfinite(error):
                break
            allowed *= 0.25 * TOLERANCE / error
        return None

    def push(self, change: FloatArray, out: FloatArray) -> None:
        """Write the change of the nodes into their rows of ``out`` (n_nodes, 3), for a ``change`` of the sources."""
        values, rows = self._images.displaced(change), rows_of(out)
        if self._exact:
            rows[self.flat] = self._exact.push(values)
            return
        assert self._fast is not None
        coefficients, polynomial = self._system.solve(values, Account(), None)

        def use(flat: IntArray, sums: FloatArray) -> None:
            rows[flat] = sums + self._terms(flat) @ polynomial

        with apart(self._points):
            self._fast.push(coefficients, use, rows)

    def pull(self, gradient: FloatArray) -> FloatArray:
        """Gradient (n_sources, 3) from that of the nodes, rows of ``gradient`` (n_nodes, 3)."""
        total, rows = np.zeros((self._n, 3)), rows_of(gradient)
        with apart(self._points):
            if self._exact:
                upper, lower = self._exact.gathered(rows[self.flat])
            else:
                assert self._fast is not None
                upper, lower = self._fast.pull(rows), np.zeros((self._system.terms.shape[1], 3))
                for first in range(0, len(self.flat), _ROWS):
                    flat = self.flat[first : first + _ROWS]
                    lower += self._terms(flat).T @ rows[flat]
        upper, lower = (summed(self._points, each) for each in (upper, lower))
        found = solved_transposed(self._system, upper, lower)
        np.add.at(total, self._images.owner, np.einsum("nij,ni->nj", self._images.reflection, found))
        return total

    def _terms(self, flat: IntArray) -> FloatArray:
        """Polynomial terms (n, q) at some nodes."""
        centres = self._system.centres
        return centres.polynomial(centres.normalised(self._own[flat]))[:, : self._system.terms.shape[1]]


class BlockRBFDerivative:
    """Transpose of the filling of blocks by :class:`.block_rbf.PreparedBlockRBF`."""

    def __init__(self, method: PreparedBlockRBF, problem: Problem) -> None:
        points = problem.grid.points
        self._blocks = [
            (each, RadialMap(accurate(method._options.system, each.centres, problem), points[each.targets]))
            for each in method._blocks
        ]

    def push(self, change: FloatArray) -> None:
        """Fill blocks from their faces, in place."""
        for block, inside in self._blocks:
            change[block.targets] = inside.push(change[block.known])

    def pull(self, gradient: FloatArray) -> None:
        """Pass gradients from inside blocks on to their faces, in place."""
        for block, inside in self._blocks:
            found = inside.pull(gradient[block.targets])
            gradient[block.targets] = 0.0
            gradient[block.known] += found
