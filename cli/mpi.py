"""Several processes on one case, started by ``mpiexec``; mpi4py is imported only then."""

from __future__ import annotations

import contextlib
import io
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

import click

from meshdeform_core.errors import MeshDeformError
from meshdeform_core.numerics.parallel import set_ranks

from .main import EXIT_INPUT, EXIT_INVALID

if TYPE_CHECKING:
    import numpy as np
    from mpi4py.MPI import Intracomm

T = TypeVar("T")

# How launchers tell a process its number and how many there are.
_LAUNCHERS = (
    ("OMPI_COMM_WORLD_RANK", "OMPI_COMM_WORLD_SIZE"),  # Open MPI
    ("PMI_RANK", "PMI_SIZE"),  # MPICH, Intel MPI, Microsoft MPI
    ("PMIX_RANK", "SLURM_STEP_NUM_TASKS"),  # srun --mpi=pmix
)
# A rank that failed waits so many seconds for the others to fail alike, which most errors in the input make them do.
_GRACE = 5.0
_POLL = 0.002


@dataclass(frozen=True)
class Place:
    """Which of how many processes this one is."""

    number: int
    count: int


def place() -> Place | None:
    """Where the launcher says this process stands; ``None`` for a process on its own."""
    for names in _LAUNCHERS:
        texts = [os.environ.get(name, "") for name in names]
        if all(text.isdigit() for text in texts) and int(texts[1]) > 1:
            return Place(*(int(text) for text in texts))
    return None


def run_on_ranks(run: Callable[[], int], here: Place) -> int:
    """Run the command on every rank; the first one speaks for all. Returns the exit code, the same on all ranks.

    A rank that fails on its own ends the others.
    """
    try:
        from mpi4py import MPI
    except (ImportError, RuntimeError) as error:
        # RuntimeError: mpi4py found no MPI library.
        return _refuse(here, f"needs mpi4py ({error}); pip install 'meshdeform[mpi]', or start it without mpiexec")
    if MPI.COMM_WORLD.size != here.count:
        library = MPI.Get_library_version().split(",")[0]
        return _refuse(here, f"mpi4py uses {library}, which sees {MPI.COMM_WORLD.size}; use the mpiexec of that MPI")
    ranks = MPIRanks(MPI.COMM_WORLD)
    set_ranks(ranks)
    with _voice(ranks.number) as messages:
        try:
            code = run()
        except SystemExit as stop:
            # A signal: see meshdeform_cli.main.
            code = stop.code if isinstance(stop.code, int) else 1
    return ranks.conclude(code, messages.getvalue())


def _refuse(here: Place, reason: str) -> int:
    # Without MPI the ranks cannot speak to each other, but the launcher's numbers tell who speaks.
    if here.number:
        return 0
    click.echo(f"meshdeform: error: a start on {here.count} ranks: {reason}", err=True)
    return EXIT_INPUT


@contextlib.contextmanager
def _voice(number: int) -> Iterator[io.StringIO]:
    """Let the first rank print; of the others keep what they would have told on stderr."""
    messages = io.StringIO()
    if number == 0:
        yield messages
        return
    with (
        open(os.devnull, "w", encoding="utf-8") as nothing,
        contextlib.redirect_stdout(nothing),
        contextlib.redirect_stderr(messages),
    ):
        yield messages


class MPIRanks:
    """The ranks of a communicator as the core sees them (:class:`meshdeform_core.numerics.parallel.Ranks`)."""

    def __init__(self, world: Intracomm):
        from mpi4py import MPI

        self._comm, self._end = world.Dup(), world.Dup()
        self.number, self.count = world.rank, world.size
        machine = world.Split_type(MPI.COMM_TYPE_SHARED)
        self.on_machine = machine.size
        # Launchers often bind each rank to some cores, which may overlap.
        usable = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set(range(os.cpu_count() or 1))
        every = set().union(*machine.allgather(usable))
        self.cores = max(1, min(len(usable), len(every) // machine.size))
        machine.Free()

    def share(self, array: np.ndarray, rows: Sequence[Sequence[Any]]) -> None:
        """Send the rows of each rank to all others, rank by rank: no buffer is larger than one rank's part."""
        import numpy as np

        for number, parts in enumerate(rows):
            if not parts:
                continue
            at = np.concatenate(parts)
            mine = number == self.number
            part = array[at] if mine else np.empty((len(at), *array.shape[1:]), array.dtype)
            self._comm.Bcast(part, root=number)
            if not mine:
                array[at] = part

    def on_first(self, action: Callable[[], T]) -> T:
        """Do something on the first rank only; its result, or that it failed, goes to all."""
        failure: Exception | None = None
        result: T | None = None
        if self.number == 0:
            try:
                result = action()
            except Exception as error:
                failure = error
        failed, result = self._comm.bcast((failure is not None, result))
        if failure is not None:
            raise failure
        if failed:
            raise MeshDeformError("the first rank failed; its message says why")
        return result

    def conclude(self, code: int, messages: str) -> int:
        """Meet the other ranks at the end and agree on the exit code; ``messages`` is what this rank did not print."""
        arrived = self._end.Ibarrier()
        patience = _GRACE if code not in (0, EXIT_INVALID) else float("inf")
        start = time.monotonic()
        while not arrived.Test():
            if time.monotonic() - start > patience:
                # The others wait for this rank or work on: no way to ask them.
                self._tell(self.number, messages)
                self._end.Abort(code)
            time.sleep(_POLL)
        outcomes = self._end.allgather((code, messages))
        failed = [number for number, (each, _) in enumerate(outcomes) if each] or [0]
        if self.number == 0:
            self._tell(failed[0], outcomes[failed[0]][1])
        return int(outcomes[failed[0]][0])

    def _tell(self, number: int, messages: str) -> None:
        if number and messages:
            sys.stderr.write(f"rank {number} of {self.count}: {messages}")
            sys.stderr.flush()
