"""Distribution of loops over the threads of a process, and the processes that share the work.

The numba loops release the interpreter lock, so plain threads suffice within a process. MPI ranks run the same program,
each on its part of a grid (:mod:`.nodes`); no loop is shared by ranks.
"""

from __future__ import annotations

import math
import os
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar, copy_context
from typing import Any, NamedTuple, TypeVar

from .scratch import Scratch

T = TypeVar("T")
Work = Callable[[int, int], object]
Counter = Callable[[int, int], object]


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

    def share(self, count: int) -> slice:
        """Rows of this rank where ``count`` rows are divided evenly: those of rank r begin at int(count r / ranks)."""
        return slice(count * self.number // self.count, count * (self.number + 1) // self.count)

    def collect(self, own: Any, counts: Sequence[int] | None = None) -> Any:
        """The rows of all ranks, ``counts`` of each if that is known, concatenated in rank order."""
        return own

    def swap(self, sends: Mapping[int, Any], receives: Mapping[int, Any]) -> None:
        """Exchange arrays with other ranks, by number: send ``sends``, fill ``receives``; empty ones are skipped."""

    def on_first(self, action: Callable[[], T]) -> T:
        """Run ``action`` on the first rank only, with all cores that it may use, while the others wait; its result is
        returned, or its error raised, on all ranks."""
        return action()


def own_cores() -> set[int]:
    """The cores on which the system lets this process run."""
    return os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set(range(os.cpu_count() or 1))


def usable_cores() -> int:
    """Number of cores on which the system lets this process run."""
    return len(own_cores())


class Sharing(NamedTuple):
    """Who shares the work: MPI ranks, which hold a part each of every grid that is read (:mod:`.nodes`), and the
    largest number of threads on each (``None``: one per core); and where large arrays are (``None``: in memory)."""

    ranks: Ranks
    threads: int | None
    scratch: Scratch | None = None


# A context variable, not a global one: calls in different threads of a program do not change each other's settings,
# and a block that sets it (such as work that one rank does alone) affects nothing outside.
_ONE_PROCESS = Sharing(Ranks(), None)
_sharing = ContextVar("sharing", default=_ONE_PROCESS)


def set_sharing(**changes: Any) -> None:
    """Change fields of :class:`Sharing` from now on; ranks that share the work must make the same calls in the same
    order."""
    _sharing.set(_sharing.get()._replace(**changes))


def current_ranks() -> Ranks:
    """The processes that share the work: those among which a grid is divided when it is read."""
    return _sharing.get().ranks


def current_scratch() -> Scratch | None:
    """The storage of large arrays; ``None``: memory."""
    return _sharing.get().scratch


@contextmanager
def sharing(ranks: Ranks, threads: int | None) -> Iterator[None]:
    """Share the work with these ranks, with this number of threads, within the block."""
    before = _sharing.set(_sharing.get()._replace(ranks=ranks, threads=threads))
    try:
        yield
    finally:
        _sharing.reset(before)


def alone(cores: int | None = None, times: int = 1) -> AbstractContextManager[None]:
    """Share nothing within the block: for work that one rank does alone, by default on its share of the cores, with
    ``times`` as many threads."""
    ranks, threads, _ = _sharing.get()
    if ranks.count == 1 and cores is None and times == 1:
        return nullcontext()
    return sharing(Ranks(cores or ranks.cores), threads and times * threads)


def agreed(ranks: Ranks, value: float) -> float:
    """The largest of the values of all ranks; collective, for decisions that must be the same on all ranks even if
    their processors round differently."""
    import numpy as np

    return float(np.max(ranks.gather([value])))


def empty(shape: Sequence[int], dtype: Any = "float64") -> Any:
    """An uninitialised array, in a file (:mod:`.scratch`) if memory is limited."""
    import numpy as np

    size, scratch = math.prod(shape) * np.dtype(dtype).itemsize, current_scratch()
    return scratch.empty(shape, dtype) if scratch and scratch.takes(size) else np.empty(shape, dtype)


def thread_count() -> int:
    """Number of threads that loops use."""
    ranks, threads, _ = _sharing.get()
    return max(1, min(threads or ranks.cores, usable_cores()))


def for_chunks(work: Work, size: int, chunk: int, progress: Counter | None = None, threads: int | None = None) -> None:
    """Call ``work(first, last)`` for consecutive chunks of ``range(size)``; each thread takes the next when it is free.

    ``work`` releases the interpreter lock and touches only its own part of the result; asking for rows of other ranks
    is an error, as these are not in the loop. ``chunk`` is small enough that the threads, at most ``threads``, finish
    together; ``progress`` is called with (items done, number of items) as chunks finish. Of several exceptions, that of
    the first chunk is raised.
    """
    bounds = [(first, min(first + chunk, size)) for first in range(0, size, chunk)]
    # ``next`` on an iterator and ``list.append`` are atomic in the interpreter.
    pending, done, failures = iter(bounds), list[int](), list[tuple[int, BaseException]]()
    scratch = current_scratch()

    def run(report: Counter | None) -> None:
        told, items, ends = 0, 0, None
        try:
            while not failures and (ends := next(pending, None)):
                work(*ends)
                if scratch:
                    scratch.look()
                done.append(ends[1] - ends[0])
                if report:
                    new = done[told:]
                    told, items = told + len(new), items + sum(new)
                    report(items, size)
        except BaseException as error:
            # An interrupt or an error ends the run; chunks not yet started are skipped.
            failures.append((ends[0] if ends and isinstance(error, Exception) else -1, error))

    others = list[threading.Thread]()
    with alone():
        try:
            for _ in range(min(threads or thread_count(), len(bounds)) - 1 if len(bounds) > 1 else 0):
                others.append(threading.Thread(target=copy_context().run, args=(run, None), name="chunks"))
                others[-1].start()
        except BaseException as error:
            # Raised by a signal handler: threads already started end after their chunk.
            failures.append((-1, error))
        run(progress)
        # Even after an interrupt, as they still write to arrays of the caller.
        for other in others:
            while other.is_alive():
                try:
                    other.join()
                except BaseException as error:
                    failures.append((-1, error))
    if failures:
        raise min(failures, key=lambda each: each[0])[1]
    if others and progress:
        progress(size, size)


def for_items(work: Callable[[int], object], count: int, threads: int | None = None) -> None:
    """Call ``work(n)`` for every n of ``range(count)``, by default on all threads, with its own loops on one thread."""

    def one(number: int, _: int) -> None:
        with sharing(Ranks(1), 1):
            work(number)

    for_chunks(one, count, 1, threads=threads)
