"""The energy of a region as a sum over elements: hexahedra, or triangles at the corners of quadrilaterals.

No effect while all cells are healthy, and a smoothly growing effect as they become weak: a repair with a sharp
threshold would make a moving grid jump when the threshold is passed. The energy of the cells is therefore weighted,
against the elastic energy that holds the grid, by a *share* that grows as a power of the *excess* of the grid: the norm
of log(f / HEALTHY) over all corners, with f regularised to stay finite on inversion.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from ..grid import BoolArray, FloatArray, IntArray
from ..numerics.cell.foldover.elements import Unknowns, combined, growth, slopes, slopes_of_triangle
from ..numerics.cell.foldover.samples import (
    CORNERS,
    SAMPLES,
    Maps,
    cofactors,
    inner,
    maps_at_sample,
    shortest_edges,
    turned_cofactors,
)
from .tuned import ALONG, BETWEEN, COLLAPSED, FULL, HEALTHY, HELD, NORM, POWER, SLOWLY, SOFT

_CORNERS = (1 << CORNERS) - 1
_TOGETHER = 1 << 15
"""Hexahedra whose maps are found at a time, which bounds the memory."""
# Measured work for the derivatives at one sample of a hexahedron, and of a triangle, in the unit of :class:`.Limit`.
_SAMPLE, _TRIANGLE = 0.9, 0.4


class Penalty(NamedTuple):
    """The parameters of the energy, see :mod:`..numerics.cell.foldover`; ``exact``: the share of the indefinite part of
    its second derivatives that is added to their convex part."""

    eps: float = 0.0
    share: float = 1.0
    cubic: float = 0.0
    elastic: float = 0.0
    exact: float = 0.0


class Rows(NamedTuple):
    """The rows ``first <= row < last`` of a block-sparse matrix.

    The ``columns`` of row r begin at ``starts[r]``; ``matrix`` (n_blocks, d, d) holds the blocks of these rows,
    ``gradient`` (n_unknowns, d) all rows.
    """

    first: int
    last: int
    starts: IntArray
    columns: NDArray[np.int32]
    matrix: FloatArray
    gradient: FloatArray

    @property
    def pattern(self) -> tuple[int, int, IntArray, NDArray[np.int32]]:
        """The arguments of the loops over rows."""
        return self[:4]


@dataclass(frozen=True)
class _Elements:
    """What the two kinds of elements have in common: their excess, and products with derivatives, from their maps.

    Attributes
    ----------
    start : undeformed coordinates
    nodes : (m, c) nodes of each element
    weight : (m,) of the cells
    """

    start: FloatArray
    nodes: IntArray
    weight: FloatArray

    maps: ClassVar[Callable[..., Iterator[Maps]]]

    def part(self, maps: Maps) -> FloatArray | float:
        """The share of the maps, beside that of all samples."""
        return 1.0

    def edges_at_nodes(self) -> FloatArray:
        """Length (n,) of the shortest undeformed edge at every node, ignoring zero lengths; infinite if none."""
        pairs = [(a, a | bit) for a in range(8) for bit in (1, 2, 4) if not a & bit]
        return shortest_edges(self.start, self.nodes, np.array(pairs if self.nodes.shape[1] == 8 else [(0, 1), (0, 2)]))

    def softened(self, power: float) -> Self:
        """The energy with all weights raised to ``power``."""
        return dataclasses.replace(self, weight=self.weight**power)

    def excess(self, x: FloatArray) -> FloatArray:
        """Excess (m,) of the elements, with corners as samples."""
        total = np.zeros(len(self.nodes))
        for maps in self.maps(between=False):
            f = _slopes(maps.jacobians(x), SOFT)[0]
            total[maps.element] += np.log(np.maximum(f / HEALTHY, 1.0)) ** NORM
        return np.asarray(total ** (1.0 / NORM))

    def excess_products(self, x: FloatArray, change: FloatArray, gradient: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Change (m,) of the excess for a ``change`` (n, d) of ``x``, and the transpose for a ``gradient`` (m,)."""
        excess, along, found = self.excess(x), np.zeros(len(self.nodes)), np.zeros_like(change)
        for maps in self.maps(between=False):
            a, of = maps.jacobians(x), maps.element
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
            a, t, of = maps.jacobians(x), maps.jacobians(change), maps.element
            f, *first = _slopes(a, penalty.eps)
            _, one, two = growth(f)
            u, v, w, p, q, r = combined(first, self.weight[of] + penalty.cubic * one, penalty.cubic * two)
            k, part = cofactors(a), self.part(maps)
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


