"""Number of threads of the underlying libraries, and the search for garbage while they are imported."""

from __future__ import annotations

import gc
import os

from meshdeform_core.parallel import current_ranks, set_threads, thread_count

# Environment variables that the linear algebra libraries of numpy and scipy read once, when they are loaded.
_LIBRARIES = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


def use_threads(count: int | None) -> None:
    """Apply ``--threads`` to our loops and to linear algebra; to be called before numpy is imported."""
    set_threads(count)
    if count is not None or current_ranks().count > 1:
        os.environ.update(dict.fromkeys(_LIBRARIES, str(thread_count())))


def use_one_library_thread() -> None:
    """Run linear algebra in one thread: others would wait in busy loops and consume CPU time.

    To be called before numpy is imported.
    """
    os.environ.update(dict.fromkeys(_LIBRARIES, "1"))


def import_without_collecting() -> None:
    """Look for no garbage until :func:`collect_again`: imports make many objects and hardly any garbage."""
    gc.disable()


def collect_again() -> None:
    """Look for garbage again, but not among what was imported."""
    if not gc.isenabled():
        gc.freeze()
        gc.enable()
