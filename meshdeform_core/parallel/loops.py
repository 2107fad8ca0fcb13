"""Distribution of loops over the threads of a process, and where large arrays are.

The numba loops release the interpreter lock, so plain threads suffice.
"""

from __future__ import annotations

import math
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar, copy_context
from typing import Any, NamedTuple

from .scratch import Scratch

Work = Callable[[int, int], object]
Counter = Callable[[int, int], object]


def own_cores() -> set[int]:
    """The cores on which the system lets this process run."""
    return os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set(range(os.cpu_count() or 1))


def usable_cores() -> int:
    """Number of cores on which the system lets this process run."""
    return len(own_cores())


class Sharing(NamedTuple):
    """Largest number of threads of loops (``None``: one per core); where large arrays are (``None``: in memory); and
    whether this process works ``apart`` from other ranks, in a loop or for all of them, and must not wait for them."""

    threads: int | None = None
    scratch: Scratch | None = None
    apart: bool = False


# A context variable, not a global one: calls in different threads of a program do not change each other's settings,
# and a block that sets it (such as work that one rank does alone) affects nothing outside.
_DEFAULT = Sharing()
_sharing = ContextVar("sharing", default=_DEFAULT)


def set_sharing(**changes: Any) -> None:
    """Change fields of :class:`Sharing` from now on."""
    _sharing.set(current_sharing()._replace(**changes))


def current_sharing() -> Sharing:
    """How loops of this thread share its work."""
    return _sharing.get()


@contextmanager
def sharing(**changes: Any) -> Iterator[None]:
    """Change fields of :class:`Sharing` within the block."""
    before = _sharing.set(current_sharing()._replace(**changes))
    try:
        yield
    finally:
        _sharing.reset(before)


def empty(shape: Sequence[int], dtype: Any = "float64") -> Any:
    """An uninitialised array, in a file (:mod:`.scratch`) if memory is limited."""
    import numpy as np

    size, scratch = math.prod(shape) * np.dtype(dtype).itemsize, current_sharing().scratch
    return scratch.empty(shape, dtype) if scratch and scratch.takes(size) else np.empty(shape, dtype)


def thread_count() -> int:
    """Number of threads that loops use."""
    usable = usable_cores()
    return max(1, min(current_sharing().threads or usable, usable))


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
    scratch = current_sharing().scratch

    def run(report: Counter | None) -> None:
        ends = None
        try:
            while not failures and (ends := next(pending, None)):
                work(*ends)
                if scratch:
                    scratch.look()
                done.append(ends[1] - ends[0])
                if report:
                    report(sum(done), size)
        except BaseException as error:
            # An interrupt or an error ends the run; chunks not yet started are skipped.
            failures.append((ends[0] if ends and isinstance(error, Exception) else -1, error))

    others = list[threading.Thread]()
    with sharing(apart=True):
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
        with sharing(threads=1):
            work(number)

    for_chunks(one, count, 1, threads=threads)
