"""The processes that share the work: a single one, of which :class:`.mpi.MPIRanks` makes several."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

T = TypeVar("T")


class Ranks:
    """The ranks that share the work, as one of them sees them; this class is a process by itself.

    Attributes
    ----------
    number, count : index of this rank, from 0, and number of ranks
    on_machine : number of ranks on this machine, including this one
    """

    number, count, on_machine = 0, 1, 1

    def __init__(self, cores: int | None = None):
        self._cores = cores

    @property
    def cores(self) -> int:
        """Number of the machine's cores that this rank may use."""
        return self._cores or usable_cores()

    def gather(self, found: Sequence[T]) -> list[T]:
        """The (small) results of all ranks, in rank order."""
        return list(found)

    def collect(self, own: Any, counts: Sequence[int]) -> Any:
        """The rows of all ranks, ``counts`` of each, concatenated in rank order."""
        return own

    def swap(self, sends: Mapping[int, Any], receives: Mapping[int, Any]) -> None:
        """Exchange arrays with other ranks, by number: send ``sends``, fill ``receives``; empty ones are skipped."""

    def on_first(self, action: Callable[[], T]) -> T:
        """Run ``action`` on the first rank only, with all cores that it may use, while the others wait; its result is
        returned, or its error raised, on all ranks."""
        return action()


def usable_cores() -> int:
    """Number of cores on which the system lets this process run."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
