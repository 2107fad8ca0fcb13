"""The derivative of a repaired grid with respect to the grid of the method.

At the minimum the gradient of the energy vanishes, whatever the method's grid. By the implicit function theorem, a
change of that grid moves the nodes by the solution of a linear system with the Hessian of the energy. The right-hand
side collects how the energy depends on that grid: through the elastic reference, and through the shares of cells.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy
from scipy.sparse.linalg import LinearOperator, gcrotmk

from ..errors import MethodError
from ..grid import FloatArray
from .constraints import Extrusion
from .energy import Penalty, components, kept_along_lines, share_of
from .region import Basis, Plot
from .tuned import CUBIC, POLISHED

_LOOSE, _ITERATIONS, _CYCLES = 1e-3, 5000, 3
"""Tolerance and iterations of a solution with the matrix in single precision, and cycles of 20 solutions, at most."""
_ENOUGH, _SOLVED = 1e-15, 1e-9
"""Relative residuals at which a solution is exact enough, and at which it is one at all; refined from 1e-8 on."""
_STEPS = 2
_SINGULAR = "the derivative of the repaired grid is the solution of a nearly singular system; turn repairs off"


def derivative_of_repair(basis: Basis, start: FloatArray, end: FloatArray, polish: bool) -> RepairDerivative | None:
    """The derivative of the repair from ``start``, the method's grid (n_nodes, 3), to ``end``, the minimum of the
    energy; ``None`` where no cell is weak."""
    if basis.extrusion is not None:
        undeformed, (extrusion, plane) = basis.original.grid.points, basis.extrusion
        changes = [points - undeformed for points in (start, end)]
        first, last = (extrusion.flattened(change) for change in changes)
        if first is not None and last is not None:
            flat = extrusion.plane.points
            inside = derivative_of_repair(plane, flat + first, flat + last, polish)
            apart = (extrusion.along_lines(changes[0], first), extrusion.along_lines(changes[1], last))
            return _Extruded(extrusion, inside, *apart) if isinstance(inside, _AtMinimum) else None
    found = _AtMinimum(basis.whole, start, end, polish) if basis.whole else None
    return found if found and found.share > 0.0 else None


class _AtMinimum:
    """The derivative for x = y + B F u: coordinates x of the repaired grid, y of the method's grid, unknowns u.

    Nodes that slide on curved surfaces have x = B F u: coordinates of their own, within the triangle that B projects
    onto; B is the identity for all others. Forces vanish in the directions of F, which follow the normals.

    ``_free``, ``_spread``: F and B F; ``_turning``: the change of the normal times the force on a node as it slides;
    ``_slides`` (n, 1) is 1 at nodes that slide, else 0.
    """

    def __init__(self, plot: Plot, start: FloatArray, end: FloatArray, polish: bool) -> None:
        self._plot, self._start, self._x = plot, plot.inside(start), plot.inside(end)
        self.share, energy, of_share, of_between = share_of(plot.region.energy, self._start)
        if polish and self.share <= 1.0:
            self.share, of_share = 1.0, np.zeros_like(of_share)
        self._slopes = of_share, of_between
        self._energy = energy.softened(POLISHED) if polish else energy
        self._region = replace(plot.region, energy=self._energy)
        self._penalty = Penalty(0.0, self.share, CUBIC, 1.0, 1.0)
        self._none = np.zeros(len(energy.nodes))
        self._place()

    def _place(self) -> None:
        """Find the directions of the unknowns at the coordinates."""
        region, system, x = self._region, self._plot.system, self._x
        n, d = x.shape
        frame, onto = region.directions(x)[0].frame, np.tile(np.eye(d), (n, 1, 1))
        turning, self._slides = np.zeros((n, d, d)), np.zeros((n, 1))
        if region.slides:
            system.fill(replace(region, slides=()), x, self._start, self._penalty)
        for slide in region.slides:
            at, (back, change) = slide.nodes, slide.slopes(x[slide.nodes])
            along = np.einsum("ni,ni->n", slide.normals(x[at]), system.gradient[region.unknowns.number[at]])
            onto[at], turning[at], self._slides[at] = back, along[:, None, None] * change, 1.0
        self._free, self._spread = region.spreading(frame), region.spreading(onto @ frame)
        self._turning = scipy.sparse.bsr_array((turning, np.arange(n), np.arange(n + 1)))

    def push(self, change: FloatArray) -> FloatArray:
        """Change (n_nodes, 3) of the repaired grid for a change of the method's grid."""
        return self.push_with_share(change)[0]

    def push_with_share(self, change: FloatArray) -> tuple[FloatArray, float]:
        """As :meth:`push`, and the change of the share."""
        plot, moved = self._plot, np.array(change)
        given = components(change[plot.nodes], plot.axes)
        excess, _ = self._energy.excess_products(self._start, given, self._none)
        shares, slid = (float(self._slopes[0] @ excess), self._slopes[1] * excess), self._slides * given
        force, _, _ = self._energy.products(self._x, self._penalty._replace(elastic=0.0), given, *shares)
        step = _times(self._spread, self._solved(-_times(self._free.T, force - self._hessian(slid))))
        moved[plot.moved] += plot.shift(step - slid)
        return moved, shares[0]

    def pull(self, gradient: FloatArray, of_share: float = 0.0) -> FloatArray:
        """Gradient (n_nodes, 3) with respect to the method's grid, from those with respect to the repaired grid and to
        the share."""
        plot, pulled, own = self._plot, np.array(gradient), np.zeros_like(self._x)
        np.add.at(own, plot.at, gradient[plot.moved] @ plot.axes.T)
        step = _times(self._free, self._solved(-_times(self._spread.T, own), transposed=True))
        free = self._penalty._replace(elastic=0.0)
        found, share, between = self._energy.products(self._x, free, step, 0.0, self._none)
        of_excess = (share + of_share) * self._slopes[0] + between * self._slopes[1]
        _, rest = self._energy.excess_products(self._start, step, of_excess)
        pulled[plot.nodes] += (found + rest - self._slides * (self._hessian(step) + own)) @ plot.axes
        return pulled

    def settle(self, rounding: float) -> float:
        """Continue to the exact minimum from coordinates that were rounded by up to ``rounding`` when written.

        Returns the largest distance moved beyond the rounding, relative to the shortest local edge; infinity if the
        Hessian is not positive definite, or too nearly singular for the linear system to be solved.
        """
        before = self._x
        for _ in range(_STEPS):
            self._plot.system.fill(self._region, self._x, self._start, self._penalty)
            try:
                self._x = self._x + _times(self._spread, self._solved(-self._plot.system.gradient))
            except MethodError:
                return float("inf")
            for slide in self._region.slides:
                self._x[slide.nodes] = slide.back(self._x[slide.nodes])
            self._place()
        moved = np.maximum(np.abs(self._x - before).max(axis=1) - rounding, 0.0)
        return float((moved / self._plot.edges).max())

    def _solved(self, right: FloatArray, transposed: bool = False) -> FloatArray:
        """Solution (n_unknowns, d) of the linear system with the Hessian and the ``right``-hand side.

        Newton's method, with which steps are found, has another matrix where nodes slide on curved surfaces. A
        :class:`MethodError` tells that the Hessian is not positive definite, or too nearly singular.
        """
        system, size = self._plot.system, right.size
        first, last, turning = self._spread, self._free.T, self._turning
        if transposed:
            first, last, turning = self._free, self._spread.T, self._turning.T
        # Nothing but round-off is in the directions in which unknowns must not move.
        right = np.einsum("nij,nj->ni", self._region.directions(self._x)[1], right)
        system.fill(self._region, self._x, self._start, self._penalty)

        def image(unknowns: FloatArray) -> FloatArray:
            moved = _times(first, unknowns.reshape(right.shape))
            return _times(last, self._hessian(moved) - _times(turning, moved)).ravel()

        def step(rest: FloatArray) -> FloatArray:
            system.gradient[...] = -rest.reshape(right.shape)
            found, convex = system.direction(_LOOSE, _ITERATIONS)
            # Not a minimum, or a nearly singular one, for which further steps would take minutes.
            if not convex or system.iterations == _ITERATIONS:
                raise MethodError(_SINGULAR)
            return found.ravel()

        matrix, inverse = (LinearOperator((size, size), each, dtype=float) for each in (image, step))
        found, rest, after = np.zeros(size), right.ravel(), np.linalg.norm(right)
        for _ in range(_CYCLES):
            found = found + gcrotmk(matrix, rest, rtol=10 * _SOLVED, atol=0.0, maxiter=_CYCLES, M=inverse)[0]
            rest = right.ravel() - matrix @ found
            before, after = after, np.linalg.norm(rest)
            if not after > _ENOUGH * np.linalg.norm(right) or after > 0.5 * before:
                break
        if not after <= _SOLVED * np.linalg.norm(right):
            raise MethodError(_SINGULAR)
        return np.asarray(found.reshape(right.shape))

    def _hessian(self, change: FloatArray) -> FloatArray:
        """Change (n, d) of the gradient for a change (n, d) of the coordinates."""
        return self._energy.products(self._x, self._penalty, change, 0.0, self._none)[0]


