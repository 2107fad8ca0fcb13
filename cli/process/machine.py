"""Number of threads of the underlying libraries, and the search for garbage while they are imported."""

from __future__ import annotations

import gc
import os

from meshdeform_core.parallel import set_threads

# Environment variables that the linear algebra libraries of numpy and scipy read once, when they are loaded.
_LIBRARIES = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


def use_threads(count: int | None) -> None:
    """Apply ``--threads`` to our loops, and run linear algebra in one thread; to be called before numpy is imported.

    Our loops call it on all threads, mostly with small matrices; threads of its own would wait in busy loops.
    """
    set_threads(count)
    os.environ.update(dict.fromkeys(_LIBRARIES, "1"))


def import_without_collecting() -> None:
    """Look for no garbage until :func:`collect_again`: imports make many objects and hardly any garbage."""
    gc.disable()


def collect_again() -> None:
    """Look for garbage again, but not among what was imported."""
    if not gc.isenabled():
        gc.freeze()
        gc.enable()
