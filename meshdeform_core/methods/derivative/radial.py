"""Derivative of radial basis functions: they are linear, so that only transposes are new."""

from __future__ import annotations

import dataclasses

import numpy as np

from ...errors import MethodError
from ...grid import FloatArray, IntArray
from ...numerics.exact.basis import BASES
from ...numerics.exact.radial import radial_sums
from ..base import Account, Problem
from ..scattered.block_rbf import PreparedBlockRBF
from ..scattered.radial_system import RadialSystem, SystemOptions
from ..scattered.rbf import PreparedRBF
from ..scattered.rbf_sums import Centres

_TOLERANCE = 1e-13
"""Of iterative solutions: a transpose is one to this accuracy only."""


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
        """Gradient (m, 3) from that at the points.

        The matrix [A P; P^T 0] is symmetric; a right-hand side of its lower rows is met by a combination of the
        columns of P, the rest by the solver as it is.
        """
        centres, terms = self._system.centres.points, self._system.terms
        upper = radial_sums(self._kind, centres, self._x, np.ascontiguousarray(gradient))
        part = terms @ np.linalg.solve(terms.T @ terms, self._terms.T @ gradient)
        rest = upper - radial_sums(self._kind, centres, centres, part)
        return np.asarray(part + self._system.solve(rest, Account(), None)[0])


def accurate(options: SystemOptions, centres: Centres, problem: Problem) -> RadialSystem:
    """The system with a direct solution, or an iterative one to round-off."""
    return RadialSystem(dataclasses.replace(options, solver="auto", tolerance=_TOLERANCE), centres, problem.memory)


class RBFDerivative:
    """Derivative of the displacement of some nodes with respect to that of the sources; the same at all of them."""

    def __init__(self, method: PreparedRBF, problem: Problem, flat: IntArray) -> None:
        if method.options.greedy != "none":
            raise MethodError(
                "method.rbf.greedy has no derivative: the centres that it keeps change abruptly with the displacement; "
                'use greedy = "none"'
            )
        self._images, self.flat = method._images, flat
        self._map = RadialMap(accurate(method.options.system, method.centres, problem), problem.grid.points[flat])
        self._n = len(problem.source_numbers)

    def push(self, change: FloatArray, out: FloatArray) -> None:
        """Write the change of the nodes into their rows of ``out`` (n_nodes, 3), for one of the sources."""
        out[self.flat] = self._map.push(self._images.displaced(change))

    def pull(self, gradient: FloatArray) -> FloatArray:
        """Gradient (n_sources, 3) from that of the nodes, rows of ``gradient`` (n_nodes, 3)."""
        found, total = self._map.pull(gradient[self.flat]), np.zeros((self._n, 3))
        np.add.at(total, self._images.owner, np.einsum("nij,ni->nj", self._images.reflection, found))
        return total


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
