"""A limit on the time that repairs and attempts take."""

from __future__ import annotations

import time as clock

from ..parallel import current_ranks


class TimeLimit:
    """Wall-clock time, in seconds from its creation."""

    def __init__(self, seconds: float = float("inf")):
        self.seconds = seconds
        self._end = clock.monotonic() + seconds

    @property
    def reached(self) -> bool:
        """Whether the time is over, the same on all ranks: all of them must ask."""
        return current_ranks().on_first(lambda: clock.monotonic() >= self._end)

    def over(self) -> bool:
        """Whether the time is over; never where several ranks compute the same, which are not equally fast."""
        return current_ranks().count == 1 and clock.monotonic() >= self._end
