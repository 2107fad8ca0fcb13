"""The region that a repair moves: its energy, and how its nodes follow the unknowns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from ..grid import BoolArray, FloatArray, IntArray
from ..numerics.cell.foldover import Samples, add_derivatives, energy_of_cells, measure_samples
from ..numerics.cell.foldover_plane import add_triangles, corner_triangles, energy_of_triangles

COLLAPSED = 1e-10
"""A Jacobian below this share of the product of the edges is that of a collapsed corner."""
_CORNERS = (1 << 8) - 1


class Unknowns(NamedTuple):
    """Of every node of a region: the ``number`` (n,) of its unknown or -1, its ``frame`` (n, d, d) with
    displacement = frame @ unknown, and whether that is the identity, ``plain`` (n,)."""

    number: IntArray
    frame: FloatArray
    plain: BoolArray


class Energy(Protocol):
    """A sum over elements, each of which depends on some nodes: ``nodes`` (m, k)."""

    @property
    def nodes(self) -> IntArray: ...

    def sum(self, x: FloatArray, eps: float, t: float, low: int, high: int) -> tuple[float, float, float]:
        """Over elements low <= m < high: energy, smallest determinant, largest density."""
        ...

    def add(
        self, x: FloatArray, eps: float, t: float, which: IntArray, unknowns: Unknowns,
        rows: tuple[int, int, IntArray, IntArray], matrix: FloatArray, gradient: FloatArray,
    ) -> None:  # fmt: skip
        """See :func:`..numerics.cell.foldover.add_derivatives`."""
        ...


@dataclass
class Hexahedra:
    """The energy of hexahedra.

    Attributes
    ----------
    start : (n, 3) undeformed coordinates
    nodes : (m, 8) as in :func:`..numerics.cell.foldover.cell_samples`
    mask : (m,) int64, bit s set where sample point s counts
    samples : the sample points
    weight : (m,)
    """

    start: FloatArray
    nodes: IntArray
    mask: IntArray
    samples: Samples
    weight: FloatArray

    def focus(self, x: FloatArray, weak: float) -> None:
        """Take all samples of hexahedra that have a determinant below ``weak``, and only the corners of the others."""
        sound = self.mask
        self.mask = sound & _CORNERS
        lowest, _ = measure_samples(x, self.start, self.nodes, self.mask, self.samples)
        self.mask[lowest < weak] = sound[lowest < weak]

    def sum(self, x: FloatArray, eps: float, t: float, low: int, high: int) -> tuple[float, float, float]:
        return energy_of_cells(x, *self._loops, eps, t, low, high)

    def add(self, x: FloatArray, eps: float, t: float, *rest: Any) -> None:
        add_derivatives(x, *self._loops, eps, t, *rest)

    @property
    def _loops(self) -> tuple[Any, ...]:
        return self.start, self.nodes, self.mask, self.samples, self.weight


@dataclass
class Triangles:
    """The energy of the corners of quadrilaterals: ``nodes`` (m, 3), ``slope`` (m, 3, 2) the undeformed gradients of
    their shape functions, ``weight`` (m,)."""

    nodes: IntArray
    slope: FloatArray
    weight: FloatArray

    @classmethod
    def at_corners(cls, start: FloatArray, cells: IntArray, sign: FloatArray, weight: FloatArray) -> Triangles:
        """Of the sound corners of undeformed quadrilaterals (m, 4); ``sign`` (m,) is that of sound Jacobians."""
        most = 4 * len(cells)
        nodes, slope, cell = np.empty((most, 3), np.int64), np.empty((most, 3, 2)), np.empty(most, np.int64)
        count = corner_triangles(start, cells, sign, COLLAPSED, nodes, slope, cell)
        return cls(nodes[:count], slope[:count], weight[cell[:count]])

    def sum(self, x: FloatArray, eps: float, t: float, low: int, high: int) -> tuple[float, float, float]:
        return energy_of_triangles(x, self.nodes, self.slope, self.weight, eps, t, low, high)

    def add(self, x: FloatArray, eps: float, t: float, *rest: Any) -> None:
        add_triangles(x, self.nodes, self.slope, self.weight, eps, t, *rest)


@dataclass
class Region:
    """Some cells whose nodes are moved, with nodes of their own numbering, in coordinates (n, d) of space or plane.

    ``freedom`` (n_unknowns, d, d) projects on the directions in which unknowns may move.
    """

    energy: Energy
    unknowns: Unknowns
    freedom: FloatArray

    @property
    def n_unknowns(self) -> int:
        return len(self.freedom)

    @property
    def dimension(self) -> int:
        return self.freedom.shape[1]

    @property
    def number(self) -> IntArray:
        return self.unknowns.number

    def moved(self, x: FloatArray, step: FloatArray, length: float) -> FloatArray:
        """Coordinates after ``length`` times the step (n_unknowns, d) of the unknowns."""
        number, frame, plain = self.unknowns
        free = number >= 0
        move = step[number[free]]
        turned = ~plain[free]
        move[turned] = np.einsum("nij,nj->ni", frame[free][turned], move[turned])
        result = x.copy()
        result[free] += length * move
        return result
