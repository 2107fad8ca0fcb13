"""Searches of a repair in one process: for the minimum of the energy, or for a grid without inverted cells."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

from ..grid import FloatArray
from .energy import Penalty, Region, share_of
from .limit import Limit
from .options import Effort
from .region import Plot
from .tuned import POLISHED
from .untangle import CLOSE, Pace, Untangler

# A regularisation that starts large and falls slowly finds valid grids where a fast one fails.
QUICK, PATIENT = Pace(60, 2.0, 0.2, around=40), Pace(200, 50.0, 0.1)
# Where no valid grid exists, most of the cells that can become valid do so early.
HASTY = Pace(30, 2.0, 0.3)
_CONVERGING, _IMPROVING = 60, 20
# A region of n nodes takes at most _WORK / n Newton steps, so that time is bounded on large grids.
_WORK, _FEWEST = 20_000_000, 6

Progress = Callable[[str, int, int], None]


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


_PATIENTLY = Way(patient=True), Way(patient=True, even=True)
WAYS: dict[Effort, tuple[Way, ...]] = {
    "hasty": (Way(hasty=True),),
    "quick": (Way(),),
    "patient": _PATIENTLY,
    "all": (Way(), *_PATIENTLY),
}
"""The strategies that are tried in turn."""


@dataclass(frozen=True)
class Search:
    """Result of a search.

    ``shift`` (k, 3) of the nodes that a plot moves. ``succeeded``: the minimum was reached or, in a region, no
    sample remains inverted. ``before`` and ``after``: the largest f, infinite if a sample was inverted. ``untangled``:
    the shift at which no sample was inverted any more, if the minimum was not reached from there.
    """

    shift: FloatArray
    succeeded: bool
    steps: int
    before: float = 0.0
    after: float = 0.0
    untangled: FloatArray | None = None
    share: float = 0.0


@dataclass(frozen=True)
class Searcher:
    """Searches from the method's coordinates ``reference`` (n, d) of the nodes of a plot.

    ``farthest``: no node moves farther than this.
    """

    plot: Plot
    reference: FloatArray
    farthest: float
    progress: Progress | None
    limit: Limit

    def _untangler(self, region: Region, start: FloatArray) -> tuple[Untangler, int]:
        most = max(_FEWEST, _WORK // region.n_unknowns)
        untangler = Untangler(region, start, self.reference, self.plot.system, self.farthest)
        untangler.progress, untangler.limit = self.progress, self.limit
        return untangler, most

    def minimum(self, polish: bool, shift: FloatArray | None, close: float = CLOSE) -> Search | None:
        """The minimum, from coordinates moved by ``shift`` (n, d); ``None`` if no cell is weak.

        ``polish``: the energy always has its full share, and cells at walls have little more weight than others.
        ``close``: the distance from the minimum at which the search ends, see :mod:`.untangle`.
        """
        share, energy = share_of(self.plot.region.energy, self.reference)
        if polish:
            share, energy = max(share, 1.0), energy.softened(POLISHED)
        if share == 0.0:
            return None
        start = self.reference if shift is None else self.reference + shift
        untangler, most = self._untangler(replace(self.plot.region, energy=energy), start)
        untangled = untangler.untangle(replace(QUICK, steps=min(QUICK.steps, most)))
        first = self._shift(untangler) if untangled else None
        converged = untangled and untangler.minimise(share, min(_CONVERGING, most), self.plot.edges, close)
        untangled_at = None if converged else first
        return Search(self._shift(untangler), converged, untangler.steps, untangled=untangled_at, share=share)

    def untangled(self, way: Way) -> Search:
        """A grid without inverted samples, improved unless in haste."""
        share, energy = share_of(self.plot.region.energy, self.reference)
        untangler, most = self._untangler(replace(self.plot.region, energy=energy), self.reference)
        before = untangler.state(self.reference, Penalty()).highest
        done = untangler.untangle(replace(way.pace, steps=min(way.pace.steps, most)))
        if done and not way.hasty:
            untangler.minimise(max(share, 1.0), min(_IMPROVING, most), self.plot.edges)
        after = untangler.state(untangler.x, Penalty()).highest
        return Search(self._shift(untangler), done, untangler.steps, before, after)

    def _shift(self, untangler: Untangler) -> FloatArray:
        return self.plot.shift(untangler.x - self.reference)
