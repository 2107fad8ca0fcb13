"""Repair of deformed grids: nodes are moved until every cell is sound; the boundary stays in place.

The repaired grid is the minimum of an energy over all nodes, a smooth function of the displacement of the boundary: see
:mod:`.energy`. In large grids with few bad cells it is that over the nodes around them. A repair begins with the
method's grid, whatever was repaired earlier. It runs in one process: of ranks, the first one.
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import scipy

from ..errors import MethodError
from ..grid import FloatArray, IntArray
from ..memory import UNLIMITED, MemoryLimit
from ..numerics.arrays import lengths
from ..parallel import Nodes
from ..quality.validity import judge
from .energy import kept_along_lines
from .newton import NewtonSystem
from .options import Effort, Limit
from .outcome import Judged, Repair, unhealthy_cells
from .region import Basis, Plot
from .tuned import FEW, KEPT, LARGE, LAYERS, PER_NODE, SQUASHED
from .untangle import WAYS, Progress, Search, Untangler, Way

WEAK = 0.35
"""Cells with a corner below this fraction of its undeformed Jacobian are of little use (:mod:`..mending`)."""


@dataclass(frozen=True)
class _Found:
    """The best grid, how many Newton steps were taken to it, whether it is the minimum, how many of the start's cells
    were weak, the part of what differs along the lines of an extruded grid that is kept, and the reason why nothing was
    done."""

    grid: Judged
    steps: int = 0
    converged: bool = False
    weak: int = 0
    kept: float = 0.0
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

    def repair(self, start: Judged, polish: bool = False, effort: Effort = "all") -> Judged | None:
        """Make cells sound; the result may still have invalid cells, but no more than the grid at the ``start``, which
        is not touched outside the neighbourhood of the cells that are or were invalid then. ``None`` if no cell is
        invalid or weak. ``polish``: the weakest cells count as weak however good they are.
        """
        begin, valid = clock.perf_counter(), start.verdict.valid
        limit = self.limit.of_repair(self.basis.grid.n_nodes, start.verdict.smallest_ratio if valid else 0.0)
        found = self._in_plane(start, polish, effort, limit) or self._found(start, polish, effort, limit)
        if valid and not (found.steps or found.left_out):
            return None
        if valid and not polish:
            found = replace(found, grid=self._kept(start, found.grid))
        distance = lengths(Nodes.of(found.grid.points).own - Nodes.of(start.points).own)
        own = int((distance > 0).sum()), float(distance.max(initial=0.0))
        nodes, farthest = zip(*Nodes.of(start.points).gather(own), strict=True)
        moved = sum(nodes), max(farthest), found.steps, clock.perf_counter() - begin
        converged = found.converged and found.grid.verdict.valid
        record = Repair(start.count, found.weak, *moved, converged, left_out=found.left_out)
        return replace(found.grid, repair=record)

    def _in_plane(self, start: Judged, polish: bool, effort: Effort, limit: Limit) -> _Found | None:
        """The repair of the plane grid that this one is extruded from, whose nodes all nodes of a line follow; ``None``
        if there is none, or the motion leaves its plane."""
        if self.basis.extrusion is None:
            return None
        (extrusion, basis), undeformed = self.basis.extrusion, self.basis.grid.points
        mean = extrusion.flattened(Nodes.of(start.points).combined(np.subtract, undeformed))
        if mean is None:
            return None
        inside = replace(self, basis=basis)
        flat = inside._judged(extrusion.plane.points + mean)
        found = inside._found(flat, polish, effort, limit)
        weak = self.basis.grid.n_cells // extrusion.plane.n_cells * found.weak
        if not found.steps and start.verdict.valid:
            return replace(found, grid=start, weak=weak)
        # What differs along lines goes where it would make cells invalid.
        shift = found.grid.points - flat.points
        for kept in (0.0,) if polish or not found.kept else (found.kept, 0.0):
            end = self._judged(extrusion.spread(start.points, undeformed, mean, shift, kept))
            if end.verdict.valid:
                break
        return replace(found, grid=end, weak=weak)

    def _found(self, start: Judged, polish: bool, effort: Effort, limit: Limit) -> _Found:
        """The minimum of the energy or, if it is not found, the best grid on the way to it in any of the ways."""
        valid, weak = start.verdict.valid, unhealthy_cells(self.basis.original, start.points)
        bad = np.union1d(weak, start.verdict.invalid)
        best = _Found(start, weak=len(np.setdiff1d(weak, start.verdict.invalid)))
        if not (bad.size or polish):
            return best
        sound = False
        for way in WAYS[effort]:
            if way.even and not sound:
                continue
            try:
                plot = self._plot(bad, polish or way.patient)
            except MethodError as error:
                if not best.steps:
                    return replace(best, left_out=str(error))
                break
            found = self._searched(start, plot, limit, way, polish) if plot else None
            if plot is None or found is None:
                continue
            sound, end = found.sound, self._moved(start, plot, found.shift)
            if not end.verdict.valid and found.untangled is not None:
                # On the way to a minimum that is not reached, cells may become invalid between their samples.
                end = self._moved(start, plot, found.untangled)
            better = end.verdict.valid or (not valid and end.count < best.grid.count)
            grid, kept = (end if better else best.grid), kept_along_lines(found.share)[0]
            best = replace(best, steps=best.steps + found.steps, grid=grid, kept=kept)
            if best.grid.verdict.valid or limit.reached:
                best = replace(best, converged=found.converged and plot.whole and end.verdict.valid)
                break
        return best if best.grid.verdict.valid else replace(best, grid=self._undone(start, best.grid))

    def _plot(self, bad: IntArray, whole: bool) -> Plot | None:
        """All nodes that may move or, in large grids with few ``bad`` cells, those around them.

        Raises
        ------
        MethodError
            When they do not fit into memory.
        """
        basis, grid = self.basis, self.basis.grid
        nodes = basis.n_unknowns
        if nodes > LARGE and not whole and bad.size < FEW * grid.n_cells:
            room = min(PER_NODE * grid.n_nodes, self.memory.size) // NewtonSystem.memory(1, grid.dimension)
            layers = basis.near(bad, max(LAYERS))
            counts = Nodes.of(layers).gather(np.bincount(Nodes.of(layers).own, minlength=max(LAYERS) + 2))
            total = np.cumsum(np.sum(counts, axis=0))
            if most := max((each for each in LAYERS if total[each] <= room), default=0):
                return basis.plot(layers, most)
        needed = NewtonSystem.memory(nodes, grid.dimension)
        self.memory.require(needed, f"a repair of {nodes:,} nodes", "allow more, or take --repair off")
        return basis.whole

    def _searched(self, start: Judged, plot: Plot, limit: Limit, way: Way, polish: bool) -> Search | None:
        """A search in one process; of ranks, by the first one."""
        reference, own = plot.inside(start.points), limit.of_one_rank()

        def searched() -> tuple[Search | None, float]:
            return Untangler(plot, reference, self.farthest, own, self.progress).search(way, polish), own.spent

        found, spent = limit.ranks.on_first(searched)
        limit.spend(spent)
        return found

    def _kept(self, start: Judged, end: Judged) -> Judged:
        """The grid ``end``, or as much of the way to it as keeps the share KEPT of the ``start``'s smallest scaled
        Jacobian: what the energy gives to walls it may not take from the worst cell without limit. Of a start with
        squashed cells it keeps less: cells that have lost their size are worse than those that have lost their angles.
        """

        def smallest(grid: Judged) -> float:
            return grid.smallest_scaled_jacobian(self.basis.original, self.rounded)

        least = KEPT * smallest(start) * min(1.0, start.verdict.smallest_ratio / SQUASHED)
        if end is start or least <= 0.0 or smallest(end) >= least:
            return end

        def between(part: float) -> Judged:
            return self._blended(start, end, lambda rows: part)

        # As exact as the minimum: a coarser part would make moving grids jump.
        part = scipy.optimize.brentq(lambda part: smallest(between(part)) - least, 0.0, 1.0, xtol=1e-7)
        found = between(part)
        return found if found.verdict.valid else start

    def _blended(self, start: Judged, end: Judged, part: Callable[[slice], Any]) -> Judged:
        """The grid at a ``part`` of the way of every node of some rows from the ``start`` to the ``end``."""
        points = Nodes.of(end.points).like(3)

        def fill(rows: slice) -> None:
            points[rows][:] = start.points[rows] + part(rows) * (end.points[rows] - start.points[rows])

        Nodes.of(points).each(fill)
        self.basis.back_to_surfaces(points)
        return self._judged(points)

    def _undone(self, start: Judged, end: Judged) -> Judged:
        """The grid ``end`` near cells that are invalid in it or at the ``start``, and the ``start`` far from them."""
        cells = np.union1d(start.verdict.invalid, end.verdict.invalid)

        def undone(layers: int) -> Judged:
            far = Nodes.of(self.basis.near(cells, 2 * layers)).rows
            return self._blended(start, end, lambda rows: np.clip(2.0 - far[rows] / layers, 0.0, 1.0)[:, None])

        return next((found for found in map(undone, LAYERS[2:]) if found.count <= end.count), end)

    def _moved(self, now: Judged, plot: Plot, shift: FloatArray) -> Judged:
        points: FloatArray = Nodes.of(now.points).like(3)
        Nodes.of(points).each(lambda rows: np.copyto(points[rows], now.points[rows]))
        own = slice(*np.searchsorted(plot.moved, Nodes.of(points).ends).tolist())
        Nodes.of(points).rows[plot.moved[own]] += shift[own]
        return self._judged(points)

    def _judged(self, points: FloatArray) -> Judged:
        return Judged(points, judge(self.basis.original, self.rounded(points)))
