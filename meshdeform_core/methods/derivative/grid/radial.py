"""Derivative of radial basis functions with respect to displacements and to the grid, with exact sums.

Centres and nodes move, and with them the matrix and the polynomial of the system. The origin and, for thin plate
splines, the unit of length are held fixed, as the result does not depend on them.
"""

from __future__ import annotations

import numpy as np

from ....errors import MethodError
from ....grid import FloatArray, IntArray
from ....numerics.exact.basis import BASES
from ....numerics.exact.radial import radial_sums
from ....numerics.exact.radial_tangents import add_radial_gradients, add_radial_tangents
from ....parallel import Shared, empty, for_chunks
from ...base import Account, Problem
from ...scattered.block_rbf import PreparedBlockRBF
from ...scattered.centres import Centres
from ...scattered.rbf import RBF, PreparedRBF
from ..kinks import Kinks
from ..radial import accurate
from .radius import of_block, of_sources

_CHUNK = 256
_PORTIONS = 16


_NONE = "has no derivative with respect to the grid on which it is prepared"


class MovingMap:
    """The interpolation of values (m, 3) given at centres, where values, centres and the ``points`` (n, 3) change.

    Raises
    ------
    MethodError
        For centres in a plane of a 3-D grid or on a line, which they may leave.
    """

    def __init__(
        self, options: RBF, centres: Centres, problem: Problem, points: FloatArray, values: FloatArray
    ) -> None:
        self._kind, self._centres = BASES[options.basis], centres
        self._system = accurate(options.system, centres, problem)
        if self._system.terms.shape[1] < (4 if problem.plane_normal is None else 3):
            raise MethodError(f"an interpolation between centres in a plane, or on a line, {_NONE}")
        self._x, self._y = centres.normalised(points), centres.points
        self._terms = centres.polynomial(self._x)
        self._coefficients, self._polynomial = self._system.solve(values, Account(), None)
        self._portions = max(1, min(_PORTIONS, len(points) // _CHUNK))

    def push(self, values: FloatArray, dy: FloatArray, dx: FloatArray, growth: float = 0.0) -> FloatArray:
        """Change (n, 3) for changes of values (m, 3), centres (m, 3) and points (n, 3); ``growth``: relative change of
        the support radius."""
        scale, axes, coefficients = self._centres.scale, self._centres.axes, self._coefficients
        dy = np.ascontiguousarray(dy / scale - growth * self._y)
        dx = np.ascontiguousarray(dx / scale - growth * self._x)
        slope = axes.T @ self._polynomial[1:]
        upper = values - self._tangents(self._y, dy, dy) - dy @ slope
        lower = -np.concatenate([np.zeros((1, 3)), axes @ (dy.T @ coefficients)])
        change, polynomial = self._solved(upper, lower)
        moved = self._tangents(self._x, dx, dy) + dx @ slope + self._terms @ polynomial
        return np.asarray(moved + radial_sums(self._kind, self._x, self._y, change))

    def pull(self, gradient: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, float]:
        """Gradients of values (m, 3), centres (m, 3), points (n, 3) and growth from that (n, 3) of the interpolated
        values."""
        g, axes = np.ascontiguousarray(gradient), self._centres.axes
        of_values, lower = self._solved(radial_sums(self._kind, self._y, self._x, g), self._terms.T @ g)
        slope = axes.T @ self._polynomial[1:]
        of_x, of_y = self._gradients(self._x, g)
        of_x += g @ slope.T
        one, other = self._gradients(self._y, -of_values)
        of_y += one + other
        of_y -= of_values @ slope.T + self._coefficients @ (axes.T @ lower[1:]).T
        growth = -float((of_y * self._y).sum() + (of_x * self._x).sum())
        return of_values, of_y / self._centres.scale, of_x / self._centres.scale, growth

    def _solved(self, upper: FloatArray, lower: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Solution (m, 3), (q, 3) of the symmetric system [A P; P^T 0]."""
        terms = self._system.terms
        part = terms @ np.linalg.solve(terms.T @ terms, lower)
        found, polynomial = self._system.solve(upper - self._system.multiply(part), Account(), None)
        return part + found, polynomial

    def _tangents(self, x: FloatArray, dx: FloatArray, dy: FloatArray) -> FloatArray:
        """Change (n, 3) of the sums at ``x`` for fixed coefficients."""
        found = np.zeros_like(x)

        def work(lo: int, hi: int) -> None:
            add_radial_tangents(self._kind, x[lo:hi], dx[lo:hi], self._y, dy, self._coefficients, found[lo:hi])

        for_chunks(work, len(x), _CHUNK, shared=[Shared(found)])
        return found

    def _gradients(self, x: FloatArray, gradient: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Transpose of :meth:`_tangents`: gradients of ``x`` and of the centres."""
        of_x, of_y = np.zeros_like(x), empty((self._portions, *self._y.shape))
        cut = np.linspace(0, len(x), self._portions + 1).astype(np.int64)

        def work(lo: int, hi: int) -> None:
            for n in range(lo, hi):
                of_y[n] = 0.0
                some = slice(cut[n], cut[n + 1])
                add_radial_gradients(
                    self._kind, x[some], self._y, self._coefficients, gradient[some], of_x[some], of_y[n]
                )

        rows = [Shared(of_x, lambda lo, hi: range(cut[lo], cut[hi])), Shared(of_y)]
        for_chunks(work, self._portions, 1, shared=rows)
        return of_x, np.asarray(sum(of_y[n] for n in range(self._portions)))


class RBFGridDerivative:
    """Derivative of the displacement of the nodes ``flat`` at one displacement (n_sources, 3) of the sources."""

    def __init__(self, method: PreparedRBF, problem: Problem, flat: IntArray, displacement: FloatArray) -> None:
        if method.options.greedy != "none":
            raise MethodError(f"method.rbf.greedy {_NONE}: other centres are chosen there")
        self._images, self._problem, self._flat = method._images, problem, flat
        self._radius = of_sources(method.options, problem)
        self.kinks, self.of_grid = Kinks(), self._radius.kinks if self._radius else Kinks()
        values = self._images.displaced(displacement)
        self._map = MovingMap(method.options, method.centres, problem, problem.grid.points[flat], values)

    def push(self, change: FloatArray, dx: FloatArray, out: FloatArray) -> None:
        """Write the change of the nodes into their rows of ``out`` (n_nodes, 3), for changes of the sources
        (n_sources, 3) and of the grid (n_nodes, 3)."""
        images = self._images
        dy = images.displaced(dx[self._problem.source_flat])
        growth = self._radius.push(dx) if self._radius else 0.0
        out[self._flat] = self._map.push(images.displaced(change), dy, dx[self._flat], growth)

    def pull(self, gradient: FloatArray, of_grid: FloatArray) -> FloatArray:
        """Gradient (n_sources, 3) from that of the nodes, rows of ``gradient`` (n_nodes, 3); adds that of the grid."""
        of_values, of_y, of_x, growth = self._map.pull(gradient[self._flat])
        if self._radius:
            self._radius.pull(growth, of_grid)
        of_grid[self._flat] += of_x
        of_grid[self._problem.source_flat] += self._gathered(of_y)
        return self._gathered(of_values)

    def _gathered(self, of_images: FloatArray) -> FloatArray:
        """Gradient (n_sources, 3) from that of all images of the sources, the sources themselves included."""
        total = np.zeros((len(self._problem.source_flat), 3))
        np.add.at(total, self._images.owner, np.einsum("nij,ni->nj", self._images.reflection, of_images))
        return total


class BlockRBFGridDerivative:
    """Derivative of :class:`...scattered.block_rbf.PreparedBlockRBF`, which fills blocks, at its result ``moved``
    (n_nodes, 3)."""

    def __init__(self, method: PreparedBlockRBF, problem: Problem, moved: FloatArray) -> None:
        points, options = problem.grid.points, method._options
        self._blocks = [
            (
                each,
                MovingMap(options, each.centres, problem, points[each.targets], moved[each.known]),
                of_block(options, problem, each.known),
            )
            for each in method._blocks
        ]
        self.kinks = sum((radius.kinks for _, _, radius in self._blocks if radius), Kinks())

    def push(self, change: FloatArray, dx: FloatArray) -> None:
        """Fill blocks from their faces, in place, for a change ``dx`` (n_nodes, 3) of the grid."""
        for block, inside, radius in self._blocks:
            growth = radius.push(dx) if radius else 0.0
            change[block.targets] = inside.push(change[block.known], dx[block.known], dx[block.targets], growth)

    def pull(self, gradient: FloatArray, of_grid: FloatArray) -> None:
        """Pass gradients from inside blocks on to their faces, in place; add that of the grid to ``of_grid``."""
        for block, inside, radius in self._blocks:
            of_values, of_y, of_x, growth = inside.pull(gradient[block.targets])
            if radius:
                radius.pull(growth, of_grid)
            gradient[block.targets] = 0.0
            gradient[block.known] += of_values
            of_grid[block.known] += of_y
            of_grid[block.targets] += of_x
