"""Several processes on one case, started by ``mpiexec``; mpi4py is imported only then."""

from __future__ import annotations

import contextlib
import ctypes
import io
import os
from collections.abc import Callable
from dataclasses import dataclass

from meshdeform_core.parallel import set_ranks

from ..exit_codes import EXIT_INPUT, EXIT_INVALID
from .messages import tell

# Environment variables in which launchers pass a process its rank and the number of ranks.
_LAUNCHERS = (
    ("OMPI_COMM_WORLD_RANK", "OMPI_COMM_WORLD_SIZE"),  # Open MPI
    ("PMI_RANK", "PMI_SIZE"),  # MPICH, Intel MPI, Microsoft MPI
    ("PMIX_RANK", "SLURM_STEP_NUM_TASKS"),  # srun --mpi=pmix
)
# M_MMAP_THRESHOLD of mallopt(3), which only the GNU C library has.
_MMAP_THRESHOLD = -3


@dataclass(frozen=True)
class Place:
    """Rank of this process and number of ranks."""

    number: int
    count: int


def place() -> Place | None:
    """Rank of this process according to the launcher; ``None`` for a single process."""
    for names in _LAUNCHERS:
        texts = [os.environ.get(name, "") for name in names]
        if all(text.isdigit() for text in texts) and int(texts[1]) > 1:
            return Place(*(int(text) for text in texts))
    return None


def run_on_ranks(run: Callable[[], int], here: Place) -> int:
    """Run the command on every rank; only the first one prints. Returns the exit code, the same on all ranks.

    A rank that fails alone ends the others.
    """
    try:
        from mpi4py import MPI
    except (ImportError, RuntimeError) as error:
        # RuntimeError: mpi4py found no MPI library.
        return _refuse(here, f"mpi4py is missing ({error}); pip install mpi4py, or start without mpiexec")
    if MPI.COMM_WORLD.size != here.count:
        library = MPI.Get_library_version().split(",")[0]
        return _refuse(here, f"mpi4py uses {library}, which sees {MPI.COMM_WORLD.size}; use the mpiexec of that MPI")
    from meshdeform_core.parallel.mpi import MPIRanks

    # Let the C library return freed arrays of 16 MiB and more to the system, and the end of its heap. By default it
    # keeps up to 64 MiB for later. With 1 MiB instead of 16, a quarter of the time of a rank went into pages that the
    # system cleared.
    with contextlib.suppress(OSError, AttributeError, TypeError):
        ctypes.CDLL(None).mallopt(_MMAP_THRESHOLD, 1 << 24)
    ranks = MPIRanks(MPI.COMM_WORLD)
    set_ranks(ranks)
    messages = io.StringIO()
    with contextlib.ExitStack() as silence:
        if ranks.number:
            nothing = silence.enter_context(open(os.devnull, "w", encoding="utf-8"))
            silence.enter_context(contextlib.redirect_stdout(nothing))
            silence.enter_context(contextlib.redirect_stderr(messages))
        try:
            code = run()
        except SystemExit as stop:
            # A signal: see meshdeform_cli.main.
            code = stop.code if isinstance(stop.code, int) else 1
    return ranks.conclude(code, messages.getvalue(), complete=code in (0, EXIT_INVALID))


def _refuse(here: Place, reason: str) -> int:
    # Without MPI the ranks cannot communicate, but the launcher's numbers determine which one prints.
    if here.number:
        return 0
    tell(f"error: started on {here.count} ranks, but {reason}")
    return EXIT_INPUT
