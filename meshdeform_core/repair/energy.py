"""The energy of a region as a sum over its cells.

No effect while all cells are healthy, and a smoothly growing effect as they become weak: a repair with a sharp
threshold would make a moving grid jump when the threshold is passed. The energy of the cells is therefore weighted,
against the elastic energy that holds the grid, by a *share* that grows as a power of the *excess* of the grid: the norm
of log(f / HEALTHY) over all corners, with f regularised to stay finite on inversion.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import scipy

from ..boundary.constraints import CurvedSurface
from ..grid import FloatArray, IntArray
from ..numerics.cell.foldover.elements import combined, growth, plane_slopes, slopes
from ..numerics.cell.foldover.loops import Unknowns, add_derivatives, energy_of_cells
from ..numerics.cell.foldover.samples import Maps, cofactors, inner, maps_at_sample, sample_slopes, turned_cofactors
from .tuned import ALONG, BETWEEN, FULL, HEALTHY, HELD, NORM, POWER, SLOWLY, SOFT

_TOGETHER = 1 << 15
"""Cells whose maps are found at a time, which bounds the memory."""
# The compiled loop tells, in a tenth of the time, which groups of so many cells need not be looked at for an excess.
_FEW = 64
# Measured work for the derivatives at one sample in a plane and in space, in the unit of :class:`.Limit`.
_SAMPLE = {2: 0.35, 3: 0.6}


class Penalty(NamedTuple):
    """The parameters of the energy, see :mod:`..numerics.cell.foldover`; ``exact``: the share of the indefinite part of
    its second derivatives that is added to their convex part."""

    eps: float = 0.0
    share: float = 1.0
    cubic: float = 0.0
    elastic: float = 0.0
    exact: float = 0.0


@dataclass(frozen=True)
class Energy:
    """The energy of cells, hexahedra or quadrilaterals.

    Attributes
    ----------
    start : (n, d) undeformed coordinates
    nodes : (m, 2^d) of each cell, in the order of :func:`..numerics.cell.foldover.samples.sample_slopes`
    weight, between : (m,) of the cells, and the share of their samples between corners
    mask : (m,) int64, bit s set where sample point s counts
    """

    start: FloatArray
    nodes: IntArray
    weight: FloatArray
    between: FloatArray
    mask: IntArray

    @cached_property
    def work(self) -> float:
        """Work of computing all second derivatives, see :class:`.Limit`."""
        return _SAMPLE[self.start.shape[1]] * int(np.unpackbits(self.mask.view(np.uint8)).sum())

    def maps(self, between: bool = True) -> Iterable[Maps]:
        """The maps at all samples, some at a time; those between corners only on request."""
        return self._in_plane if self.start.shape[1] == 2 else self._made(between)

    def _made(self, between: bool) -> Iterator[Maps]:
        slope = sample_slopes(self.start.shape[1])
        for low in range(0, len(self.nodes), _TOGETHER):
            for sample in range(len(slope) if between else self.nodes.shape[1]):
                some = low + np.flatnonzero(self.mask[low : low + _TOGETHER] >> sample & 1)
                if some.size:
                    yield maps_at_sample(self.start, self.nodes, slope, sample, some)

    @cached_property
    def _in_plane(self) -> list[Maps]:
        return list(self._made(False))

    def softened(self, power: float) -> Energy:
        """The energy with all weights raised to ``power``."""
        return dataclasses.replace(self, weight=self.weight**power)

    def with_between(self, share: FloatArray) -> Energy:
        """The energy with shares (m,) of the samples between corners; samples with a share of 0 are left out."""
        corners = (1 << self.nodes.shape[1]) - 1
        return dataclasses.replace(self, mask=np.where(share > 0.0, self.mask, self.mask & corners), between=share)

    def sum(
        self, x: FloatArray, reference: FloatArray, penalty: Penalty, low: int, high: int
    ) -> tuple[float, float, float]:
        """Energy, smallest determinant and largest f of the cells low <= m < high."""
        return energy_of_cells(x, *self._loops, reference, tuple(penalty), np.arange(low, high))

    def add(self, x: FloatArray, reference: FloatArray, penalty: Penalty, *rest: Any) -> None:
        """See :func:`..numerics.cell.foldover.loops.add_derivatives`; ``rest``: its arguments from ``which`` on."""
        add_derivatives(x, *self._loops, reference, tuple(penalty), *rest)

    @cached_property
    def _loops(self) -> tuple[Any, ...]:
        weights = np.stack([self.weight, self.between, self.weight**HELD], axis=1)
        return self.nodes, self.start, self.mask, sample_slopes(self.start.shape[1]), weights

    def excess(self, x: FloatArray) -> FloatArray:
        """Excess (m,) of the cells, with corners as samples."""
        count = len(self.nodes)
        corners, total = self.with_between(np.zeros(count)), np.zeros(count)
        lows = range(0, count, _FEW)
        weak = [low for low in lows if corners.sum(x, x, Penalty(SOFT), low, min(low + _FEW, count))[2] > HEALTHY]
        some = np.flatnonzero(np.isin(np.arange(count) // _FEW * _FEW, weak))
        part = dataclasses.replace(corners, nodes=self.nodes[some], weight=self.weight[some], mask=corners.mask[some])
        for maps in part.maps(between=False):
            f = _slopes(maps.jacobians(x), SOFT)[0]
            total[some[maps.cell]] += np.log(np.maximum(f / HEALTHY, 1.0)) ** NORM
        return np.asarray(total ** (1.0 / NORM))

    def excess_products(self, x: FloatArray, change: FloatArray, gradient: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Change (m,) of the excess for a ``change`` (n, d) of ``x``, and the transpose for a ``gradient`` (m,)."""
        excess, along, found = self.excess(x), np.zeros(len(self.nodes)), np.zeros_like(change)
        for maps in self.maps(between=False):
            a, of = maps.jacobians(x), maps.cell
            f, u, v, *_ = _slopes(a, SOFT)
            beyond = np.log(np.maximum(f / HEALTHY, 1.0))
            share = np.divide(beyond, excess[of], out=np.zeros_like(f), where=beyond > 0.0) ** (NORM - 1.0)
            force = share / f * (u * a + v * cofactors(a))
            along[of] += inner(force, maps.jacobians(change))
            found += maps.on_nodes(gradient[of] * force, len(x))
        return along, found

    def products(
        self, x: FloatArray, penalty: Penalty, change: FloatArray, share: float, between: FloatArray
    ) -> tuple[FloatArray, float, FloatArray]:
        """Change (n, d) of the gradient for changes of ``x`` (n, d), of the share, and of the shares ``between`` (m,)
        of samples between corners; and the transposes with respect to the two kinds of shares."""
        found, total, gradient = np.zeros_like(change), 0.0, np.zeros(len(self.nodes))
        for maps in self.maps():
            a, t, of = maps.jacobians(x), maps.jacobians(change), maps.cell
            f, *first = _slopes(a, penalty.eps)
            _, one, two = growth(f)
            u, v, w, p, q, r = combined(first, self.weight[of] + penalty.cubic * one, penalty.cubic * two)
            k, part = cofactors(a), 1.0 if maps.at_corners else self.between[of]
            ta, tk = inner(t, a), inner(t, k)
            along = u * ta + v * tk
            total += float((part * along).sum())
            force = w * t + v * turned_cofactors(a, t) + (p * ta + q * tk) * a + (q * ta + r * tk) * k
            own = share * part
            if maps.at_corners:
                force = penalty.share * part * force + penalty.elastic * self.weight[of] ** HELD * t
            else:
                force, own = penalty.share * part * force, own + penalty.share * between[of]
                gradient[of] += penalty.share * along
            found += maps.on_nodes(force + own * (u * a + v * k), len(x))
        return found, total, gradient


