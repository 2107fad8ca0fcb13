"""Derivative, with respect to displacements and to the grid, of a composite that TFI replaces in closing gaps."""

from __future__ import annotations

import numpy as np

from ....grid import FloatArray, IntArray
from ....numerics.arrays import lengths
from ...composite import _on_faces
from ...gaps import Closing, PreparedInGaps
from ..constraints import Constraints
from .composite import GridDerivative, grid_derivative_of_composite


class InGapsGridDerivative:
    """Derivative of the blend of the method with TFI, whose share depends on the width of the gaps before the step."""

    def __init__(self, method: PreparedInGaps, closing: Closing, displacement: FloatArray) -> None:
        self._closing, self._problem, self._share = closing, method._problem, method.spread(closing.share)
        self._own: GridDerivative = grid_derivative_of_composite(method.method, displacement)
        self._lines: GridDerivative = grid_derivative_of_composite(method.transfinite, displacement)
        imposed = np.outer(closing.share, [1.0, 0.0, 0.0])
        self._scalar: GridDerivative = grid_derivative_of_composite(method.scalar, imposed)
        apart = self._lines.moved - self._own.moved
        self._apart = ((self._share > 0.0) & (self._share < 1.0)) * apart
        self.moved, self.kinks, self._again = method.apply(displacement), self._own.kinks + self._lines.kinks, None
        if self._problem.boundary.slip.curved:
            blend = self._own.moved + self._share * apart
            self._again = Constraints(self._problem, _on_faces(blend, self._problem))
            self.kinks += self._again.kinks
        self._across, self._of_gap = self._slope_of_gap(method, displacement)

    def _slope_of_gap(self, method: PreparedInGaps, displacement: FloatArray) -> tuple[IntArray, FloatArray]:
        """Sources (m,) across the gaps before the step, and the derivative (m, 3) of the share with respect to where
        its sources were, and less that of these."""
        rows, points = self._closing.rows, self._problem.source_points
        gap, across = method._across(points)
        after = points + displacement
        now = lengths(after[rows] - after[self._closing.other])
        away = (points[rows] - points[across[rows]]) / gap[rows, None]
        return across[rows], (lengths(self._closing.slope) * now / gap[rows])[:, None] * away

    def push(self, change: FloatArray, dx: FloatArray) -> FloatArray:
        """Change (n_nodes, 3) for changes of the sources (n_sources, 3) and of the grid (n_nodes, 3)."""
        closing, rows, out = self._closing, self._closing.rows, self._own.push(change, dx)
        out += self._share * (self._lines.push(change, dx) - out)
        before, share = dx[self._problem.source_flat], np.zeros_like(change)
        after = before + change
        share[rows, 0] = np.einsum("ni,ni->n", closing.slope, after[rows] - after[closing.other])
        share[rows, 0] += np.einsum("ni,ni->n", self._of_gap, before[rows] - before[self._across])
        out += self._apart * self._scalar.push(share, dx)[:, :1]
        if self._again:
            self._again.impose(_on_faces(out, self._problem), out, dx[self._problem.topology.first])
        return out

    def pull(self, gradient: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Gradients (n_sources, 3) of the sources and (n_nodes, 3) of the grid from that (n_nodes, 3) of the result."""
        closing, rows, first = self._closing, self._closing.rows, self._problem.topology.first
        g, of_first = np.array(gradient), np.zeros((len(first), 3))
        if self._again:
            face = self._again.gathered(g, of_first)
            g[first] += face
        part = np.zeros_like(g)
        part[:, 0] = np.einsum("ni,ni->n", g, self._apart)
        of_share, of_grid = self._scalar.pull(part)
        found, of_lines = self._lines.pull(self._share * g)
        of_own, more = self._own.pull((1.0 - self._share) * g)
        found, of_grid = found + of_own, of_grid + of_lines + more
        along, before = of_share[rows, :1] * closing.slope, np.zeros_like(found)
        np.add.at(found, rows, along)
        np.subtract.at(found, closing.other, along)
        of_gap = of_share[rows, :1] * self._of_gap
        for places, sign in ((rows, 1.0), (closing.other, -1.0)):
            np.add.at(before, places, sign * along)
        for places, sign in ((rows, 1.0), (self._across, -1.0)):
            np.add.at(before, places, sign * of_gap)
        of_grid[self._problem.source_flat] += before
        of_grid[first] += of_first
        return found, of_grid
