"""Repair of deformed grids: nodes are moved until every cell is sound; the boundary stays in place.

The repaired grid is the minimum of an energy over all nodes, a smooth function of the displacement of the boundary: see
:mod:`.energy`. In large grids with few bad cells it is that over the nodes around them. Where the minimum is out of
reach, cells are untangled in regions that grow until all cells are sound. A repair begins with the method's grid,
whatever was repaired earlier. It runs in one process: of ranks, the first one.
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
import scipy

from ..errors import MethodError
from ..grid import FloatArray, IntArray
from ..memory import UNLIMITED, MemoryLimit
from ..numerics.arrays import lengths
from ..parallel import Nodes
from ..quality.validity import judge
from .constraints import Extrusion
from .energy import kept_along_lines
from .limit import Limit
from .newton import NewtonSystem
from .onset import unhealthy_cells
from .options import Effort
from .outcome import Judged, Outcome, Repair
from .region import Basis, Plot
from .tuned import FEW, KEPT, LARGE, LAYERS, PER_NODE, REGIONS, SQUASHED
from .untangle import WAYS, Progress, Search, Untangler, Way, search_minimum, search_untangled

WEAK = 0.35
"""Cells with a corner below this fraction of its undeformed Jacobian are the centres of regions."""
_ROUNDS, _LAST_ROUNDS = 2, 6
# More layers are tried while the largest f exceeds _ENOUGH; in valid grids only if the first layers reduced it to less
# than _GAIN of its value.
_ENOUGH, _GAIN = 2.9, 0.9


@dataclass(frozen=True)
class _Found:
    """The best grid, how many Newton steps were taken to it, whether it is the minimum, the share of the energy, how
    many cells of an extruded grid were weak, and the reason why nothing was done."""

    grid: Judged
    steps: int = 0
    converged: bool = False
    share: float = 0.0
    weak: int = 0
    left_out: str | None = None


@dataclass(frozen=True, eq=False)
class Repairer:
    """Repairs of deformed states of one grid.

    Attributes
    ----------
    rounded : function that rounds coordinates to the precision of the output, to which the verdict applies
    memory, limit : memory of each repair; time and work of all repairs together
    farthest : no node moves farther than this (grid length unit)
    """

    basis: Basis
    rounded: Callable[[FloatArray], FloatArray] = lambda points: points
    memory: MemoryLimit = UNLIMITED
    progress: Progress | None = None
    limit: Limit = field(default_factory=Limit)
    farthest: float = np.inf

    def repair(self, start: Judged, polish: bool = False, effort: Effort = "all") -> Outcome | None:
        """Make cells sound; the result may still have invalid cells, but no more than the grid at the ``start``, which
        is not touched outside the neighbourhood of the cells that are or were invalid then. ``None`` if no cell is
        invalid or weak.

        If it is found, the result is the minimum of the energy. Otherwise cells are untangled in regions, and the
        minimum is searched for from there. ``polish``: the weakest cells count as weak however good they are.
        """
        begin, valid = clock.perf_counter(), start.verdict.valid
        # Coordinates of the plane grid that this one is extruded from, if the motion stays in its plane.
        flat = None
        if self.basis.extrusion is not None:
            (extrusion, _), undeformed = self.basis.extrusion, self.basis.original.grid.points
            change = extrusion.flattened(Nodes.of(start.points).combined(np.subtract, undeformed))
            flat = None if change is None else extrusion.plane.points + change
        weak = np.empty(0, dtype=np.int64) if flat is not None else unhealthy_cells(self.basis.original, start.points)
        bad = np.union1d(weak, start.verdict.invalid)
        limit = self.limit.of_repair(self.basis.original.grid.n_nodes, start.verdict.smallest_ratio if valid else 0.0)
        try:
            if flat is not None:
                found = self._repaired_in_plane(start, flat, polish, effort, limit)
            else:
                found = self._found(start, bad, polish, effort, limit)
        except MethodError as error:
            found = _Found(start, left_out=str(error))
        if found is None or (valid and not (found.steps or found.left_out)):
            return None
        if valid and not polish:
            found = replace(found, grid=self._kept(start, found.grid))
        count = found.weak or len(np.setdiff1d(weak, start.verdict.invalid))
        low, high = Nodes.of(start.points).ends
        distance = lengths(found.grid.points[low:high] - start.points[low:high])
        own = int((distance > 0).sum()), float(distance.max(initial=0.0))
        nodes, farthest = zip(*Nodes.of(start.points).gather(own), strict=True)
        moved = sum(nodes), max(farthest), found.steps, clock.perf_counter() - begin
        converged = found.converged and found.grid.verdict.valid
        record = Repair(start.count, count, *moved, converged, left_out=found.left_out)
        return Outcome(found.grid.points, found.grid.verdict, repair=record)

    def _found(self, start: Judged, bad: IntArray, polish: bool, effort: Effort, limit: Limit) -> _Found | None:
        if not (bad.size or polish):
            return None
        plot = self._plot(bad, polish)
        found: _Found | None = _Found(start)
        if plot is not None and effort != "hasty":
            found = self._minimum(start, plot, polish, limit, None)
        if found and not found.grid.verdict.valid:
            found = self._by_regions(start, found, plot, polish, limit, () if limit.reached else WAYS[effort])
            if not found.grid.verdict.valid:
                found = replace(found, grid=self._undone(start, found.grid))
        return found

    def _plot(self, bad: IntArray, polish: bool) -> Plot | None:
        """All nodes that may move or, in large grids with few ``bad`` cells, those around them.

        Raises
        ------
        MethodError
            When they do not fit into memory.
        """
        basis, grid = self.basis, self.basis.grid
        nodes = basis.n_unknowns
        if nodes > LARGE and not polish and bad.size < FEW * grid.n_cells:
            room = min(PER_NODE * grid.n_nodes, self.memory.size) // NewtonSystem.memory(1, grid.dimension)
            near = basis.near(bad, max(LAYERS))
            layers = near.largest_below(room, LAYERS)
            if layers is not None:
                return basis.plot(near._replace(most=layers))
        self._require(nodes)
        return self.basis.whole

    def _require(self, nodes: int) -> None:
        needed = NewtonSystem.memory(nodes, self.basis.original.grid.dimension)
        self.memory.require(needed, f"a repair of {nodes:,} nodes", "allow more, or take --repair off")

    def _searched(
        self, start: Judged, plot: Plot, limit: Limit, search: Callable[[Plot, Untangler], Search | None]
    ) -> Search | None:
        """A search in one process; of ranks, by the first one."""
        reference, before = plot.inside(start.points), limit.spent

        def searched() -> tuple[Search | None, float]:
            parts = plot.region, reference, reference, plot.system, self.farthest
            found = search(plot, Untangler(*parts, progress=self.progress, limit=limit))
            return found, limit.spent - before

        found, spent = Nodes.of(start.points).on_first(searched)
        # Of the other ranks.
        limit.spend(spent - (limit.spent - before))
        return found

    def _minimum(self, start: Judged, plot: Plot, polish: bool, limit: Limit, near: Judged | None) -> _Found | None:
        """The grid at, or on the way to, the minimum of the energy, searched for from ``near``, by default from the
        ``start``; ``None`` if no cell is weak."""
        shift = None if near is None else plot.vectors(Nodes.of(near.points).combined(np.subtract, start.points))
        found = self._searched(start, plot, limit, partial(search_minimum, polish=polish, shift=shift))
        if found is None:
            return None if start.verdict.valid else _Found(start)
        end = self._moved(start, plot, found.shift)
        if not end.verdict.valid and found.untangled is not None:
            # On the way to a minimum that is not reached, cells may become invalid between their samples.
            end = self._moved(start, plot, found.untangled)
        if start.verdict.valid and not end.verdict.valid:
            end = start
        converged = found.succeeded and plot.whole and end.verdict.valid
        return _Found(end, found.steps, converged, found.share)

    def _by_regions(
        self, start: Judged, found: _Found, plot: Plot | None, polish: bool, limit: Limit, ways: tuple[Way, ...]
    ) -> _Found:
        """The best grid of all ``ways``, and whether the minimum was found from there."""
        best, steps = min(found.grid, start, key=lambda grid: grid.count), found.steps
        for way in ways:
            other, more = self._growing(start, way, limit)
            best, steps = (other if other.count < best.count else best), steps + more
            if best.verdict.valid or limit.reached:
                break
        if plot is None or not best.verdict.valid or best is start:
            return replace(found, grid=best, steps=steps)
        nearer = self._minimum(start, plot, polish, limit, best) or found
        grid = nearer.grid if nearer.grid.verdict.valid else best
        return replace(nearer, grid=grid, steps=steps + nearer.steps)

    def _growing(self, start: Judged, way: Way, limit: Limit) -> tuple[Judged, int]:
        """The best grid, and the Newton steps taken, of regions around cells with a relative Jacobian below WEAK.

        First the nodes within a few layers move, then more, until the worst cell is close enough to its undeformed
        shape or more nodes do not help; a patient strategy moves all nodes at once.
        """
        best, now, basis = start, start, self.basis
        steps, density, done = 0, np.inf, 0
        for layers in REGIONS[self.basis.original.grid.dimension][-1 if way.patient else 0 : 1 if way.hasty else None]:
            if limit.reached:
                break
            found, rounds = None, 0
            while rounds < (_ROUNDS if layers else _LAST_ROUNDS):
                if layers is None:
                    self._require(basis.n_unknowns)
                    plot = basis.plot(even=way.even)
                else:
                    weak = Nodes.of(now.points).gather(now.verdict.weak(WEAK))
                    plot = basis.plot(basis.near(np.concatenate(weak), layers), way.even)
                if plot is None or len(plot.moved) == done:
                    break
                other = self._searched(now, plot, limit, partial(search_untangled, way=way))
                assert other is not None
                found, steps, rounds, now = other, steps + other.steps, rounds + 1, self._moved(now, plot, other.shift)
                size, helped = len(plot.moved), _ENOUGH < found.after < _GAIN * found.before
                if not found.succeeded or (now.verdict.valid and (layers or not helped)):
                    break
            if found is None:
                break
            if now.count < best.count or (now.count == best.count and found.after < density):
                best, density = now, found.after
            if now.verdict.valid and density < _ENOUGH:
                break
            done = size if now.verdict.valid else 0
        return best, steps

    def _kept(self, start: Judged, end: Judged) -> Judged:
        """The grid ``end``, or as much of the way to it as keeps the share KEPT of the ``start``'s smallest scaled
        Jacobian: what the energy gives to walls it may not take from the worst cell without limit. Of a start with
        squashed cells it keeps less: cells that have lost their size are worse than those that have lost their angles.
        """
        least = KEPT * self._smallest_scaled(start) * min(1.0, start.verdict.smallest_ratio / SQUASHED)
        if end is start or least <= 0.0 or self._smallest_scaled(end) >= least:
            return end

        def between(part: float) -> Judged:
            return self._blended(start, end, lambda rows: part)

        # As exact as the minimum: a coarser part would make moving grids jump.
        part = scipy.optimize.brentq(lambda part: self._smallest_scaled(between(part)) - least, 0.0, 1.0, xtol=1e-7)
        found = between(part)
        return found if found.verdict.valid else start

    def _blended(self, start: Judged, end: Judged, part: Callable[[slice], Any]) -> Judged:
        """The grid at a ``part`` of the way of every node of some rows from the ``start`` to the ``end``."""
        points = Nodes.of(end.points).like(3)

        def fill(rows: slice) -> None:
            points[rows][:] = start.points[rows] + part(rows) * (end.points[rows] - start.points[rows])

        Nodes.of(points).each(fill)
        self.basis.back_to_surfaces(points)
        return Judged(points, judge(self.basis.original, self.rounded(points)))

    def _smallest_scaled(self, grid: Judged) -> float:
        """The smallest scaled Jacobian."""
        return grid.smallest_scaled_jacobian(self.basis.original, self.rounded)

    def _undone(self, start: Judged, end: Judged) -> Judged:
        """The grid ``end`` near cells that are invalid in it or at the ``start``, and the ``start`` far from them."""
        cells = np.union1d(start.verdict.invalid, end.verdict.invalid)

        def near(distance: Any, layers: int, rows: slice) -> FloatArray:
            part = (2.0 * layers - Nodes.of(distance).rows[rows]) / layers
            return np.clip(part, 0.0, 1.0)[:, None]

        for layers in LAYERS[2:]:
            found = self._blended(start, end, partial(near, self.basis.near(cells, 2 * layers).layers, layers))
            if found.count <= end.count:
                return found
        return end

    def _repaired_in_plane(
        self, start: Judged, flat: FloatArray, polish: bool, effort: Effort, limit: Limit
    ) -> _Found | None:
        """The repair on the plane grid that this one is extruded from."""
        assert self.basis.extrusion is not None
        extrusion, basis = self.basis.extrusion
        plane = Repairer(basis, self.rounded, self.memory, self.progress, self.limit, self.farthest)
        plain = Judged(flat, judge(basis.original, self.rounded(flat)))
        weak = unhealthy_cells(basis.original, flat)
        found = plane._found(plain, np.union1d(weak, plain.verdict.invalid), polish, effort, limit)
        if found is None or not found.steps:
            return found and replace(found, grid=start)
        kept = 0.0 if polish else kept_along_lines(found.share)[0]
        after = self._spread(extrusion, start.points, flat, found.grid.points, kept)
        layers = self.basis.original.grid.n_cells // extrusion.plane.n_cells
        return replace(found, grid=after, weak=layers * len(np.setdiff1d(weak, plain.verdict.invalid)))

    def _spread(
        self, extrusion: Extrusion, points: FloatArray, flat: FloatArray, end: FloatArray, kept: float
    ) -> Judged:
        """The grid for the plane grid ``end`` that was ``flat`` before its repair, with a part ``kept`` of what differs
        along lines in ``points``, or nothing of it where cells would be invalid."""
        plane, start = extrusion.plane.points, self.basis.original.grid.points
        spread = extrusion.spread(start, points, flat - plane, end - plane, kept)
        after = Judged(spread, judge(self.basis.original, self.rounded(spread)))
        return after if after.verdict.valid or not kept else self._spread(extrusion, points, flat, end, 0.0)

    def _moved(self, now: Judged, plot: Plot, shift: FloatArray) -> Judged:
        points: FloatArray = Nodes.of(now.points).like(3)
        Nodes.of(points).each(lambda rows: np.copyto(points[rows], now.points[rows]))
        own = slice(*np.searchsorted(plot.moved, Nodes.of(points).ends).tolist())
        Nodes.of(points).rows[plot.moved[own]] += shift[own]
        return Judged(points, judge(self.basis.original, self.rounded(points)))
