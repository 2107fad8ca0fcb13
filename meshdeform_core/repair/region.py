"""The region that a repair moves: its energy, and how its nodes follow the unknowns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from ..grid import BoolArray, FloatArray, IntArray
from ..numerics.cell.foldover import Samples, add_derivatives, energy_of_cells, measure_samples
from ..numerics.cell.foldover_plane import add_triangles, corner_triangles, energy_of_triangles
from .shape import hexahedron_shapes, lost, triangle_shapes

COLLAPSED = 1e-10
"""A Jacobian below this share of the product of the edges is that of a collapsed corner."""
_CORNERS = (1 << 8) - 1


class Unknowns(NamedTuple):
    """Of every node of a region: the ``number`` (n,) of its unknown or -1, its ``frame`` (n, d, d) with
    displacement = frame @ unknown, and whether that is the identity, ``plain`` (n,)."""

    number: IntArray
    frame: FloatArray
    plain: BoolArray


class Penalty(NamedTuple):
    """The regularisation ``eps`` and the barrier ``t`` of the energy."""

    eps: float
    t: float = 0.0


class Rows(NamedTuple):
    """The rows ``first <= row < last`` of a sparse matrix of blocks, whose ``columns`` begin at ``starts``; the
    ``matrix`` (n_blocks, d, d) has the blocks of these rows, the ``gradient`` (n_unknowns, d) all rows."""

    first: int
    last: int
    starts: IntArray
    columns: IntArray
    matrix: FloatArray
    gradient: FloatArray

    @property
    def pattern(self) -> tuple[int, int, IntArray, IntArray]:
        """What the loops over rows need."""
        return self[:4]


class Margin(NamedTuple):
    """By which ``factor`` the excess of a density over 2 may grow, with at least a ``smallest`` excess."""

    factor: float
    smallest: float

    def barrier(self, density: FloatArray) -> FloatArray:
        """Barriers t (m,) for present densities (m,)."""
        return np.asarray(1.0 / (2.0 + self.factor * np.maximum(density - 2.0, self.smallest)))


GUARDED, FIRM, PRESSED = Margin(1.25, 0.2), Margin(1.1, 0.05), Margin(1.05, 0.02)
"""Of guarded elements while others improve, and while shapes do; of those pressed towards a better shape."""


class Weights(NamedTuple):
    """Of elements: how much each counts in the sum, ``sum`` (m,), and whether it is ``guarded`` (m,): it may not
    deteriorate where others improve."""

    sum: FloatArray
    guarded: BoolArray

    @classmethod
    def even(cls, count: int) -> Weights:
        """All count alike."""
        return cls(np.ones(count), np.zeros(count, dtype=bool))

    def of(self, which: IntArray | BoolArray) -> Weights:
        """Those of some elements."""
        return Weights(self.sum[which], self.guarded[which])

    def guard(self, density: FloatArray, margin: Margin) -> FloatArray:
        """Weights and own barriers (m, 2) of the energy; guarded elements have the largest ``density`` (m,) now."""
        return np.stack([self.sum, np.where(self.guarded, margin.barrier(density), 0.0)], axis=1)

    @staticmethod
    def press(weight: FloatArray, density: FloatArray, weak: BoolArray) -> FloatArray:
        """The same, after :meth:`guard`, with a barrier just above the ``density`` (m,) of ``weak`` (m,) elements."""
        result = weight.copy()
        result[weak, 1] = np.maximum(weight[weak, 1], PRESSED.barrier(density[weak]))
        return result

    @property
    def free(self) -> FloatArray:
        """The same (m, 2) without barriers."""
        return np.stack([self.sum, np.zeros(len(self.sum))], axis=1)


class Energy(Protocol):
    """A sum over elements, each of which depends on some nodes: ``nodes`` (m, k)."""

    @property
    def nodes(self) -> IntArray: ...

    def guard(self, x: FloatArray, margin: Margin = GUARDED) -> None:
        """Keep guarded elements, all of them valid at ``x`` (n, d), from deteriorating much."""
        ...

    def press(self, weak: BoolArray, density: FloatArray) -> None:
        """The same, and ``weak`` elements (m,) of the given densities (m,) from deteriorating at all."""
        ...

    def measure(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(m,) smallest determinant and largest density of valid elements."""
        ...

    def shapes(self, x: FloatArray) -> FloatArray:
        """(m,) f_skew of valid elements over their corners; 1 where it is close to that of the undeformed ones."""
        ...

    def sum(self, x: FloatArray, penalty: Penalty, low: int, high: int) -> tuple[float, float, float]:
        """Over elements low <= m < high: energy, smallest determinant, largest density."""
        ...

    def add(self, x: FloatArray, penalty: Penalty, which: IntArray, unknowns: Unknowns, rows: Rows) -> None:
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
    weights : of the cells
    """

    start: FloatArray
    nodes: IntArray
    mask: IntArray
    samples: Samples
    weights: Weights

    def __post_init__(self) -> None:
        self._weight = self._guard = self.weights.free
        self._undeformed: FloatArray | None = None

    def guard(self, x: FloatArray, margin: Margin = GUARDED) -> None:
        self._weight = self._guard = self.weights.guard(self.measure(x)[1], margin)

    def press(self, weak: BoolArray, density: FloatArray) -> None:
        self._weight = self.weights.press(self._guard, density, weak)

    def shapes(self, x: FloatArray) -> FloatArray:
        if self._undeformed is None:
            self._undeformed = hexahedron_shapes(self.start, self.nodes, self.mask)
        return lost(hexahedron_shapes(x, self.nodes, self.mask), self._undeformed)

    def measure(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        lowest, highest = measure_samples(x, self.start, self.nodes, self.mask, self.samples)
        return lowest, highest

    def focus(self, x: FloatArray, weak: float) -> None:
        """Take all samples of hexahedra that have a determinant below ``weak``, and only the corners of the others."""
        sound = self.mask
        self.mask = sound & _CORNERS
        lowest, _ = measure_samples(x, self.start, self.nodes, self.mask, self.samples)
        self.mask[lowest < weak] = sound[lowest < weak]

    def sum(self, x: FloatArray, penalty: Penalty, low: int, high: int) -> tuple[float, float, float]:
        return energy_of_cells(x, *self._loops, *penalty, low, high)

    def add(self, x: FloatArray, penalty: Penalty, which: IntArray, unknowns: Unknowns, rows: Rows) -> None:
        add_derivatives(x, *self._loops, *penalty, which, unknowns, rows.pattern, rows.matrix, rows.gradient)

    @property
    def _loops(self) -> tuple[Any, ...]:
        return self.start, self.nodes, self.mask, self.samples, self._weight


@dataclass
class Triangles:
    """The energy of the corners of quadrilaterals: ``nodes`` (m, 3), ``slope`` (m, 3, 2) the undeformed gradients of
    their shape functions, ``start`` (n, 2) undeformed coordinates, ``weights`` those of their cells."""

    nodes: IntArray
    slope: FloatArray
    start: FloatArray
    weights: Weights

    def __post_init__(self) -> None:
        self._weight = self._guard = self.weights.free

    def guard(self, x: FloatArray, margin: Margin = GUARDED) -> None:
        self._weight = self._guard = self.weights.guard(self.measure(x)[1], margin)

    def press(self, weak: BoolArray, density: FloatArray) -> None:
        self._weight = self.weights.press(self._guard, density, weak)

    def shapes(self, x: FloatArray) -> FloatArray:
        return lost(triangle_shapes(x, self.nodes), triangle_shapes(self.start, self.nodes))

    def measure(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        a = np.einsum("mnd,mnk->mdk", x[self.nodes], self.slope)
        det = np.linalg.det(a)
        return det, np.asarray(((a**2).sum(axis=(1, 2)) + det**2 + 1.0) / (2.0 * det))

    @classmethod
    def at_corners(cls, start: FloatArray, cells: IntArray, sign: FloatArray, weights: Weights) -> Triangles:
        """Of the sound corners of undeformed quadrilaterals (m, 4); ``sign`` (m,) is that of sound Jacobians."""
        most = 4 * len(cells)
        nodes, slope, cell = np.empty((most, 3), np.int64), np.empty((most, 3, 2)), np.empty(most, np.int64)
        count = corner_triangles(start, cells, sign, COLLAPSED, nodes, slope, cell)
        return cls(nodes[:count], slope[:count], start, weights.of(cell[:count]))

    def with_any(self, moves: BoolArray) -> Triangles:
        """Those that have one of the nodes that ``moves`` (n,) is true for."""
        kept = np.asarray(moves[self.nodes].any(axis=1))
        return self if kept.all() else Triangles(self.nodes[kept], self.slope[kept], self.start, self.weights.of(kept))

    def sum(self, x: FloatArray, penalty: Penalty, low: int, high: int) -> tuple[float, float, float]:
        return energy_of_triangles(x, *self._loops, *penalty, low, high)

    def add(self, x: FloatArray, penalty: Penalty, which: IntArray, unknowns: Unknowns, rows: Rows) -> None:
        add_triangles(x, *self._loops, *penalty, which, unknowns, rows.pattern, rows.matrix, rows.gradient)

    @property
    def _loops(self) -> tuple[Any, ...]:
        return self.nodes, self.slope, self._weight


@dataclass
class Region:
    """Some cells whose nodes are moved, with nodes of their own numbering, in coordinates (n, d) of space or plane.

    ``freedom`` (n_unknowns, d, d) projects on the directions in which unknowns may move; ``back`` takes nodes (k,) to
    their places on surfaces, given where they went along those directions, both (k, d).
    """

    energy: Energy
    unknowns: Unknowns
    freedom: FloatArray
    back: tuple[tuple[IntArray, Callable[[FloatArray], FloatArray]], ...] = ()

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
        for nodes, project in self.back:
            result[nodes] = project(result[nodes])
        return result
