"""The values that IDW sums over its sources, and exact sums; :mod:`.fast_idw_sums` sums over clusters of sources."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...grid import BoolArray, FloatArray, Grid, IntArray
from ...numerics.exact.direct import N_VALUES, weighted_sums
from ...numerics.frame import Frame
from ...numerics.rigid import NO_TRANSITION, Columns, Transition, finish
from ...parallel import Nodes, empty, for_chunks
from ..base import Progress, of_stage

_CHUNK = 2048
# Nodes per chunk when fast sums are checked.
_CHECKED = 64
_PORTIONS = 32

Weights = tuple[tuple[float, float, float], ...]
Use = Callable[[slice, IntArray, FloatArray], object]
Make = Callable[[slice, IntArray, int], FloatArray]


@dataclass(frozen=True)
class SourceValues:
    """A displacement prepared for summation.

    ``values`` (k, n) per source, relative to ``origin`` (3,); ``weights`` (a, b, kappa) per group; ``shift`` and
    ``turn`` (n,), magnitude of the displacement and rotation angle (radians) of each source; ``frame``, the mean motion
    that was removed; ``still`` (k,), the values of sources that do not move, if any; ``transition`` between moving
    sources and others.
    """

    values: FloatArray
    weights: Weights
    shift: FloatArray
    turn: FloatArray
    origin: FloatArray
    frame: Frame
    still: FloatArray | None = None
    transition: Transition = NO_TRANSITION


@dataclass(frozen=True)
class Bound:
    """Sources (n, 3) with strength (n,), and target nodes ``flat`` of an undeformed ``grid``.

    ``room`` is the memory (bytes) for data stored between displacements.
    """

    grid: Grid
    flat: IntArray
    sources: FloatArray
    strength: FloatArray
    groups: tuple[IntArray, ...]
    rotation: str
    divisions: int
    room: int

    @property
    def points(self) -> FloatArray:
        """Coordinates (n_nodes, 3); of a grid in parts, only the rows that this rank holds."""
        return np.asarray(self.grid.nodes.rows)

    def displacement(self, fit: SourceValues, flat: IntArray, sums: Columns) -> FloatArray:
        """Displacement (n, 3) of the nodes ``flat`` from the 1 + k columns (n,) of their sums."""
        x, steps = Nodes.of(self.points).at(flat), self.divisions if self.rotation == "division" else 1
        return fit.frame.absolute(x, finish(self.rotation, sums, x - fit.origin, steps, fit.transition))

    def exact(self, fit: SourceValues, flat: IntArray) -> FloatArray:
        """Displacement (n, 3) of some nodes by exact sums, with which fast ones are compared."""
        return self.displacement(fit, flat, ExactSums(self, fit.weights).at(flat, fit.values, chunk=_CHECKED).T)

    def evaluate(self, fit: SourceValues, out: FloatArray, progress: Progress | None) -> None:
        """Write the displacement of the targets into ``out`` (n_nodes, 3), by exact sums."""
        rows = Nodes.of(out).rows

        def use(_: slice, flat: IntArray, sums: FloatArray) -> None:
            rows[flat] = self.displacement(fit, flat, np.ascontiguousarray(sums.T))

        ExactSums(self, fit.weights).apply(fit.values, use, progress=of_stage(progress, "idw"))


class ExactSums:
    """Exact sums of values over the sources, every node with every source, and their transposes.

    Interface as :class:`...numerics.fastsum.weighted.FastSums`; ``acting`` (n,) are the sources with values other
    than zero, by default all.
    """

    def __init__(self, bound: Bound, weights: Weights, acting: BoolArray | None = None) -> None:
        self._bound, self._weights = bound, weights
        self.acting = np.ones(len(bound.sources), dtype=bool) if acting is None else acting

    @property
    def flat(self) -> IntArray:
        """Flat indices (n,) of the nodes at which sums are taken."""
        return self._bound.flat

    @cached_property
    def portions(self) -> int:
        """Number of parts of the nodes that :meth:`transpose` sums separately; their sums together are no larger than
        half of the coordinates."""
        size = 2 * (1 + N_VALUES) * max(int(self.acting.sum()), 1)
        return max(1, min(_PORTIONS, len(self.flat) // _CHUNK, 3 * len(self._bound.grid.points) // size))

    def at(self, flat: IntArray, values: FloatArray, weigh: bool = True, chunk: int | None = None) -> FloatArray:
        """Sums (m, 1 + k) of values (k, n) at some nodes, the total weight first, or zero unless ``weigh``; ``chunk``
        nodes at a time, if no other loop uses the threads."""
        bound = self._bound
        x, sums = Nodes.of(bound.points).at(flat), np.zeros((len(flat), 1 + len(values)))
        for group, weights in zip(bound.groups, self._weights, strict=True):
            acts = self.acting[group]
            for some, kept in ((group[acts], values), (group[~acts], values[:0])):
                if len(some) and (weigh or len(kept)):
                    near = bound.sources[some], bound.strength[some]
                    sums[:, : 1 + len(kept)] += weighted_sums(x, *near, weights, kept[:, some], chunk=chunk or len(x))
        if not weigh:
            sums[:, 0] = 0.0
        return sums

    def apply(
        self,
        values: FloatArray,
        use: Use,
        weigh: bool = True,
        progress: Callable[[int, int], None] | None = None,
    ) -> None:
        """Call ``use`` with sums (m, 1 + k) of values (k, n) for some rows, with these rows and flat indices (m,)."""
        flat = self.flat

        def work(lo: int, hi: int) -> None:
            use(slice(lo, hi), flat[lo:hi], self.at(flat[lo:hi], values, weigh))

        for_chunks(work, len(flat), _CHUNK, progress)

    def transpose(self, make: Make, k: int) -> FloatArray:
        """Transpose of :meth:`apply`: gradients (k, n_sources) from those (m, k) of the sums of values."""
        bound, n, n_acting = self._bound, len(self._bound.sources), int(self.acting.sum())
        cut = np.linspace(0, len(bound.flat), self.portions + 1).astype(np.int64)
        place = np.cumsum(self.acting) - 1
        totals = empty((self.portions, k, n_acting))

        def work(lo: int, hi: int) -> None:
            for portion in range(lo, hi):
                totals[portion] = 0.0
                for first in range(cut[portion], cut[portion + 1], _CHUNK):
                    rows = slice(first, min(first + _CHUNK, int(cut[portion + 1])))
                    flat = bound.flat[rows]
                    given = np.ascontiguousarray(make(rows, flat, portion).T)
                    x, ones = bound.points[flat], np.ones(len(flat))
                    for group, weights in zip(bound.groups, self._weights, strict=True):
                        some = group[self.acting[group]]
                        found = weighted_sums(bound.sources[some], x, ones, weights, given, chunk=n)
                        totals[portion][:, place[some]] += bound.strength[some] * found[:, 1:].T

        for_chunks(work, self.portions, 1)
        gradient = np.zeros((k, n))
        gradient[:, self.acting] = sum(totals[portion] for portion in range(self.portions))
        return gradient
