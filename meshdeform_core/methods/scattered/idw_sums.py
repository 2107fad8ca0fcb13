"""What IDW sums over its sources, and exact sums; :mod:`.fast_idw_sums` has those over clusters of sources."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...grid import FloatArray, Grid, IntArray
from ...numerics.exact.direct import weighted_sums
from ...numerics.frame import Frame
from ...numerics.rigid import NO_TRANSITION, Transition, finish
from ...parallel import Shared, apart, for_chunks, rows_of
from ..base import Progress, of_stage

_CHUNK = 2048
# The nodes at which fast sums are checked are few.
_CHECKED = 64


@dataclass(frozen=True)
class SourceValues:
    """A displacement prepared for summation.

    ``path`` source positions (n, 3) at the start of every step, relative to ``origin`` (3,): one step, unless the
    weights are recomputed on the way; ``values`` (k, n) per source; ``weights`` (a, b, kappa) per group; ``shift`` and
    ``turn`` (n,) displacement and rotation angle of each source; ``frame`` the mean motion that was taken out;
    ``still`` (k,) the values of sources that do not move, if there are any; ``transition`` from moving sources to
    others.
    """

    path: tuple[FloatArray, ...]
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
    """Sources and targets of one undeformed grid: ``flat`` nodes of ``grid``; sources (n, 3) with strength (n,).

    ``room`` is the memory (bytes) for data kept between displacements.
    """

    grid: Grid
    flat: IntArray
    sources: FloatArray
    strength: FloatArray
    groups: tuple[IntArray, ...]
    rotation: str
    divisions: int
    reweight: bool
    room: int

    @property
    def points(self) -> FloatArray:
        """Coordinates (n_nodes, 3), of a grid in parts those that this rank holds."""
        return np.asarray(rows_of(self.grid.points))

    @property
    def repeats(self) -> int:
        """Number of steps in which the mean rigid motion is applied."""
        return self.divisions if self.rotation == "division" and not self.reweight else 1


@dataclass(frozen=True)
class Weighed:
    """Total weight (n,) of the nodes ``flat`` with the weight functions of each group, from exact sums."""

    flat: IntArray
    weights: tuple[tuple[float, float, float], ...]
    total: FloatArray


@dataclass(frozen=True)
class ExactEvaluator:
    """Every target with every source."""

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
        x = self.bound.points[flat] - fit.origin
        total = np.zeros_like(x)
        for sources in fit.path:
            total += self._moved(fit, x + total, self._sums(fit, x + total, sources))
        return fit.frame.absolute(self.bound.points[flat], total)

    def checked(self, fit: SourceValues, flat: IntArray, known: Weighed | None) -> tuple[FloatArray, Weighed | None]:
        """The same, and the weights of these nodes; where they are ``known``, they are not summed again."""
        if len(fit.path) > 1 or fit.still is None:
            return self.displacement(fit, flat), None
        x = self.bound.points[flat] - fit.origin
        if known is None or known.weights != fit.weights or not np.array_equal(known.flat, flat):
            known = Weighed(flat, fit.weights, self._weight(fit, x))
        moved = self._moved(fit, x, self._sums_of_moving(fit, x, known.total))
        return fit.frame.absolute(self.bound.points[flat], moved), known

    def _moved(self, fit: SourceValues, x: FloatArray, sums: FloatArray) -> FloatArray:
        """Displacement (n, 3) in one step of targets at ``x``, relative to the origin, from their sums (n, 1 + k)."""
        moved = np.empty_like(x)
        finish(self.bound.rotation, sums, x, moved, self.bound.repeats, fit.transition)
        return moved

    def _sums(self, fit: SourceValues, x: FloatArray, sources: FloatArray) -> FloatArray:
        """Sums (n, 1 + k) at targets ``x`` over the sources where they are in one step."""
        sums = np.zeros((len(x), 1 + len(fit.values)))
        for group, weights in zip(self.bound.groups, fit.weights, strict=True):
            near = sources[group], self.bound.strength[group]
            sums += weighted_sums(x, *near, weights, fit.values[:, group])
        return sums

    def _weight(self, fit: SourceValues, x: FloatArray) -> FloatArray:
        """Total weight (n,) at targets ``x``."""
        total = np.zeros(len(x))
        for group, weights in zip(self.bound.groups, fit.weights, strict=True):
            near = fit.path[0][group], self.bound.strength[group]
            total += weighted_sums(x, *near, weights, np.empty((0, len(group))), chunk=_CHECKED)[:, 0]
        return total

    def _sums_of_moving(self, fit: SourceValues, x: FloatArray, total: FloatArray) -> FloatArray:
        """Sums (n, 1 + k) for a total weight (n,), over the moving sources, relative to the value of those at rest."""
        assert fit.still is not None
        values, sums = fit.values - fit.still[:, None], np.empty((len(x), 1 + len(fit.values)))
        sums[:, 0], sums[:, 1:] = total, total[:, None] * fit.still
        for group, weights in zip(self.bound.groups, fit.weights, strict=True):
            some = group[values[:, group].any(axis=0)]
            near = fit.path[0][some], self.bound.strength[some]
            sums[:, 1:] += weighted_sums(x, *near, weights, values[:, some], chunk=_CHECKED)[:, 1:]
        return sums