@dataclass(frozen=True)
class Hexahedra(_Elements):
    """The energy of hexahedra, with ``nodes`` (m, 8) in the order of
    :func:`..numerics.cell.foldover.samples.sample_slopes`.

    Attributes
    ----------
    mask : (m,) int64, bit s set where sample point s counts
    slope : (27, 8, 3) of the shape functions
    between : (m,) share of the samples between corners
    """

    mask: IntArray
    slope: FloatArray
    between: FloatArray

    @property
    def work(self) -> float:
        """Work of computing all second derivatives, see :class:`.Limit`."""
        return _SAMPLE * int(np.bitwise_count(self.mask).sum())

    def with_between(self, share: FloatArray) -> Hexahedra:
        """The energy with shares (m,) of the samples between corners; samples with a share of 0 are left out."""
        return dataclasses.replace(self, mask=np.where(share > 0.0, self.mask, self.mask & _CORNERS), between=share)

    def maps(self, between: bool = True) -> Iterator[Maps]:
        """The maps at all samples, some at a time; those between corners only on request."""
        for low in range(0, len(self.nodes), _TOGETHER):
            for sample in range(SAMPLES if between else CORNERS):
                some = low + np.flatnonzero(self.mask[low : low + _TOGETHER] >> sample & 1)
                if some.size:
                    yield maps_at_sample(self.start, self.nodes, self.slope, sample, some)

    def part(self, maps: Maps) -> FloatArray | float:
        return 1.0 if maps.at_corners else self.between[maps.element]

    def sum(
        self, x: FloatArray, reference: FloatArray, penalty: Penalty, low: int, high: int
    ) -> tuple[float, float, float]:
        """Energy, smallest determinant and largest f of the elements low <= m < high."""
        from ..numerics.cell.foldover.hexahedra import energy_of_cells  # what is imported is compiled

        return energy_of_cells(x, *self._loops, reference, tuple(penalty), low, high)

    def add(
        self, x: FloatArray, reference: FloatArray, penalty: Penalty, which: IntArray, unknowns: Unknowns, rows: Rows
    ) -> None:
        """See :func:`..numerics.cell.foldover.hexahedra.add_derivatives`."""
        from ..numerics.cell.foldover.hexahedra import add_derivatives

        rest = tuple(penalty), which, unknowns, rows.pattern, rows.matrix, rows.gradient
        add_derivatives(x, *self._loops, reference, *rest)

    @cached_property
    def _loops(self) -> tuple[Any, ...]:
        weights = np.stack([self.weight, self.between, self.weight**HELD], axis=1)
        return self.nodes, self.start, self.mask, self.slope, weights


