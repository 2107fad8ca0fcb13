"""Chunks of work for a pool of threads. The numba loops release the interpreter lock, so plain threads suffice."""

import os
from concurrent.futures import ThreadPoolExecutor, as_completed

_limit: int | None = None


def set_threads(count: int | None) -> None:
    """Use at most ``count`` threads from now on; ``None`` for as many as this process may use."""
    global _limit
    _limit = count


def thread_count() -> int:
    """Threads that loops are spread over."""
    available = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, min(_limit or available, available))


def for_chunks(work, size, chunk, progress=None):
    """Call ``work(first, last)`` for consecutive chunks of ``range(size)``, spread over the threads.

    Parameters
    ----------
    work : function that releases the interpreter lock and touches only its own part of the result
    chunk : items per call; small enough that the threads finish together
    progress : called with (items done, size) as chunks finish
    """
    bounds = [(first, min(first + chunk, size)) for first in range(0, size, chunk)]
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
