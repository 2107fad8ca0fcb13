"""Repair of deformed grids: nodes are moved until every cell is sound; the boundary stays in place.

The repaired grid is the minimum of an energy over all nodes, a smooth function of the displacement of the boundary:
see :mod:`.onset`. Where that minimum is out of reach, cells are untangled in regions: see :mod:`.regions`.
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..grid import FloatArray
from ..memory import UNLIMITED, MemoryLimit
from ..numerics.arrays import lengths
from ..parallel import alike, combined, for_rows, of_all, own_rows, rows_of, together
from ..quality.verdict.validity import Verdict, judge
from .basis import Basis, Whole
from .energy.newton import NewtonSystem
from .energy.onset import kept_along_lines, share_of
from .energy.untangle import CLOSE
from .extrusion import Extrusion
from .limit import Limit
from .minimum import Progress, Search, minimise
from .outcome import Judged, Outcome, Repair
from .regions import EVERY_WAY, WEAK, Growth, Way

POOR = 0.1
"""Valid cells with a corner below this fraction of its undeformed Jacobian are counted as weak in reports."""
COLLAPSING = 0.01
"""Valid cells below this fraction are nearly collapsed and cause a warning."""


class Repairer:
    """Repairs of deformed states of one grid.

    Parameters
    ----------
    rounded : function that rounds coordinates to the precision of the output, to which the verdict applies
    memory, limit : memory of each repair; time and work of all repairs together
    """

    def __init__(
        self,
        basis: Basis,
        rounded: Callable[[FloatArray], FloatArray] = lambda points: points,
        memory: MemoryLimit = UNLIMITED,
        progress: Progress | None = None,
        limit: Limit | None = None,
    ):
        self.basis, self.original, self.rounded = basis, basis.original, rounded
        self.memory, self.progress, self.limit = memory, progress, limit or Limit()

    @property
    def size(self) -> int:
        """Number of nodes of the grid that is repaired: the plane grid, if this one is extruded from it."""
        basis = self.basis.extrusion[1] if self.basis.extrusion else self.basis
        return basis.original.grid.n_nodes

    def needed(self, points: FloatArray, verdict: Verdict) -> bool:
        """Whether any cell is invalid or weak.

        Raises
        ------
        MethodError
            When the memory limit is too small to find out, or to repair them.
        """
        if verdict.failed.any():
            return True

        flat, basis = self._flattened(points) or (points, self.basis)
        return self._share(flat, basis) > 0.0

    def _share(self, points: FloatArray, basis: Basis) -> float:
        """How much the energy of weak cells counts; 0 where no cell is weak."""

        def share() -> float:
            if basis.healthy(points):
                return 0.0
            whole = self._whole(basis)
            if whole is None:
                return 0.0
            region = whole.plot.region
            return share_of(region.energy, whole.plot.inside(points), region.dealt)[0]

        return together(points, share)

    def repair(
        self,
        points: FloatArray,
        verdict: Verdict,
        polish: bool = False,
        ways: tuple[Way, ...] = EVERY_WAY,
        guess: FloatArray | None = None,
        close: float = CLOSE,
    ) -> Outcome:
        """Make cells sound; the result may still have invalid cells, but no more than ``points`` (n_nodes, 3).

        If it is found, the result is the minimum of the energy over all nodes. Newton's method starts from ``guess``
        (n_nodes, 3), the displacement by the repair of a similar grid, which saves time.

        Otherwise the search is repeated without the guess; then cells are untangled in regions, and the minimum is
        searched for from there. The ``ways`` are tried in turn until one succeeds; without any, only the search for the
        minimum is made, once. ``polish``: the weakest cells count as weak however good they are. ``close``: the
        distance from the minimum at which the search ends.

        Raises
        ------
        MethodError
            When the memory limit is too small.
        """
        plane = self._in_plane(points, verdict, polish, ways, guess, close)
        if plane is not None:
            return plane
        begin, start = clock.perf_counter(), Judged(points, verdict)
        best, steps, converged = start, 0, False
        if not any(way.hasty for way in ways):
            best, steps, converged = self._minimum(start, polish, guess, close)
        if guess is not None and ways and not (converged and best.verdict.valid):
            best, more, converged = self._minimum(start, polish, None)
            steps += more
        if not best.verdict.valid:
            left = () if self.limit.reached else ways
            best, more, converged = self._by_regions(start, best, polish, left)
            steps += more
        record = self._record(start, best, steps, clock.perf_counter() - begin)
        return Outcome(best.points, best.verdict, replace(record, converged=converged and best.verdict.valid))

    def _by_regions(self, start: Judged, best: Judged, polish: bool, ways: tuple[Way, ...]) -> tuple[Judged, int, bool]:
        """The best grid of all ``ways``, the number of Newton steps, and whether the minimum was found from there."""
        weak = max(WEAK, min(1.0, 2.0 * start.verdict.smallest_ratio)) if polish else WEAK
        growth, steps = Growth(self.basis, self._moved, self.progress, self.limit), 0
        best = min(best, start, key=lambda grid: grid.count)
        for way in ways:
            other, more = growth.best(start, weak, way)
            best, steps = (other if other.count < best.count else best), steps + more
            if best.verdict.valid or self.limit.reached:
                break
        if not best.verdict.valid or best is start:
            return best, steps, False
        nearer, more, converged = self._minimum(start, polish, combined(np.subtract, best.points, start.points))
        return (nearer if nearer.verdict.valid else best), steps + more, converged

    def _minimum(
        self, start: Judged, polish: bool, guess: FloatArray | None, close: float = CLOSE
    ) -> tuple[Judged, int, bool]:
        """The grid at, or on the way to, the minimum of the energy over all nodes; the number of Newton steps; and
        whether the minimum was reached."""

        def make() -> Search | None:
            whole = self._whole(self.basis)
            if whole is None:
                return None
            return minimise(whole, start.points, polish, guess, self.progress, self.limit, close)

        found = together(start.points, make)
        if found is None:
            return start, 0, False
        end = self._moved(start, found)
        if not end.verdict.valid and found.untangled is not None:
            # On the way to a minimum that is not reached, cells may become invalid between their samples.
            end = self._moved(start, replace(found, shift=found.untangled))
        return end, found.steps, found.succeeded

    def _whole(self, basis: Basis) -> Whole | None:
        nodes, dimension = basis.neighbourhood.shares.largest, basis.original.grid.dimension
        self.memory.require(
            NewtonSystem.memory(nodes, dimension), f"a repair of {nodes:,} nodes", "allow more, or take --repair off"
        )
        return basis.whole

    def _flattened(self, points: FloatArray) -> tuple[FloatArray, Basis] | None:
        """Coordinates and basis of the plane grid that this one is extruded from, if the motion stays in its plane."""
        if self.basis.extrusion is None:
            return None
        extrusion, basis = self.basis.extrusion
        change = extrusion.flattened(combined(np.subtract, points, self.original.grid.points))
        return None if change is None else (extrusion.plane.points + change, basis)

    def _in_plane(
        self,
        points: FloatArray,
        verdict: Verdict,
        polish: bool,
        ways: tuple[Way, ...],
        guess: FloatArray | None,
        close: float,
    ) -> Outcome | None:
        """The repair on the plane grid that this one is extruded from, if the motion stays in its plane."""
        begin, found = clock.perf_counter(), self._flattened(points)
        if found is None or self.basis.extrusion is None:
            return None
        (flat, basis), extrusion = found, self.basis.extrusion[0]
        repairer = Repairer(basis, self.rounded, self.memory, self.progress, self.limit)
        guess = None if guess is None else extrusion.flattened(guess)
        end = repairer.repair(flat, judge(basis.original, self.rounded(flat)), polish, ways, guess, close)
        kept = 0.0 if polish else kept_along_lines(self._share(flat, basis))[0]
        after = self._spread(extrusion, points, flat, end.points, kept)
        seconds = clock.perf_counter() - begin
        record = self._record(Judged(points, verdict), after, end.repair.newton_steps, seconds)
        return Outcome(after.points, after.verdict, replace(record, converged=end.repair.converged))

    def _spread(
        self, extrusion: Extrusion, points: FloatArray, flat: FloatArray, end: FloatArray, kept: float
    ) -> Judged:
        """The grid for the plane grid ``end`` that was ``flat`` before its repair, with a part ``kept`` of what differs
        along lines in ``points``, or nothing of it where cells would be invalid."""
        plane, start = extrusion.plane.points, self.original.grid.points
        spread = extrusion.spread(start, points, flat - plane, end - plane, kept)
        after = Judged(spread, judge(self.original, self.rounded(spread)))
        return after if after.verdict.valid or not kept else self._spread(extrusion, points, flat, end, 0.0)

    def _moved(self, now: Judged, found: Search) -> Judged:
        points: FloatArray = alike(now.points)
        for_rows(lambda rows: np.copyto(points[rows], now.points[rows]), points)
        rows_of(points)[found.moved] += found.shift
        return Judged(points, judge(self.original, self.rounded(points)))

    def _record(self, start: Judged, end: Judged, steps: int, seconds: float) -> Repair:
        low, high = own_rows(start.points)
        distance = lengths(end.points[low:high] - start.points[low:high])
        own = len(start.verdict.weak(POOR)), int((distance > 0).sum()), float(distance.max(initial=0.0))
        cells, nodes, farthest = zip(*of_all(start.points, own), strict=True)
        return Repair(sum(cells), sum(nodes), max(farthest), steps, seconds)
