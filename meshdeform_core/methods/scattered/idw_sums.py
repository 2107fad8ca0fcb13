"""The values that IDW sums over its sources, and exact sums; :mod:`.fast_idw_sums` sums over clusters of sources."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...grid import FloatArray, Grid, IntArray
from ...numerics.exact.direct import weighted_sums
from ...numerics.frame import Frame
from ...numerics.rigid import NO_TRANSITION, Transition, finish
from ...parallel import Shared, apart, for_chunks, rows_at, rows_of
from ..base import Progress, of_stage

_CHUNK = 2048
# Nodes per chunk when fast sums are checked.
_CHECKED = 64


@dataclass(frozen=True)
class SourceValues:
    """A displacement prepared for summation.

    ``sources`` (n, 3) relative to ``origin`` (3,); ``values`` (k, n) per source; ``weights`` (a, b, kappa) per group;
    ``shift`` and ``turn`` (n,), magnitude of the displacement and rotation angle (radians) of each source; ``frame``,
    the mean motion that was removed; ``still`` (k,), the values of sources that do not move, if any; ``transition``
    between moving sources and others.
    """

    sources: FloatArray
    values: FloatArray
    weights: tuple[tuple[float, float, float], ...]
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
        return np.asarray(rows_of(self.grid.points))

    @property
    def repeats(self) -> int:
        """Number of steps in which the mean rigid motion is applied."""
        return self.divisions if self.rotation == "division" else 1


@dataclass(frozen=True)
class Weighed:
    """Total weight (n,) of the nodes ``flat`` with the weight functions of each group, from exact sums."""

    flat: IntArray
    weights: tuple[tuple[float, float, float], ...]
    total: FloatArray


@dataclass(frozen=True)
class ExactEvaluator:
    """Exact sums: every target with every source."""

    bound: Bound

    def evaluate(self, fit: SourceValues, out: FloatArray, progress: Progress | None) -> None:
        """Write the displacement of the targets into ``out`` (n_nodes, 3)."""
        flat, rows = self.bound.flat, rows_of(out)

        def work(lo: int, hi: int) -> None:
            rows[flat[lo:hi]] = self.displacement(fit, flat[lo:hi])

        with apart(out):
            shared = [Shared(rows, lambda lo, hi: flat[lo:hi])]
            for_chunks(work, len(flat), _CHUNK, of_stage(progress, "idw"), shared)

    def displacement(self, fit: SourceValues, flat: IntArray) -> FloatArray:
        """Displacement (n, 3) of the nodes ``flat``."""
        x = rows_at(self.bound.points, flat) - fit.origin
        moved = self._moved(fit, x, self._sums(fit, x))
        return fit.frame.absolute(rows_at(self.bound.points, flat), moved)

    def checked(self, fit: SourceValues, flat: IntArray, known: Weighed | None) -> tuple[FloatArray, Weighed | None]:
        """:meth:`displacement` and the weights of these nodes, which are not summed again if ``known``."""
        if fit.still is None:
            return self.displacement(fit, flat), None
        x = rows_at(self.bound.points, flat) - fit.origin
        if known is None or known.weights != fit.weights or not np.array_equal(known.flat, flat):
            known = Weighed(flat, fit.weights, self._weight(fit, x))
        moved = self._moved(fit, x, self._sums_of_moving(fit, x, known.total))
        return fit.frame.absolute(rows_at(self.bound.points, flat), moved), known

    def _moved(self, fit: SourceValues, x: FloatArray, sums: FloatArray) -> FloatArray:
        """Displacement (n, 3) of targets at ``x``, relative to the origin, from their sums (n, 1 + k)."""
        moved = np.empty_like(x)
        finish(self.bound.rotation, sums, x, moved, self.bound.repeats, fit.transition)
        return moved

    def _sums(self, fit: SourceValues, x: FloatArray) -> FloatArray:
        """Sums (n, 1 + k) at targets ``x`` over the sources."""
        sums = np.zeros((len(x), 1 + len(fit.values)))
        for group, weights in zip(self.bound.groups, fit.weights, strict=True):
            near = fit.sources[group], self.bound.strength[group]
            sums += weighted_sums(x, *near, weights, fit.values[:, group])
        return sums

    def _weight(self, fit: SourceValues, x: FloatArray) -> FloatArray:
        """Total weight (n,) at targets ``x``."""
        total = np.zeros(len(x))
        for group, weights in zip(self.bound.groups, fit.weights, strict=True):
            near = fit.sources[group], self.bound.strength[group]
            total += weighted_sums(x, *near, weights, np.empty((0, len(group))), chunk=_CHECKED)[:, 0]
        return total

    def _sums_of_moving(self, fit: SourceValues, x: FloatArray, total: FloatArray) -> FloatArray:
        """Sums (n, 1 + k), with the ``total`` weight (n,), of values relative to those of the sources at rest.

        Only moving sources are summed.
        """
        assert fit.still is not None
        sums = np.empty((len(x), 1 + len(fit.values)))
        sums[:, 0], sums[:, 1:] = total, total[:, None] * fit.still
        for group, weights in zip(self.bound.groups, fit.weights, strict=True):
            moving = np.zeros(len(group), dtype=bool)
            # Value by value: the differences of all of them would take as much memory as the values.
            for value, rest in zip(fit.values, fit.still, strict=True):
                moving |= value[group] != rest
            some = group[moving]
            near, values = (fit.sources[some], self.bound.strength[some]), fit.values[:, some]
            values -= fit.still[:, None]
            sums[:, 1:] += weighted_sums(x, *near, weights, values, chunk=_CHECKED)[:, 1:]
        return sums