def _times(matrix: scipy.sparse.sparray, vectors: FloatArray) -> FloatArray:
    """Product (m, d) of a matrix (m d, n d) and vectors (n, d)."""
    return np.asarray((matrix @ vectors.ravel()).reshape(-1, vectors.shape[1]))


class _Extruded:
    """The derivative on the plane grid that a grid is extruded from; held nodes follow the method.

    ``before`` and ``after`` (n_nodes, 3): what differs along lines in the method's grid and in the repaired one.
    """

    def __init__(self, extrusion: Extrusion, inside: _AtMinimum, before: FloatArray, after: FloatArray) -> None:
        self._extrusion, self._inside, self._apart = extrusion, inside, before
        self._held = extrusion.held[extrusion.line, None]
        self._kept, self._slope = kept_along_lines(inside.share)
        # Nothing is kept where cells would be invalid.
        if np.abs(after - self._kept * before).max(initial=0.0) > np.abs(after).max(initial=0.0):
            self._kept = self._slope = 0.0

    def push(self, change: FloatArray) -> FloatArray:
        extrusion, mean = self._extrusion, self._extrusion.mean(change)
        inside, share = self._inside.push_with_share(mean)
        apart = self._kept * extrusion.along_lines(change, mean) + self._slope * share * self._apart
        return np.where(self._held, change, inside[extrusion.line] + apart)

    def pull(self, gradient: FloatArray) -> FloatArray:
        extrusion, free = self._extrusion, np.where(self._held, 0.0, gradient)
        total = extrusion.summed(free)
        # The mean is linear: what differs from it is subtracted from both.
        found = self._inside.pull(total, self._slope * float((free * self._apart).sum())) - self._kept * total
        return gradient - (1.0 - self._kept) * free + extrusion.of_mean(found)

    def settle(self, rounding: float) -> float:
        return self._inside.settle(rounding)


RepairDerivative = _AtMinimum | _Extruded
