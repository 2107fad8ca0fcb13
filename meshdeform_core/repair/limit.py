"""Limits on the time and the work that the repairs and attempts of a motion take."""

from __future__ import annotations

import time as clock

from ..parallel import current_ranks

_PER_NODE, _FEWEST = 600.0, 35_000
"""Work that a grid is worth, 60 s per 100,000 nodes, and the number of nodes that small grids count as."""


class Limit:
    """Wall-clock time, in seconds from its creation, and work.

    Work is counted, not measured, so that what is done depends on neither the machine nor its load. Its unit is about a
    microsecond of one core.
    """

    def __init__(self, seconds: float = float("inf"), work: float = float("inf")):
        self.seconds = seconds
        self._end, self._left = clock.monotonic() + seconds, work

    @classmethod
    def of(cls, n_nodes: int, seconds: float) -> Limit:
        """The limit for a motion of a grid."""
        return cls(seconds, _PER_NODE * max(n_nodes, _FEWEST))

    def spend(self, work: float) -> None:
        """Count work that was done."""
        self._left -= work

    def affords(self, work: float) -> int:
        """How many pieces of such work may still be done, but at least one."""
        return max(1, int(min(self._left / work, 1e9)))

    @property
    def exhausted(self) -> bool:
        """Whether all work is spent, the same on all ranks: all of them must ask."""
        return current_ranks().on_first(lambda: self._left <= 0.0)

    @property
    def late(self) -> bool:
        """Whether the time is over, the same on all ranks: all of them must ask."""
        return current_ranks().on_first(lambda: clock.monotonic() >= self._end)

    @property
    def reached(self) -> bool:
        """Whether either is."""
        return self.exhausted or self.late

    def over(self) -> bool:
        """The same for one rank; the time is never over where several ranks compute the same, which are not equally
        fast."""
        return self._left <= 0.0 or (current_ranks().count == 1 and clock.monotonic() >= self._end)
