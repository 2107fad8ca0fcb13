"""The ranks of an MPI communicator, and memory shared by those of one machine."""

from __future__ import annotations

import copy
import math
import mmap
import os
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from itertools import accumulate
from typing import TYPE_CHECKING, Any, TypeVar

from ..errors import MeshDeformError
from .loops import alone

if TYPE_CHECKING:
    import numpy as np
    from mpi4py.MPI import Comm

T = TypeVar("T")

# Seconds for which a failed rank waits for the others: most input errors occur on all ranks.
_GRACE = 5.0
_POLL = 0.002
# Number of polls without a pause, some ten microseconds, before a waiting rank sleeps.
_TRIES = 50
# Alignment of arrays in bytes: a cache line.
_LINE = 64


class CommonMemory(mmap.mmap):
    """Memory mapped by several processes of a machine; the ``base`` of arrays that lie in it."""


class MPIRanks:
    """The ranks of a communicator as the core sees them (:class:`meshdeform_core.parallel.Ranks`).

    ``machines`` > 1 treats the ranks of this machine as if spread over several, to test exchange between machines.
    """

    def __init__(self, world: Comm, machines: int = 1):
        from mpi4py import MPI

        self._comm, self._end = world.Dup(), world.Dup()
        self.number, self.count = world.rank, world.size
        machine = world.Split_type(MPI.COMM_TYPE_SHARED)
        self.on_machine = machine.size
        # Launchers often bind each rank to some cores, which may overlap.
        usable = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set(range(os.cpu_count() or 1))
        every = set().union(*machine.allgather(usable))
        self.cores = max(1, min(len(usable), len(every) // machine.size))
        self._machine = machine.Split(machine.rank * machines // machine.size)
        machine.Free()
        # Shared arrays are exchanged between machines by the first rank of each.
        leads = self._machine.rank == 0
        self._leaders = world.Split(0 if leads else MPI.UNDEFINED)
        self._leader_of = world.allgather(self._machine.bcast(self._leaders.rank if leads else None))
        # Decided for all ranks together, even those alone on their machine: all must use the same way of sharing.
        several = max(world.allgather(self._machine.size)) > 1
        self.private = next(filter(None, world.allgather(self._why_private())), "") if several else ""
        self._together = several and not self.private

    def _why_private(self) -> str:
        """Test shared memory: ranks in different containers, for instance, cannot see each other's files."""
        word = self._machine.bcast(os.urandom(16))
        try:
            memory = self._map(len(word))
        except (OSError, MeshDeformError) as error:
            return str(error)
        if self._machine.rank == 0:
            memory[:] = word
        self._machine.Barrier()
        same = all(self._machine.allgather(memory[:] == word))
        return "" if same else "the ranks of a machine do not see the same memory"

    def _map(self, size: int) -> CommonMemory:
        """New memory mapped by all ranks of the machine; freed when the last of them unmaps it or ends."""
        name = self._from_first(self._machine, lambda: _memory_file(size))
        failures = []
        try:
            memory = _mapped(name, size)
        except OSError as error:
            failures.append(error)
        for failure in self._gather(self._machine, failures):
            raise failure
        if self._machine.rank == 0:
            # The mapping keeps the memory alive; the descriptor is no longer needed.
            os.close(int(name.rpartition("/")[2]))
        return memory

    def empty(self, shape: Sequence[int], dtype: Any) -> np.ndarray:
        """An uninitialised array, shared by the ranks of the machine where possible."""
        import numpy as np

        if not self._together:
            return np.empty(shape, dtype)
        size = math.prod(shape) * np.dtype(dtype).itemsize
        return np.ndarray(shape, dtype, buffer=self._map(max(size, 1)))

    def group_of(self, arrays: Sequence[np.ndarray]) -> tuple[int, int]:
        """Index of this rank among the ranks that share the memory of ``arrays``, and their number."""
        together = bool(arrays) and all(_is_common(array) for array in arrays)
        return (self._machine.rank, self._machine.size) if together else (0, 1)

    def begin(self, arrays: Sequence[np.ndarray]) -> None:
        """Wait until no rank of the machine reads the shared memory of ``arrays`` any more."""
        self._meet(arrays)

    def finish(self, arrays: Sequence[np.ndarray]) -> None:
        """Wait until all ranks of the machine have written their part of ``arrays`` in shared memory."""
        self._meet(arrays)

    def _meet(self, arrays: Sequence[np.ndarray]) -> None:
        if any(_is_common(array) for array in arrays):
            _meet(self._machine)

    def share(self, array: np.ndarray, rows: Callable[[int], Sequence[Any]]) -> None:
        """Send the rows of each rank to all that lack them, rank by rank: no buffer is larger than one rank's part."""
        if not _is_common(array):
            for number in range(self.count):
                _send(self._comm, number, array, rows(number))
        elif max(self._leader_of):
            _meet(self._machine)
            if self._machine.rank == 0:
                for number, leader in enumerate(self._leader_of):
                    _send(self._leaders, leader, array, rows(number))

    def alter(self, array: np.ndarray, action: Callable[[], object]) -> None:
        """Let ``action``, the same on all ranks, write to ``array``: once per copy of the array."""
        self.begin([array])
        if self._machine.rank == 0 or not _is_common(array):
            action()
        self.finish([array])

    def once(self, make: Callable[[], T]) -> T:
        """The result of ``make``, the same on all ranks: made once per machine, with large arrays in shared memory."""
        if not self._together:
            return make()
        import numpy as np
        from mpi4py.MPI import pickle

        buffers: list[Any] = []

        def packed() -> tuple[bytes, list[int]]:
            data, parts = pickle.dumps_oob(make())
            buffers.extend(parts)
            return data, [part.nbytes for part in parts]

        data, sizes = self._from_first(self._machine, packed)
        ends = list(accumulate((-(-size // _LINE) * _LINE for size in sizes), initial=0))
        memory = self.empty([ends[-1]], np.uint8)
        places = [memory[start : start + size] for start, size in zip(ends, sizes, strict=False)]

        def unpack() -> None:
            for place, buffer in zip(places, buffers, strict=True):
                place[:] = np.frombuffer(buffer, np.uint8)

        self.alter(memory, unpack)
        return pickle.loads_oob(data, places)

    def gather(self, found: Sequence[T]) -> list[T]:
        """The (small) results of all ranks, in rank order."""
        return self._gather(self._comm, found)

    @staticmethod
    def _gather(comm: Comm, found: Sequence[T]) -> list[T]:
        _meet(comm)
        return [each for own in comm.allgather(list(found)) for each in own]

    def collect(self, own: np.ndarray, counts: Sequence[int]) -> np.ndarray:
        """The rows of all ranks, ``counts`` of each, one after the other."""
        import numpy as np

        found = np.empty((sum(counts), *own.shape[1:]), own.dtype)
        width = math.prod(own.shape[1:])
        _meet(self._comm)
        self._comm.Allgatherv(np.ascontiguousarray(own), [found, [width * count for count in counts]])
        return found

    def swap(self, sends: Mapping[int, np.ndarray], receives: Mapping[int, np.ndarray]) -> None:
        """Send arrays to other ranks, by number, and fill those that they send; empty ones are left out."""
        _meet(self._comm)
        requests = [self._comm.Irecv(array, source=number) for number, array in receives.items() if array.size]
        requests += [self._comm.Isend(array, dest=number) for number, array in sends.items() if array.size]
        for request in requests:
            request.Wait()

    def dividing(self) -> MPIRanks:
        """The same ranks without common memory: each holds its part of the grid."""
        other = copy.copy(self)
        other._together = False
        return other

    def on_first(self, action: Callable[[], T]) -> T:
        """Run ``action`` on the first rank only; all get its result or fail with it."""
        return self._from_first(self._comm, action)

    @staticmethod
    def _from_first(comm: Comm, action: Callable[[], T]) -> T:
        failure: Exception | None = None
        result: T | None = None
        if comm.rank == 0:
            try:
                with alone():
                    result = action()
            except Exception as error:
                failure = error
        _meet(comm)
        failed, result = comm.bcast((failure is not None, result))
        if failure is not None:
            raise failure
        if failed:
            raise MeshDeformError("the first rank failed; its message says why")
        return result

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


def _meet(comm: Comm) -> None:
    """Barrier that sleeps after a while, because the rank that is late may need the core."""
    arrived, tries = comm.Ibarrier(), 0
    while not arrived.Test():
        tries += 1
        if tries > _TRIES:
            time.sleep(min(1e-5 * (tries - _TRIES), _POLL))


def _memory_file(size: int) -> str:
    """The name, for other processes, of a new anonymous file of ``size`` bytes in memory."""
    if not hasattr(os, "memfd_create"):
        raise OSError("shared memory requires Linux")
    number = os.memfd_create("meshdeform")
    os.truncate(number, size)
    return f"/proc/{os.getpid()}/fd/{number}"


def _mapped(name: str, size: int) -> CommonMemory:
    number = os.open(name, os.O_RDWR)
    try:
        return CommonMemory(number, size)
    finally:
        os.close(number)


def _is_common(array: Any) -> bool:
    while hasattr(array, "base"):
        array = array.base
    return isinstance(array, CommonMemory)


def _send(comm: Comm, root: int, array: np.ndarray, parts: Sequence[Any]) -> None:
    """Copy the rows ``parts`` (index arrays) of ``array`` from one process to all others, in place."""
    import numpy as np

    if not parts:
        return
    at = np.concatenate(parts)
    part = array[at] if comm.rank == root else np.empty((len(at), *array.shape[1:]), array.dtype)
    comm.Bcast(part, root=root)
    if comm.rank != root:
        array[at] = part
