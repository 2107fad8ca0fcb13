"""What this machine has and what this process took of it."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from meshdeform_core.memory import MemoryLimit
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


def machine_memory() -> MemoryLimit:
    """Memory that can be taken without swapping, as far as the system tells; of several ranks each has its share.

    The smallest share counts, on all ranks: what fits decides what they do, and they must do the same.
    """
    ranks = current_ranks()
    source = "the machine has" if ranks.on_machine == 1 else f"each of {ranks.on_machine} ranks on the machine has"
    return MemoryLimit(min(ranks.gather([_available_memory() // ranks.on_machine])), source)


def _available_memory() -> int:
    available = _first_number(Path("/proc/meminfo"), "MemAvailable:")
    try:
        return available * 1024 if available is not None else os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, AttributeError):
        return 2**62


def peak_memory() -> int:
    """Largest resident size of this process so far, bytes; 0 where the system does not tell."""
    # Linux counts the size of the parent at the start of a process into ru_maxrss, but not into VmHWM.
    status = _first_number(Path("/proc/self/status"), "VmHWM:")
    if status is not None:
        return status * 1024
    try:
        import resource
    except ImportError:
        return 0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024


def _first_number(path: Path, key: str) -> int | None:
    """The number (KiB) behind ``key`` in a file of the system; ``None`` where there is no such file or key."""
    try:
        lines = path.read_text(encoding="ascii", errors="replace").splitlines()
    except OSError:
        return None
    return next((int(line.split()[1]) for line in lines if line.startswith(key)), None)
