"""The energy of a region as a sum over elements: hexahedra, or triangles at the corners of quadrilaterals."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ...grid import BoolArray, FloatArray, IntArray
from ...numerics.cell.foldover.hexahedra import Unknowns, add_derivatives, energy_of_cells, excess_of_cells
from ...numerics.cell.foldover.plane import (
    add_triangles,
    corner_triangles,
    energy_of_triangles,
    excess_of_triangles,
)
from ...numerics.cell.foldover.samples import Samples, shortest_edges
from ..tuned import HEALTHY, NORM, SOFT

COLLAPSED = 1e-10
"""A corner whose Jacobian is below this fraction of the product of its edges is collapsed."""
_CORNERS = (1 << 8) - 1
# Measured work for the derivatives at one sample of a hexahedron, and of a triangle, in the unit of limit.py.
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


class Energy(Protocol):
    """A sum over m elements, each of which depends on k nodes, ``nodes`` (m, k)."""

    @property
    def nodes(self) -> IntArray: ...

    @property
    def work(self) -> float:
        """Work of computing the second derivatives at one sample, see :mod:`..limit`."""
        ...

    def samples_of(self, low: int, high: int) -> int:
        """Number of samples of the elements low <= m < high."""
        ...

    def edges(self) -> FloatArray:
        """Length (n,) of the shortest undeformed edge at every node, ignoring zero lengths; infinite if none."""
        ...

    def softened(self, power: float) -> Energy:
        """The energy with all weights raised to ``power``."""
        ...

    def excess(self, x: FloatArray) -> FloatArray:
        """Excess (m,) of the elements, see :mod:`.onset`."""
        ...

    def sum(
        self, x: FloatArray, reference: FloatArray, penalty: Penalty, low: int, high: int
    ) -> tuple[float, float, float]:
        """Energy, smallest determinant and largest f of the elements low <= m < high."""
        ...

    def add(
        self, x: FloatArray, reference: FloatArray, penalty: Penalty, which: IntArray, unknowns: Unknowns, rows: Rows
    ) -> None:
        """See :func:`..numerics.cell.foldover.hexahedra.add_derivatives`."""
        ...

    def products(
        self, x: FloatArray, penalty: Penalty, change: FloatArray, share: float, between: FloatArray
    ) -> tuple[FloatArray, float, FloatArray]:
        """Change (n, d) of the gradient for changes of ``x`` (n, d), of the share, and of the shares ``between`` (m,)
        of samples between corners; and the transposes with respect to the two kinds of shares.

        See :func:`..numerics.cell.foldover.tangents.products_of_cells`."""
        ...

    def excess_products(self, x: FloatArray, change: FloatArray, gradient: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Change (m,) of the excess for a ``change`` (n, d) of ``x``, and the transpose for a ``gradient`` (m,)."""
        ...

    def with_between(self, share: FloatArray) -> Energy:
        """The energy with shares (m,) of the samples between corners; samples with a share of 0 are left out."""
        ...

    def matrices(self, x: FloatArray) -> FloatArray:
        """Jacobian matrices (m, d, d) of the maps from undeformed elements, averaged over each hexahedron."""
        ...

    def stretched(self, stretch: FloatArray) -> Energy:
        """The energy relative to undeformed elements to each of which a linear map ``stretch`` (m, d, d) is applied."""
        ...


@dataclass(frozen=True)
class Hexahedra:
    """The energy of hexahedra.

    Attributes
    ----------
    start, own : (k, 3) undeformed coordinates, and the rows (m, 8) of each cell's corners
    nodes : (m, 8) nodes of each cell, in the order of :func:`..numerics.cell.foldover.samples.cell_samples`
    mask : (m,) int64, bit s set where sample point s counts
    samples : the sample points
    weight : (m,) of the cells
    between : (m,) share of the samples between corners
    """

    start: FloatArray
    own: IntArray
    nodes: IntArray
    mask: IntArray
    samples: Samples
    weight: FloatArray
    between: FloatArray

    @property
    def work(self) -> float:
        return _SAMPLE

    def samples_of(self, low: int, high: int) -> int:
        return int(np.bitwise_count(self.mask[low:high]).sum())

    def edges(self) -> FloatArray:
        pairs = [(a, a | bit) for a in range(8) for bit in (1, 2, 4) if not a & bit]
        return shortest_edges(self.start, self.nodes, np.array(pairs))

    def softened(self, power: float) -> Hexahedra:
        return dataclasses.replace(self, weight=self.weight**power)

    def excess(self, x: FloatArray) -> FloatArray:
        return np.asarray(excess_of_cells(x, *self._corners, HEALTHY, NORM, SOFT))

    def with_between(self, share: FloatArray) -> Hexahedra:
        return dataclasses.replace(self, mask=np.where(share > 0.0, self.mask, self.mask & _CORNERS), between=share)

    def sum(
        self, x: FloatArray, reference: FloatArray, penalty: Penalty, low: int, high: int
    ) -> tuple[float, float, float]:
        return energy_of_cells(x, *self._loops, reference, tuple(penalty), low, high)

    def add(
        self, x: FloatArray, reference: FloatArray, penalty: Penalty, which: IntArray, unknowns: Unknowns, rows: Rows
    ) -> None:
        rest = tuple(penalty), which, unknowns, rows.pattern, rows.matrix, rows.gradient
        add_derivatives(x, *self._loops, reference, *rest)

    def products(
        self, x: FloatArray, penalty: Penalty, change: FloatArray, share: float, between: FloatArray
    ) -> tuple[FloatArray, float, FloatArray]:
        from ...numerics.cell.foldover.tangents import products_of_cells

        found, gradient = np.zeros_like(change), np.zeros(len(self.nodes))
        total = products_of_cells(x, *self._loops, tuple(penalty), change, share, between, found, gradient)
        return found, total, gradient

    def excess_products(self, x: FloatArray, change: FloatArray, gradient: FloatArray) -> tuple[FloatArray, FloatArray]:
        from ...numerics.cell.foldover.tangents import slopes_of_cells

        excess, found = np.zeros(len(self.nodes)), np.zeros_like(change)
        slopes_of_cells(x, *self._corners, HEALTHY, NORM, SOFT, change, gradient, excess, found)
        return excess, found

    def matrices(self, x: FloatArray) -> FloatArray:
        before = _edges(self.start, self.own)
        # Undeformed cells without volume have no shape to compare with.
        before[np.linalg.det(before) == 0.0] = np.eye(3)
        return np.asarray(_edges(x, self.nodes) @ np.linalg.inv(before))

    def stretched(self, stretch: FloatArray) -> Hexahedra:
        corners = np.einsum("mij,mnj->mni", stretch, self.start[self.own]).reshape(-1, 3)
        return dataclasses.replace(self, start=corners, own=np.arange(len(corners)).reshape(-1, 8))

    @cached_property
    def _loops(self) -> tuple[Any, ...]:
        weights = np.stack([self.weight, self.between], axis=1)
        return self.nodes, self.start, self.own, self.mask, self.samples, weights

    @property
    def _corners(self) -> tuple[Any, ...]:
        return self.nodes, self.start, self.own, self.mask & _CORNERS, self.samples


