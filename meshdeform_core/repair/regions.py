"""Untangling in regions around invalid cells, where the minimum over all nodes is out of reach."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ..parallel import of_all, together
from .basis import Basis
from .energy.elements import Penalty
from .energy.newton import NewtonSystem
from .energy.onset import share_of
from .energy.untangle import Pace, Untangler
from .limit import Limit
from .minimum import HASTY, PATIENT, QUICK, Progress, Search, most_steps
from .neighbourhood import Plot
from .outcome import Judged

WEAK = 0.35
"""Cells with a corner below this fraction of its undeformed Jacobian are the centres of regions."""
_LAYERS: dict[int, tuple[int | None, ...]] = {2: (32, None), 3: (8, 32, None)}
_IMPROVING = 20
_ROUNDS, _LAST_ROUNDS = 2, 6
# More layers are tried while the largest f exceeds _ENOUGH; in valid grids only if the first layers reduced it to less
# than _GAIN of its value.
_ENOUGH, _GAIN = 2.9, 0.9


class Way(NamedTuple):
    """A strategy of untangling: ``patient`` or quick; ``even``: without larger weights near walls; ``hasty``: only
    around weak cells, without subsequent improvement."""

    patient: bool = False
    even: bool = False
    hasty: bool = False

    @property
    def pace(self) -> Pace:
        """The effort spent on each search."""
        return PATIENT if self.patient else HASTY if self.hasty else QUICK


QUICKLY, PATIENTLY, HASTILY = (Way(),), (Way(patient=True), Way(patient=True, even=True)), (Way(hasty=True),)
EVERY_WAY = QUICKLY + PATIENTLY


@dataclass(frozen=True)
class Growth:
    """Untangling in regions that grow until all cells are sound; ``moved`` returns the grid after a search."""

    basis: Basis
    moved: Callable[[Judged, Search], Judged]
    progress: Progress | None
    limit: Limit

    def best(self, start: Judged, weak: float, way: Way) -> tuple[Judged, int]:
        """The best grid, and the Newton steps taken; regions surround cells with a relative Jacobian below ``weak``.

        First the nodes within a few layers move, then more, until the worst cell is close enough to its undeformed
        shape or more nodes do not help; a patient strategy moves all nodes at once.
        """
        stages = _LAYERS[self.basis.original.grid.dimension][-1 if way.patient else 0 : 1 if way.hasty else None]
        best = now = start
        steps, density, done = 0, np.inf, 0
        for layers in stages:
            if self.limit.reached:
                break
            now, found, taken = self._stage(now, layers, weak, way, done)
            steps += taken
            if found is None or (start.verdict.valid and found.after > _GAIN * found.before):
                # No further nodes to move, or the weak cells cannot be improved.
                break
            if now.count < best.count or (now.count == best.count and found.after < density):
                best, density = now, found.after
            if now.verdict.valid and density < _ENOUGH:
                break
            done = sum(of_all(now.points, len(found.moved))) if now.verdict.valid else 0
        return best, steps

    def _stage(
        self, now: Judged, layers: int | None, weak: float, way: Way, done: int
    ) -> tuple[Judged, Search | None, int]:
        """Search with a given number of layers: the grid, the last search, and the Newton steps taken."""
        steps, found = 0, None
        for _ in range(_ROUNDS if layers else _LAST_ROUNDS):
            other = self._search(now, layers, weak, way, done)
            if other is None:
                break
            found, steps, now = other, steps + other.steps, self.moved(now, other)
            helped = _ENOUGH < found.after < _GAIN * found.before
            if not found.succeeded or (now.verdict.valid and (layers or not helped)):
                break
        return now, found, steps

    def _search(self, now: Judged, layers: int | None, limit: float, way: Way, done: int) -> Search | None:
        """Move the nodes within ``layers`` layers of weak cells; ``None`` if there are none, or no more than the number
        ``done`` before."""
        weak = now.verdict.weak(limit)

        def make() -> Search | None:
            neighbourhood = self.basis.neighbourhood
            share = neighbourhood.around(weak, layers) if layers else neighbourhood.shares.share()
            if share.total in (0, done):
                return None
            return self._untangle(neighbourhood.plot(share, way.even), now, way)

        return together(now.points, make)

    def _untangle(self, plot: Plot, now: Judged, way: Way) -> Search:
        start, region = plot.inside(now.points), plot.region
        share, energy = share_of(region.energy, start, region.dealt)
        region = replace(region, energy=energy)
        untangler = Untangler(region, start, start, NewtonSystem(region), progress=self.progress, limit=self.limit)
        before = untangler.state(start, Penalty()).highest
        most = most_steps(region.dealt.rows.total)
        untangled = untangler.untangle(replace(way.pace, steps=min(way.pace.steps, most)))
        if untangled and not way.hasty:
            untangler.minimise(max(share, 1.0), min(_IMPROVING, most), region.energy.edges())
        after = untangler.state(untangler.x, Penalty()).highest
        return Search(plot.moved, plot.shift(untangler.x - start), untangled, untangler.steps, before, after)
