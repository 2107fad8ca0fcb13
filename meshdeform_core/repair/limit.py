"""Limits on the time and the work of the repairs and attempts of a motion."""

from __future__ import annotations

import time as clock

from ..parallel import agreed

_PER_NODE, _FEWEST = 600.0, 35_000
"""Work allowed per node (60 s per 100,000 nodes), and the smallest number of nodes used for it."""
_OF_VALID = 45.0
"""Work allowed per node for the repair of a valid grid: 12 times what the default method takes to be prepared and to
move a node, 3.5 to 4 microseconds (studies/repairs.py)."""


class Limit:
    """Wall-clock time, in seconds from its creation, and work.

    Work is counted, not measured, so that results depend on neither the machine nor its load. Its unit is about a
    microsecond of one core. What is spent within a limit made by :meth:`for_valid` is also spent of this one.
    """

    def __init__(self, seconds: float = float("inf"), work: float = float("inf"), whole: Limit | None = None):
        self.seconds = seconds
        self._end, self._left, self._whole = clock.monotonic() + seconds, work, whole

    @classmethod
    def of(cls, n_nodes: int, seconds: float) -> Limit:
        """The limit for a motion of a grid."""
        return cls(seconds, _PER_NODE * max(n_nodes, _FEWEST))

    def for_valid(self, n_nodes: int) -> Limit:
        """The limit for one repair of a valid grid."""
        return Limit(work=min(self._left, _OF_VALID * max(n_nodes, _FEWEST)), whole=self)

    @property
    def left(self) -> float:
        """Work that may still be done."""
        return self._left

    def spend(self, work: float) -> None:
        """Count work done."""
        self._left -= work
        if self._whole:
            self._whole.spend(work)

    def affords(self, work: float) -> int:
        """How often this work may still be done, at least 1."""
        return max(1, int(min(self._left / work, 1e9)))

    @property
    def exhausted(self) -> bool:
        """Whether all work is spent on some rank; a collective call with the same answer on all."""
        return agreed(-self._left) >= 0.0

    @property
    def late(self) -> bool:
        """Whether the time is over on some rank; a collective call with the same answer on all."""
        return agreed(clock.monotonic() - self._end) >= 0.0 or bool(self._whole and self._whole.late)

    @property
    def reached(self) -> bool:
        """Whether the work is spent or the time is over; a collective call."""
        return self.exhausted or self.late