@dataclass(frozen=True)
class Triangles:
    """The energy of the corners of quadrilaterals, as triangles of ``nodes`` (m, 3).

    ``slope`` (m, 3, 2) are the gradients of the shape functions in the undeformed grid, ``start`` (n, 2) undeformed
    coordinates, ``weight`` (m,) the weights of the cells.
    """

    nodes: IntArray
    slope: FloatArray
    start: FloatArray
    weight: FloatArray

    @property
    def work(self) -> float:
        return _TRIANGLE

    def samples_of(self, low: int, high: int) -> int:
        return high - low

    def edges(self) -> FloatArray:
        return shortest_edges(self.start, self.nodes, np.array([(0, 1), (0, 2)]))

    def softened(self, power: float) -> Triangles:
        return dataclasses.replace(self, weight=self.weight**power)

    def excess(self, x: FloatArray) -> FloatArray:
        return np.asarray(excess_of_triangles(x, self.nodes, self.slope, HEALTHY, SOFT))

    @classmethod
    def at_corners(
        cls, start: FloatArray, cells: IntArray, sign: FloatArray, weight: FloatArray, moves: BoolArray
    ) -> tuple[Triangles, IntArray]:
        """From the sound corners of undeformed quadrilaterals (m, 4) with at least one node that ``moves`` (n,), and
        the quadrilateral of each; ``sign`` (m,) is the sign of sound Jacobians."""
        most = 4 * len(cells)
        nodes, slope, cell = np.empty((most, 3), np.int64), np.empty((most, 3, 2)), np.empty(most, np.int64)
        count = corner_triangles(start, cells, sign, COLLAPSED, nodes, slope, cell)
        kept = np.flatnonzero(moves[nodes[:count]].any(axis=1))
        return cls(nodes[kept], slope[kept], start, weight[cell[kept]]), cell[kept]

    def sum(
        self, x: FloatArray, reference: FloatArray, penalty: Penalty, low: int, high: int
    ) -> tuple[float, float, float]:
        return energy_of_triangles(x, self.nodes, self.slope, self.weight, reference, tuple(penalty), low, high)

    def add(
        self, x: FloatArray, reference: FloatArray, penalty: Penalty, which: IntArray, unknowns: Unknowns, rows: Rows
    ) -> None:
        rest = tuple(penalty), which, unknowns, rows.pattern, rows.matrix, rows.gradient
        add_triangles(x, self.nodes, self.slope, self.weight, reference, *rest)

    def products(
        self, x: FloatArray, penalty: Penalty, change: FloatArray, share: float, between: FloatArray
    ) -> tuple[FloatArray, float, FloatArray]:
        from ...numerics.cell.foldover.plane_tangents import products_of_triangles

        found, where = np.zeros_like(change), (self.nodes, self.slope, self.weight)
        total = products_of_triangles(x, *where, tuple(penalty), change, share, found)
        return found, total, np.zeros(len(self.nodes))

    def excess_products(self, x: FloatArray, change: FloatArray, gradient: FloatArray) -> tuple[FloatArray, FloatArray]:
        from ...numerics.cell.foldover.plane_tangents import slopes_of_triangles

        excess, found = np.zeros(len(self.nodes)), np.zeros_like(change)
        slopes_of_triangles(x, self.nodes, self.slope, HEALTHY, SOFT, change, gradient, excess, found)
        return excess, found

    def with_between(self, share: FloatArray) -> Triangles:
        return self

    def matrices(self, x: FloatArray) -> FloatArray:
        return np.asarray(np.einsum("mni,mnk->mik", x[self.nodes], self.slope))

    def stretched(self, stretch: FloatArray) -> Triangles:
        return dataclasses.replace(self, slope=np.einsum("mnk,mkj->mnj", self.slope, np.linalg.inv(stretch)))


def _edges(x: FloatArray, nodes: IntArray) -> FloatArray:
    """Mean edge vectors of hexahedra along their index axes, as columns of matrices (m, 3, 3)."""
    corners = x[nodes].reshape(-1, 2, 2, 2, 3)
    means = [np.diff(corners, axis=axis).mean(axis=(1, 2, 3)) for axis in (1, 2, 3)]
    return np.stack(means, axis=-1)
