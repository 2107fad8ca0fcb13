"""How many threads the libraries beneath may take."""

from __future__ import annotations

import os

from meshdeform_core.parallel import current_ranks, set_threads, thread_count

# How the linear algebra libraries that numpy and scipy come with are told, once, when they are loaded.
_LIBRARIES = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


def use_threads(count: int | None) -> None:
    """Honour ``--threads``, in our loops and in linear algebra; to be called before numpy is imported."""
    set_threads(count)
    if count is not None or current_ranks().count > 1:
        os.environ.update(dict.fromkeys(_LIBRARIES, str(thread_count())))


def use_one_library_thread() -> None:
    """Linear algebra in one thread: others that wait in a busy loop would count as CPU time.

    To be called before numpy is imported.
    """
    os.environ.update(dict.fromkeys(_LIBRARIES, "1"))
