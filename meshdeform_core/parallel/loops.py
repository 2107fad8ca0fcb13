"""Chunks of work for the threads of one process and, where several processes share a case, for all of them.

The numba loops release the interpreter lock, so plain threads suffice within a process. Processes (ranks, in MPI's
terms) run the same program on the same data; loops that say what they fill are dealt out among the ranks, and what
they filled is exchanged afterwards, so that every rank goes on with the same data.

Large arrays made by :func:`empty` exist once per machine: its ranks have their memory in common. Three rules keep the
ranks from seeing each other's unfinished work:

1. Only loops that name the array (``shared`` or ``common`` of :func:`for_chunks`) and :meth:`Ranks.alter` write to it.
   What all ranks run alike must not, however harmless: ``+=`` would count P times.
2. Of the rows that such a loop fills, a chunk reads only its own; the others are read before the loop or after it.
3. Before the first write and after the last one the ranks of the machine wait for each other. So nobody reads what is
   not finished, and nobody overwrites what another one, still in the code before the loop, reads.

Memory is given back when the last rank drops the array; ranks need not do that together.
"""

import math
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from typing import Any, NamedTuple, Protocol, TypeVar

T = TypeVar("T")
Work = Callable[[int, int], object]
Counter = Callable[[int, int], object]
Bounds = tuple[int, int]

# Smaller arrays are not worth the meeting of all ranks that common memory takes.
_SMALL = 1 << 20
# Rows of coordinates that stay in the cache of a core.
_ROWS = 1 << 14


class Ranks(Protocol):
    """The processes that share the work, seen from one of them.

    Attributes
    ----------
    number, count : which of how many it is, from 0
    on_machine : how many of them are on its machine, itself included
    private : why the ranks of a machine have no memory in common; empty if they have, or if there is only one
    """

    number: int
    count: int
    on_machine: int
    private: str

    @property
    def cores(self) -> int:
        """Its share of the cores of its machine."""
        ...

    def empty(self, shape: Sequence[int], dtype: Any) -> Any:
        """An uninitialised array, in memory that the ranks of the machine have in common if they can."""
        ...

    def seat(self, arrays: Sequence[Any]) -> tuple[int, int]:
        """Which of how many ranks it is that can fill ``arrays`` together without sending anything."""
        ...

    def begin(self, arrays: Sequence[Any]) -> None:
        """Wait until no rank of the machine reads any more what ``arrays`` hold in common memory."""
        ...

    def share(self, array: Any, rows: Callable[[int], Sequence[Any]]) -> None:
        """Complete ``array`` in place; ``rows(r)`` are the rows that rank r filled: index arrays."""
        ...

    def finish(self, arrays: Sequence[Any]) -> None:
        """Wait until what the ranks of the machine wrote to ``arrays`` in common memory is complete."""
        ...

    def alter(self, array: Any, action: Callable[[], object]) -> None:
        """Let ``action``, the same on all ranks, write to ``array``: once for each copy of it."""
        ...

    def once(self, make: Callable[[], T]) -> T:
        """What all ranks would make alike: made once per machine where memory is common; not to be written to."""
        ...

    def gather(self, found: Sequence[T]) -> list[T]:
        """What all ranks have found, in their order: little things."""
        ...

    def on_first(self, action: Callable[[], T]) -> T:
        """Do something, like writing a file, on the first rank only; all get its result, or raise its error."""
        ...


class OneRank:
    """A process on its own; ``cores`` if it shall not use all that it may run on."""

    number, count, on_machine, private = 0, 1, 1, ""

    def __init__(self, cores: int | None = None):
        self._cores = cores

    @property
    def cores(self) -> int:
        return self._cores or usable_cores()

    def empty(self, shape: Sequence[int], dtype: Any) -> Any:
        # Imported late: how many threads linear algebra takes is settled before numpy is loaded.
        import numpy as np

        return np.empty(shape, dtype)

    def seat(self, arrays: Sequence[Any]) -> tuple[int, int]:
        return 0, 1

    def begin(self, arrays: Sequence[Any]) -> None:
        """Nobody else reads."""

    def share(self, array: Any, rows: Callable[[int], Sequence[Any]]) -> None:
        """Nothing is missing."""

    def finish(self, arrays: Sequence[Any]) -> None:
        """Nobody else writes."""

    def alter(self, array: Any, action: Callable[[], object]) -> None:
        action()

    def once(self, make: Callable[[], T]) -> T:
        return make()

    def gather(self, found: Sequence[T]) -> list[T]:
        return list(found)

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


