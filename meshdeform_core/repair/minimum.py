"""The minimum of the energy over all nodes that may move."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from ..grid import FloatArray, IntArray
from .basis import Whole
from .energy.onset import share_of
from .energy.untangle import CLOSE, Pace, Untangler
from .limit import Limit
from .tuned import POLISHED

# A regularisation that starts large and falls slowly finds valid grids where a fast one fails.
QUICK, PATIENT = Pace(60, 2.0, 0.2, around=40), Pace(200, 50.0, 0.1)
# Where no valid grid exists, most of the cells that can become valid do so early.
HASTY = Pace(30, 2.0, 0.3)
_CONVERGING = 60
# A region of n nodes takes at most _WORK / n Newton steps, so that time is bounded on large grids.
_WORK, _FEWEST = 20_000_000, 6

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Search:
    """Result of a search.

    Block nodes ``moved`` (k,) and their ``shift`` (k, 3). ``succeeded``: the minimum was reached or, in a region, no
    sample remains inverted. ``before`` and ``after``: the largest f, infinite if a sample was inverted. ``untangled``:
    the shift at which no sample was inverted any more, if the minimum was not reached from there.
    """

    moved: IntArray
    shift: FloatArray
    succeeded: bool
    steps: int
    before: float = 0.0
    after: float = 0.0
    untangled: FloatArray | None = None


def most_steps(n_unknowns: int) -> int:
    """Largest number of Newton steps for a region."""
    return max(_FEWEST, _WORK // n_unknowns)


def minimise(
    whole: Whole,
    points: FloatArray,
    polish: bool,
    guess: FloatArray | None,
    progress: Progress | None,
    limit: Limit,
    close: float = CLOSE,
) -> Search | None:
    """Search for the minimum from the method's ``points`` (n_nodes, 3), moved by a ``guess``; ``None`` if no cell is
    weak.

    ``polish``: the energy always has its full share, and cells at walls have little more weight than others.
    ``close``: the distance from the minimum at which the search ends, see :mod:`.energy.untangle`.
    """
    plot = whole.plot
    reference = plot.inside(points)
    share, energy = share_of(plot.region.energy, reference, plot.region.dealt)
    if polish:
        share, energy = max(share, 1.0), energy.softened(POLISHED)
    if share == 0.0:
        return None
    region = replace(plot.region, energy=energy)
    start = reference if guess is None else reference + plot.inside(guess)
    untangler = Untangler(region, start, reference, whole.system, progress=progress, limit=limit)
    most = most_steps(region.dealt.rows.total)
    untangled = untangler.untangle(replace(QUICK, steps=min(QUICK.steps, most)))
    first = plot.shift(untangler.x - reference) if untangled else None
    converged = untangled and untangler.minimise(share, min(_CONVERGING, most), whole.edges, close)
    shift = plot.shift(untangler.x - reference)
    return Search(plot.moved, shift, converged, untangler.steps, untangled=None if converged else first)
