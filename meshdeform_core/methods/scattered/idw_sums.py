"""The values that IDW sums over its sources, and their sums, exact or fast over clusters of sources; ``method`` is a
:class:`.idw.PreparedIDW`."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...grid import BoolArray, FloatArray, IntArray
from ...numerics.arrays import Report, weighted_total
from ...numerics.exact.direct import weighted_sums
from ...numerics.fastsum.tuned import SHARE, SINGLE_TOLERANCE
from ...numerics.rigid import NO_TRANSITION, Frame, Transition
from ...parallel import Nodes, for_chunks
from .summation import largest_error, sum_accurately

if TYPE_CHECKING:
    from ...numerics.fastsum.weighted import FastSums

_CHUNK, _ROWS = 2048, 1 << 16
"""Nodes per chunk, and nodes whose gradients are transposed at a time, which bounds the memory."""
CHECKED = 64
"""Nodes per chunk when fast sums are compared with exact ones, and sources per chunk of transposed sums."""

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


class ExactSums:
    """Exact sums of values over the sources, every node with every source, and their transposes.

    Interface as :class:`...numerics.fastsum.weighted.FastSums`; ``acting`` (n,) are the sources with values other than
    zero, by default all.
    """

    def __init__(self, method: Any, weights: Weights, acting: BoolArray | None = None) -> None:
        self.flat, self._points, self._weights = method.flat, method.problem.grid.nodes.rows, weights
        self._sources, self._strength, self._groups = method.images.points, method.strength, method.groups
        self.acting = np.ones(len(self._sources), dtype=bool) if acting is None else acting

    @property
    def portions(self) -> int:
        """Number of parts of the nodes whose gradients :meth:`transpose` asks for one by one."""
        return -(-len(self.flat) // _CHUNK)

    def at(self, flat: IntArray, values: FloatArray, weigh: bool = True, chunk: int | None = None) -> FloatArray:
        """Sums (m, 1 + k) of values (k, n) at some nodes, the total weight first, or zero unless ``weigh``; ``chunk``
        nodes at a time, if no other loop uses the threads."""
        x, sums = Nodes.of(self._points).at(flat), np.zeros((len(flat), 1 + len(values)))
        for group, weights in zip(self._groups, self._weights, strict=True):
            acts = self.acting[group]
            for some, kept in ((group[acts], values), (group[~acts], values[:0])):
                if len(some) and (weigh or len(kept)):
                    near = self._sources[some], self._strength[some]
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
        gradient = np.zeros((k, len(self.acting)))
        for first in range(0, len(self.flat), _ROWS):
            flat = self.flat[first : first + _ROWS]
            given, x, ones = np.empty((k, len(flat))), self._points[flat], np.ones(len(flat))

            def ask(lo: int, hi: int, first: int = first, flat: IntArray = flat, given: FloatArray = given) -> None:
                given[:, lo:hi] = make(slice(first + lo, first + hi), flat[lo:hi], (first + lo) // _CHUNK).T

            for_chunks(ask, len(flat), _CHUNK)
            for group, weights in zip(self._groups, self._weights, strict=True):
                some = group[self.acting[group]]
                found = weighted_sums(self._sources[some], x, ones, weights, given, chunk=CHECKED)
                gradient[:, some] += self._strength[some] * found[:, 1:].T
        return gradient


def interpolation_order(tolerance: float) -> int:
    """Interpolation points per side of a cube for a relative tolerance: 4 for 1e-2, 5 for 1e-4, 7 for 1e-8."""
    return 3 + math.ceil(-0.5 * math.log10(tolerance) - 1e-9)


def sums_of_groups(method: Any, groups: Sequence[IntArray], order: int, room: int, *per_point: int) -> FastSums:
    """Sums over clusters of groups of sources; arguments as of ``FastSums`` and ``make_targets``."""
    # Imported here, as its loops take a while to load and exact sums need none of them.
    from ...numerics.fastsum.clusters import build_tree
    from ...numerics.fastsum.targets import make_targets
    from ...numerics.fastsum.weighted import FastSums

    grid = method.problem.grid
    trees = [build_tree(method.images.points[group], order) for group in groups]
    targets = make_targets(grid.nodes.rows, grid.shapes, grid.offsets, method.flat, order, *per_point)
    return FastSums(method.strength, groups, trees, targets, room)


def apply_fast(
    method: Any, sums: FastSums, fit: SourceValues, use: Use, out: FloatArray, progress: Report | None
) -> None:
    """Call ``use`` with the sums at all targets, which writes their displacements into ``out`` (n_nodes, 3), compared
    with exact sums at the worst nodes."""
    from ...numerics.fastsum.weighted import Accuracy

    tolerance, grid = method.options.summation_tolerance, method.problem.grid
    lasting, found = 1 if fit.transition.width else 0, Nodes.of(out).rows
    mean = weighted_total(sums.strength, fit.values.T) / sums.strength.sum()
    middle = mean if fit.still is None else fit.still
    moving = (fit.values != middle[:, None]).any(axis=0)
    share, single = SHARE / (interpolation_order(tolerance) - 2) ** 2, tolerance >= SINGLE_TOLERANCE

    def exact(flat: IntArray) -> FloatArray:
        # Sources that do not move are summed once.
        plan, apart = sums.plans[0], fit.values - middle[:, None]
        weigh = not plan.checked.size
        found = ExactSums(method, fit.weights, moving).at(flat, apart, weigh, CHECKED)
        if weigh:
            plan.checked = found[:, 0].copy()
        found[:, 0] = plan.checked
        found[:, 1:] += found[:, :1] * middle
        return method.displacement(fit, flat, found.T)

    def once(excess: float) -> float:
        nonlocal share, single
        if excess:
            # In double precision from now on.
            share, single = share * 0.25 / excess, False
        accuracy = Accuracy(tolerance * share, True, single)
        sums.prepare(fit.weights, fit.shift, fit.turn, moving, accuracy, lasting)
        sums.apply(fit.values, use, progress=progress, middle=middle)
        return largest_error(grid, sums.targets, sums.risk, found, exact)

    sum_accurately("idw", once, tolerance, method.account)
