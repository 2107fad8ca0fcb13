"""Processes that share the work: one by itself, or the ranks of an MPI communicator.

Ranks run the same program, each on its part of a grid (:mod:`.nodes`), which knows them; no loop is shared by ranks.
"""

from __future__ import annotations

import math
import os
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

from ..errors import MeshDeformError
from .loops import current_sharing, empty, own_cores, sharing, thread_count

if TYPE_CHECKING:
    import numpy as np
    from mpi4py.MPI import Comm

T = TypeVar("T")

# Seconds for which a failed rank waits for the others: most input errors occur on all ranks.
_GRACE = 5.0
_POLL = 0.002
# Number of polls without a pause, some ten microseconds, before a waiting rank sleeps.
_TRIES = 50


class WholeGridNeeded(Exception):
    """The request requires the whole grid on every rank; raised on all ranks alike, with the reason."""


class Ranks:
    """The ranks that share the work, as one of them sees them; this class is a process by itself.

    Attributes
    ----------
    number, count : index of this rank, from 0, and number of ranks
    on_machine : number of ranks on this machine, including this one
    cores : number of the machine's cores that this rank may use; ``None``: all that the system lets it
    """

    number, count, on_machine = 0, 1, 1
    cores: int | None = None

    @property
    def on_several_machines(self) -> bool:
        return self.count > self.on_machine

    def require_one(self, what: str) -> None:
        """Raise :class:`WholeGridNeeded` if there are several, for ``what`` takes a whole grid."""
        if self.count > 1:
            raise WholeGridNeeded(what)

    def gather(self, found: Sequence[T]) -> list[T]:
        """The (small) results of all ranks, in rank order."""
        return list(found)

    def largest(self, value: float) -> float:
        """The largest of the values of all ranks, for decisions that must be the same on all even if their processors
        round differently."""
        import numpy as np

        return float(np.max(self.gather([value])))

    def meet(self) -> None:
        """Wait for the other ranks; an error where this one is by itself, as they do not come."""
        if current_sharing().apart:
            raise RuntimeError("a rank waits for others by itself")

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


ONE_PROCESS = Ranks()


class MPIRanks(Ranks):
    """The ranks of a communicator as the core sees them."""

    def __init__(self, world: Comm):
        from mpi4py import MPI

        self._comm, self._end = world.Dup(), world.Dup()
        self.number, self.count = world.rank, world.size
        machine = world.Split_type(MPI.COMM_TYPE_SHARED)
        self.on_machine = machine.size
        # Launchers often bind each rank to some cores, which may overlap.
        usable = own_cores()
        self._all_cores = set().union(*machine.allgather(usable))
        self.cores = max(1, min(len(usable), len(self._all_cores) // machine.size))
        machine.Free()

    def gather(self, found: Sequence[T]) -> list[T]:
        self.meet()
        return [each for own in self._comm.allgather(list(found)) for each in own]

    def collect(self, own: np.ndarray, counts: Sequence[int] | None = None) -> np.ndarray:
        import numpy as np

        counts = self.gather([len(own)]) if counts is None else counts
        found = empty((sum(counts), *own.shape[1:]), own.dtype)
        width = math.prod(own.shape[1:])
        self.meet()
        self._comm.Allgatherv(np.ascontiguousarray(own), [found, [width * count for count in counts]])
        return found

    def swap(self, sends: Mapping[int, np.ndarray], receives: Mapping[int, np.ndarray]) -> None:
        self.meet()
        requests = [self._comm.Irecv(array, source=number) for number, array in receives.items() if array.size]
        requests += [self._comm.Isend(array, dest=number) for number, array in sends.items() if array.size]
        for request in requests:
            request.Wait()

    def on_first(self, action: Callable[[], T]) -> T:
        failure: Exception | None = None
        result: T | None = None
        if self.number == 0:
            bind, own = getattr(os, "sched_setaffinity", lambda *_: None), own_cores()
            threads = self.on_machine * thread_count()
            try:
                # The cores of all ranks on its machine, to which launchers bind them.
                bind(0, self._all_cores)
                with sharing(threads=threads, apart=True):
                    result = action()
            except Exception as error:
                failure = error
            finally:
                bind(0, own)
        self.meet()
        failed, result = self._comm.bcast((failure is not None, result))
        if failure is not None:
            raise failure
        if failed:
            raise MeshDeformError("the first rank failed; its message says why")
        return result

    def meet(self) -> None:
        super().meet()
        # A barrier that sleeps after a while, as the rank waited for may need the core.
        arrived, tries = self._comm.Ibarrier(), 0
        while not arrived.Test():
            tries += 1
            if tries > _TRIES:
                time.sleep(min(1e-5 * (tries - _TRIES), _POLL))

    def conclude(self, code: int, messages: str, complete: bool) -> int:
        """Wait for the other ranks at the end and agree on the exit code.

        ``messages`` is what this rank did not print. A rank that did not ``complete`` its work waits only a few
        seconds: the others may never arrive.
        """
        arrived = self._end.Ibarrier()
        patience = float("inf") if complete else _GRACE
        start = time.monotonic()
        while not arrived.Test():
            if time.monotonic() - start > patience:
                # The other ranks are still working or wait for this one: no collective call is possible.
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