@dataclass(frozen=True)
class Triangles(_Elements):
    """The energy of the corners of quadrilaterals, as triangles of ``nodes`` (m, 3).

    ``slope`` (m, 3, 2) are the gradients of the shape functions in the undeformed grid.
    """

    slope: FloatArray

    @property
    def work(self) -> float:
        return _TRIANGLE * len(self.nodes)

    @classmethod
    def at_corners(
        cls, start: FloatArray, cells: IntArray, sign: FloatArray, weight: FloatArray, moves: BoolArray
    ) -> Triangles:
        """From the sound corners of undeformed quadrilaterals (m, 4) with at least one node that ``moves`` (n,);
        ``sign`` (m,) is the sign of sound Jacobians."""
        corner = np.arange(4)
        nodes = np.stack([cells, cells[:, corner ^ 2], cells[:, corner ^ 1]], axis=-1)
        # Edges along ascending indices, at whichever end of them the corner is.
        ends = np.stack([np.where(corner < 2, 1.0, -1.0), np.where(corner % 2 == 0, 1.0, -1.0)], axis=-1)
        edges = ends[:, :, None] * (start[nodes[..., 1:]] - start[nodes[..., :1]])
        (ux, uy), (vx, vy) = edges.transpose(2, 3, 0, 1)
        det = ux * vy - uy * vx
        size = np.sqrt((ux * ux + uy * uy) * (vx * vx + vy * vy))
        kept = (sign[:, None] * det > COLLAPSED * size) & moves[nodes].any(axis=-1)
        dual = np.stack([vy, -vx, -uy, ux], axis=-1)[kept].reshape(-1, 2, 2) / det[kept, None, None]
        slope = np.broadcast_to(ends, (*kept.shape, 2))[kept][:, :, None] * dual
        slope = np.concatenate([-slope.sum(axis=1, keepdims=True), slope], axis=1)
        return cls(start, nodes[kept], np.repeat(weight, kept.sum(axis=1)), slope)

    def maps(self, between: bool = True) -> Iterator[Maps]:
        yield self._maps

    def sum(
        self, x: FloatArray, reference: FloatArray, penalty: Penalty, low: int, high: int
    ) -> tuple[float, float, float]:
        maps = Maps(self._maps.nodes[:, low:high], self._maps.slope[..., low:high], self._maps.element[low:high])
        a = maps.jacobians(x)
        g, det = inner(a, a), a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]
        chi, _ = _regular(det, penalty.eps)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            f = np.where(chi > 0.0, 0.5 * (g + det * det + 1.0) / chi, np.inf)
            energy = penalty.share * (self.weight[low:high] * f + penalty.cubic * growth(f)[0])
        if penalty.elastic > 0.0:
            change = a - maps.jacobians(reference)
            energy += 0.5 * penalty.elastic * self._weights[low:high, 1] * inner(change, change)
        return float(energy.sum()), float(det.min(initial=np.inf)), float(f.max(initial=0.0))

    def add(
        self, x: FloatArray, reference: FloatArray, penalty: Penalty, which: IntArray, unknowns: Unknowns, rows: Rows
    ) -> None:
        from ..numerics.cell.foldover.plane import add_triangles

        rest = tuple(penalty), which, unknowns, rows.pattern, rows.matrix, rows.gradient
        add_triangles(x, self.nodes, self.slope, self._weights, reference, *rest)

    def with_between(self, share: FloatArray) -> Triangles:
        return self

    @cached_property
    def _weights(self) -> FloatArray:
        """The weights of the cells, and the factors of their elastic energy (m, 2)."""
        return np.stack([self.weight, self.weight**HELD], axis=1)

    @cached_property
    def _maps(self) -> Maps:
        slope = np.ascontiguousarray(self.slope.transpose(1, 2, 0))
        return Maps(np.ascontiguousarray(self.nodes.T), slope, np.arange(len(self.nodes)))


def _slopes(a: FloatArray, eps: float) -> tuple[FloatArray, ...]:
    """f of maps (d, d, m) and its derivatives: f, u, v, w, q, r as in :mod:`..numerics.cell.foldover.elements`."""
    k = cofactors(a)
    g, det = inner(a, a), (a[0] * k[0]).sum(axis=0)
    chi, root = _regular(det, eps)
    if len(a) == 2:
        return slopes_of_triangle(g, det, chi, root)
    return slopes(g, det, chi, root, chi ** (-2.0 / 3.0))[:6]


Energy = Hexahedra | Triangles


class Slide(NamedTuple):
    """Nodes (k,) that remain on a surface: ``normals`` returns its unit normals (k, d) near coordinates (k, d),
    ``back`` projects coordinates onto it, ``slopes`` returns the derivatives (k, d, d) of both, first that of ``back``.
    """

    nodes: IntArray
    normals: Callable[[FloatArray], FloatArray]
    back: Callable[[FloatArray], FloatArray]
    slopes: Callable[[FloatArray], tuple[FloatArray, FloatArray]]


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

    @property
    def dimension(self) -> int:
        return self.fixed.shape[1]

    @property
    def number(self) -> IntArray:
        return self.unknowns.number

    def directions(self, x: FloatArray) -> tuple[Unknowns, FloatArray]:
        """Dependence of nodes at ``x`` (n, d) on the unknowns, and projectors onto the directions of these."""
        if not self.slides:
            return self.unknowns, self.fixed
        frame, plain, freedom = self.unknowns.frame.copy(), self.unknowns.plain.copy(), self.fixed.copy()
        for slide in self.slides:
            across = slide.normals(x[slide.nodes])
            unknown = self.number[slide.nodes]
            freedom[unknown] -= across[:, :, None] * across[:, None, :]
            frame[slide.nodes], plain[slide.nodes] = freedom[unknown], False
        return Unknowns(self.number, frame, plain), freedom

    def on_nodes(self, frame: FloatArray, step: FloatArray) -> FloatArray:
        """The changes (n, d) of the nodes, with frames (n, d, d), for a step (n_unknowns, d) of the unknowns."""
        free, result = self.number >= 0, np.zeros(frame.shape[:2])
        result[free] = np.einsum("nij,nj->ni", frame[free], step[self.number[free]])
        return result

    def moved(self, x: FloatArray, unknowns: Unknowns, step: FloatArray, length: float) -> FloatArray:
        """Coordinates after ``length`` times the step (n_unknowns, d) of the unknowns."""
        result = x + length * self.on_nodes(unknowns.frame, step)
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