@contextmanager
def sharing(ranks: Ranks, threads: int | None) -> Iterator[None]:
    """Share the work with these ranks, on so many threads, while this lasts."""
    before = _ranks, _limit
    set_ranks(ranks)
    set_threads(threads)
    try:
        yield
    finally:
        set_ranks(before[0])
        set_threads(before[1])


def alone() -> AbstractContextManager[None]:
    """Share nothing while this lasts: for what a rank does by itself."""
    return sharing(OneRank(_ranks.cores), _limit)


def empty(shape: Sequence[int], dtype: Any = "float64") -> Any:
    """An uninitialised array; if it is large, one for all ranks of a machine, with the rules of this module.

    All ranks must call it, with the same shape.
    """
    import numpy as np

    large = math.prod(shape) * np.dtype(dtype).itemsize >= _SMALL
    return (_ranks if large else OneRank()).empty(shape, dtype)


def thread_count() -> int:
    """Threads that loops are spread over."""
    return max(1, min(_limit or _ranks.cores, usable_cores()))


def usable_cores() -> int:
    """Cores on which the system lets this process run."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def for_chunks(
    work: Work,
    size: int,
    chunk: int,
    progress: Counter | None = None,
    shared: Sequence[Shared] | None = None,
    common: Sequence[Any] = (),
    threads: int | None = None,
) -> None:
    """Call ``work(first, last)`` for consecutive chunks of ``range(size)``, spread over the threads.

    Chunks do not depend on the number of ranks. They are dealt out like cards, because neighbours cost alike, the same
    cards whenever size and chunk are the same. Without ``shared`` and ``common`` every rank does all of them.

    Parameters
    ----------
    work : function that releases the interpreter lock and touches only its own part of the result
    chunk : items per call; small enough that the threads finish together
    progress : called with (items done, items in all) as chunks finish
    shared : everything that ``work`` fills and all ranks need: dealt out among all ranks, the rows are exchanged
    common : the same where computing costs less than sending: dealt out only among the ranks that have all of these
        arrays in common memory
    threads : at most so many, for work that must not run at the same time
    """
    bounds = [(first, min(first + chunk, size)) for first in range(0, size, chunk)]
    filled = [*(array for array, _ in shared or ()), *common]
    number, count = _ranks.seat(common) if shared is None else (_ranks.number, _ranks.count)
    _ranks.begin(filled)
    _on_threads(work, bounds[number::count], progress, threads or thread_count())
    for array, rows in shared or ():
        _ranks.share(array, partial(_rows_of, rows, bounds, count))
    _ranks.finish(filled)


def _rows_of(rows: Callable[[int, int], Any], bounds: list[Bounds], count: int, rank: int) -> list[Any]:
    return [rows(*ends) for ends in bounds[rank::count]]


def for_items(
    work: Callable[[int], object], count: int, shared: Sequence[Shared], progress: Counter | None = None
) -> None:
    """Call ``work(n)`` for every n of ``range(count)``, ascending and one at a time, dealt out among all ranks.

    For large items that use the threads themselves, or none. ``shared`` as for :func:`for_chunks`. What ``work`` raises
    on one rank ends its items and is raised on all of them.
    """
    failures: list[tuple[int, Exception]] = []

    def attempt(number: int, _: int) -> None:
        try:
            if not failures:
                work(number)
        except Exception as error:
            failures.append((number, error))

    for_chunks(attempt, count, 1, progress, shared, threads=1)
    if found := _ranks.gather(failures):
        # The one that a process on its own would have met.
        raise min(found, key=lambda each: each[0])[1]


def for_rows(fill: Callable[[slice], object], array: Any) -> None:
    """Let ``fill(rows)`` fill slices of ``array`` (n, ...): for what costs less to compute than to send."""
    for_chunks(lambda first, last: fill(slice(first, last)), len(array), _ROWS, common=[array])


def _on_threads(work: Work, bounds: list[Bounds], progress: Counter | None, limit: int) -> None:
    size = sum(last - first for first, last in bounds)
    threads = min(limit, len(bounds))
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
