"""Number of threads of the underlying libraries."""

from __future__ import annotations

import os

from meshdeform_core.parallel import set_threads

# Environment variables that the linear algebra libraries of numpy and scipy read once, when they are loaded.
_LIBRARIES = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


def use_threads(count: int | None) -> None:
    """Apply ``--threads`` to our loops, and run linear algebra in one thread; to be called before numpy is imported.

    Our loops call it from all threads, mostly with small matrices; additional threads of the libraries would busy-wait.
    """
    set_threads(count)
    os.environ.update(dict.fromkeys(_LIBRARIES, "1"))