def _slopes(a: FloatArray, eps: float) -> tuple[FloatArray, ...]:
    """f of maps (d, d, m) and its derivatives: f, u, v, w, q, r as in :mod:`..numerics.cell.foldover.elements`."""
    k = cofactors(a)
    g, det = inner(a, a), (a[0] * k[0]).sum(axis=0)
    chi, root = _regular(det, eps)
    if len(a) == 2:
        return plane_slopes(g, det, chi, root)
    return slopes(g, det, chi, root, chi ** (-2.0 / 3.0))[:6]


def components(vectors: FloatArray, axes: FloatArray) -> FloatArray:
    """Products (n, d) of vectors (n, e) and ``axes`` (d, e); the same to the last bit for any n, unlike ``@``."""
    return np.asarray(sum(vectors[:, e, None] * axes[:, e] for e in range(axes.shape[1])))


@dataclass(frozen=True)
class Slide:
    """Nodes (k,) of a region that remain on a surface; their coordinates (k, d) are along ``axes`` (d, 3) from the
    ``origin`` (3,)."""

    nodes: IntArray
    surface: CurvedSurface
    axes: FloatArray
    origin: FloatArray

    def normals(self, x: FloatArray) -> FloatArray:
        """Unit normals (k, d) of the surface near coordinates ``x``."""
        return components(self.surface.normals(self._in_space(x)), self.axes)

    def back(self, x: FloatArray) -> FloatArray:
        """The coordinates projected onto the surface."""
        return components(self.surface.project(self._in_space(x)) - self.origin, self.axes)

    def slopes(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The derivatives (k, d, d) of :meth:`back` and of :meth:`normals`."""
        onto, turning = self.surface.slopes(self._in_space(x))
        return self.axes @ onto @ self.axes.T, self.axes @ turning @ self.axes.T

    def _in_space(self, x: FloatArray) -> FloatArray:
        return components(x, self.axes.T) + self.origin


@dataclass(frozen=True)
class Region:
    """Cells whose nodes are moved; nodes have local numbers and coordinates (n, d) in space or in the plane.

    ``fixed`` (n_unknowns, d, d) projects onto the directions in which unknowns may move, ignoring ``slides``.
    """

    energy: Energy
    unknowns: Unknowns
    fixed: FloatArray
    slides: tuple[Slide, ...] = ()

    @property
    def n_unknowns(self) -> int:
        return len(self.fixed)

    def directions(self, x: FloatArray) -> tuple[Unknowns, FloatArray]:
        """Dependence of nodes at ``x`` (n, d) on the unknowns, and projectors onto the directions of these."""
        if not self.slides:
            return self.unknowns, self.fixed
        frame, plain, freedom = self.unknowns.frame.copy(), self.unknowns.plain.copy(), self.fixed.copy()
        for slide in self.slides:
            across = slide.normals(x[slide.nodes])
            unknown = self.unknowns.number[slide.nodes]
            freedom[unknown] -= across[:, :, None] * across[:, None, :]
            frame[slide.nodes], plain[slide.nodes] = freedom[unknown], False
        return Unknowns(self.unknowns.number, frame, plain), freedom

    def spreading(self, frame: FloatArray) -> scipy.sparse.bsr_array:
        """The matrix (n d, n_unknowns d) from changes of the unknowns to those of nodes with frames (n, d, d)."""
        (n, d, _), number = frame.shape, self.unknowns.number
        free = number >= 0
        starts = np.append(0, np.cumsum(free))
        return scipy.sparse.bsr_array((frame[free], number[free], starts), shape=(n * d, self.n_unknowns * d))

    def moved(self, x: FloatArray, unknowns: Unknowns, step: FloatArray, length: float) -> FloatArray:
        """Coordinates after ``length`` times the step (n_unknowns, d) of the unknowns."""
        result = x + length * (self.spreading(unknowns.frame) @ step.ravel()).reshape(x.shape)
        for slide in self.slides:
            result[slide.nodes] = slide.back(result[slide.nodes])
        return result


def _regular(det: FloatArray, eps: float) -> tuple[FloatArray, FloatArray]:
    """chi and sqrt(eps^2 + D^2), computed without cancellation."""
    if eps == 0.0:
        return np.maximum(det, 0.0), np.abs(det)
    root = np.sqrt(eps * eps + det * det)
    less = np.where(det > 0.0, 1.0, root - det)
    return np.where(det > 0.0, 0.5 * (det + root), 0.5 * eps * eps / less), root


class Share(NamedTuple):
    """The share of a grid, 0 where all cells are healthy, the energy to which it applies, and the derivatives (m,) of
    the share and of each cell's share of samples between corners with respect to the excess of the cells."""

    value: float
    energy: Energy
    slope: FloatArray
    slope_between: FloatArray


def share_of(energy: Energy, x: FloatArray) -> Share:
    """The share for a grid at ``x`` (n, d).

    Samples of hexahedra between corners are weighted by the excess of their own cell, with corners as the upper limit.
    """
    excess = energy.excess(x)
    largest = float(excess.max(initial=0.0))
    if largest == 0.0:
        return Share(0.0, energy, excess, excess)
    whole, beyond = largest * float(((excess / largest) ** NORM).sum()) ** (1.0 / NORM), excess - BETWEEN
    between = np.clip(beyond / (FULL - BETWEEN), 0.0, 1.0) ** SLOWLY
    slope = POWER / FULL * (whole / FULL) ** (POWER - 1.0) * (excess / whole) ** (NORM - 1.0)
    inside = (between > 0.0) & (between < 1.0)
    of_between = np.divide(SLOWLY * between, beyond, out=np.zeros_like(excess), where=inside)
    return Share((whole / FULL) ** POWER, energy.with_between(between), slope, of_between)


def kept_along_lines(share: float) -> tuple[float, float]:
    """The part of the differences along the lines of an extruded grid that a repair keeps, and its derivative with
    respect to the share; smooth where it ends."""
    part = min(share / ALONG, 1.0)
    return (1.0 - part) ** 2 * (1.0 + 2.0 * part), -6.0 * part * (1.0 - part) / ALONG
