"""The ranks of an MPI communicator."""

from __future__ import annotations

import math
import os
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, TypeVar

from ..errors import MeshDeformError
from .loops import Ranks, alone, empty, own_cores

if TYPE_CHECKING:
    import numpy as np
    from mpi4py.MPI import Comm

T = TypeVar("T")

# Seconds for which a failed rank waits for the others: most input errors occur on all ranks.
_GRACE = 5.0
_POLL = 0.002
# Number of polls without a pause, some ten microseconds, before a waiting rank sleeps.
_TRIES = 50


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
        super().__init__(max(1, min(len(usable), len(self._all_cores) // machine.size)))
        machine.Free()

    def gather(self, found: Sequence[T]) -> list[T]:
        self._meet()
        return [each for own in self._comm.allgather(list(found)) for each in own]

    def collect(self, own: np.ndarray, counts: Sequence[int] | None = None) -> np.ndarray:
        import numpy as np

        counts = self.gather([len(own)]) if counts is None else counts
        found = empty((sum(counts), *own.shape[1:]), own.dtype)
        width = math.prod(own.shape[1:])
        self._meet()
        self._comm.Allgatherv(np.ascontiguousarray(own), [found, [width * count for count in counts]])
        return found

    def swap(self, sends: Mapping[int, np.ndarray], receives: Mapping[int, np.ndarray]) -> None:
        self._meet()
        requests = [self._comm.Irecv(array, source=number) for number, array in receives.items() if array.size]
        requests += [self._comm.Isend(array, dest=number) for number, array in sends.items() if array.size]
        for request in requests:
            request.Wait()

    def on_first(self, action: Callable[[], T]) -> T:
        failure: Exception | None = None
        result: T | None = None
        if self.number == 0:
            try:
                # The cores of all ranks on its machine, to which launchers bind them.
                bind, own = getattr(os, "sched_setaffinity", lambda *_: None), own_cores()
                bind(0, self._all_cores)
                try:
                    with alone(len(own_cores()), self.on_machine):
                        result = action()
                finally:
                    bind(0, own)
            except Exception as error:
                failure = error
        self._meet()
        failed, result = self._comm.bcast((failure is not None, result))
        if failure is not None:
            raise failure
        if failed:
            raise MeshDeformError("the first rank failed; its message says why")
        return result

    def _meet(self) -> None:
        """Barrier that sleeps after a while, as the rank waited for may need the core."""
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
