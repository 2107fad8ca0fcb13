"""Chunks of work for the threads of one process and, where several processes share a case, for all of them.

The numba loops release the interpreter lock, so plain threads suffice within a process. Processes (ranks, in MPI's
terms) all hold the same data and run the same program; loops that say which rows of which arrays they fill are dealt
out among the ranks, and the rows are exchanged afterwards, so that every rank goes on with the same data.
"""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from typing import Any, NamedTuple, Protocol, TypeVar

T = TypeVar("T")


class Ranks(Protocol):
    """The processes that share the work, seen from one of them.

    Attributes
    ----------
    number, count : which of how many it is, from 0
    on_machine : how many of them are on its machine, itself included
    """

    number: int
    count: int
    on_machine: int

    @property
    def cores(self) -> int:
        """Its share of the cores of its machine."""
        ...

    def share(self, array: Any, rows: Sequence[Sequence[Any]]) -> None:
        """Complete ``array`` in place on every rank; ``rows[r]`` are the rows that rank r filled: index arrays."""
        ...

    def on_first(self, action: Callable[[], T]) -> T:
        """Do something, like writing a file, on the first rank only; all get its result, or raise its error."""
        ...


class OneRank:
    """A process on its own."""

    number, count, on_machine = 0, 1, 1

    @property
    def cores(self) -> int:
        return usable_cores()

    def share(self, array: Any, rows: Sequence[Sequence[Any]]) -> None:
        """Nothing is missing."""

    def on_first(self, action: Callable[[], T]) -> T:
        return action()


class Shared(NamedTuple):
    """What a loop fills: ``rows(first, last)``, an index array, are the rows of ``array`` that these items write."""

    array: Any
    rows: Callable[[int, int], Any] = range


_limit: int | None = None
_ranks: Ranks = OneRank()


def set_threads(count: int | None) -> None:
    """Use at most ``count`` threads from now on; ``None`` for as many as are this process's share."""
    global _limit
    _limit = count


def set_ranks(ranks: Ranks) -> None:
    """Share the work with other processes from now on; all of them must call everything in the same order."""
    global _ranks
    _ranks = ranks


def current_ranks() -> Ranks:
    """The processes that share the work."""
    return _ranks


def thread_count() -> int:
    """Threads that loops are spread over."""
    return max(1, min(_limit or _ranks.cores, usable_cores()))


def usable_cores() -> int:
    """Cores on which the system lets this process run."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def for_chunks(work, size, chunk, progress=None, shared: Sequence[Shared] | None = None):
    """Call ``work(first, last)`` for consecutive chunks of ``range(size)``, spread over the threads.

    Parameters
    ----------
    work : function that releases the interpreter lock and touches only its own part of the result
    chunk : items per call; small enough that the threads finish together
    progress : called with (items done, items in all) as chunks finish
    shared : everything that ``work`` fills and all ranks need. The chunks are then dealt out among the ranks like
        cards, because neighbours cost alike, the same cards whenever size and chunk are the same; without it every
        rank does all of them. Chunks do not depend on the number of ranks
    """
    bounds = [(first, min(first + chunk, size)) for first in range(0, size, chunk)]
    ranks = OneRank() if shared is None else _ranks
    _on_threads(work, bounds[ranks.number :: ranks.count], progress)
    if ranks.count > 1:
        dealt = [bounds[number :: ranks.count] for number in range(ranks.count)]
        for array, rows in shared or ():
            ranks.share(array, [[rows(*ends) for ends in own] for own in dealt])


def _on_threads(work, bounds, progress):
    size = sum(last - first for first, last in bounds)
    threads = min(thread_count(), len(bounds))
    done = 0
    if threads <= 1:
        for first, last in bounds:
            work(first, last)
            done += last - first
            if progress:
                progress(done, size)
        return
    with ThreadPoolExecutor(threads) as pool:
        pending = {pool.submit(work, first, last): last - first for first, last in bounds}
        try:
            for future in as_completed(pending):
                future.result()
                done += pending[future]
                if progress:
                    progress(done, size)
        except BaseException:
            # An interrupt or an error ends the run: chunks that have not started need not run.
            pool.shutdown(wait=True, cancel_futures=True)
            raise
