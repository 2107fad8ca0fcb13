"""The processes that share the work: MPI ranks, or a single one."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol, TypeVar

T = TypeVar("T")


class Ranks(Protocol):
    """The MPI ranks that share the work, as one of them sees them.

    Attributes
    ----------
    number, count : index of this rank, from 0, and number of ranks
    on_machine : number of ranks on this machine, including this one
    private : why the ranks of a machine do not share memory; empty if they do, or if there is only one
    """

    number: int
    count: int
    on_machine: int
    private: str

    @property
    def cores(self) -> int:
        """Number of cores of the machine for this rank."""
        ...

    def empty(self, shape: Sequence[int], dtype: Any) -> Any:
        """An uninitialised array, shared by the ranks of the machine where possible."""
        ...

    def group_of(self, arrays: Sequence[Any]) -> tuple[int, int]:
        """Index of this rank among the ranks that share the memory of ``arrays``, and their number."""
        ...

    def begin(self, arrays: Sequence[Any]) -> None:
        """Wait until no rank of the machine reads the shared memory of ``arrays`` any more."""
        ...

    def share(self, array: Any, rows: Callable[[int], Sequence[Any]]) -> None:
        """Complete ``array`` in place; ``rows(r)`` are the rows that rank r filled: index arrays."""
        ...

    def finish(self, arrays: Sequence[Any]) -> None:
        """Wait until all ranks of the machine have written their part of ``arrays`` in shared memory."""
        ...

    def alter(self, array: Any, action: Callable[[], object]) -> None:
        """Let ``action``, the same on all ranks, write to ``array``: once per copy of the array."""
        ...

    def once(self, make: Callable[[], T]) -> T:
        """The result of ``make``, the same on all ranks: made once per machine where memory is shared; read-only."""
        ...

    def gather(self, found: Sequence[T]) -> list[T]:
        """The (small) results of all ranks, in rank order."""
        ...

    def collect(self, own: Any, counts: Sequence[int]) -> Any:
        """The rows of all ranks, ``counts`` of each, one after the other."""
        ...

    def swap(self, sends: Mapping[int, Any], receives: Mapping[int, Any]) -> None:
        """Send arrays to other ranks, by number, and fill those that they send; empty ones are left out."""
        ...

    def dividing(self) -> Ranks:
        """The same ranks without common memory: each holds its part of the grid."""
        ...

    def on_first(self, action: Callable[[], T]) -> T:
        """Run ``action``, such as writing a file, on the first rank only; all get its result or raise its error."""
        ...


class OneRank:
    """A single process; ``cores`` limits the cores it uses."""

    number, count, on_machine, private = 0, 1, 1, ""

    def __init__(self, cores: int | None = None):
        self._cores = cores

    @property
    def cores(self) -> int:
        return self._cores or usable_cores()

    def empty(self, shape: Sequence[int], dtype: Any) -> Any:
        # Imported late: the number of threads of linear algebra must be set before numpy is loaded.
        import numpy as np

        return np.empty(shape, dtype)

    def group_of(self, arrays: Sequence[Any]) -> tuple[int, int]:
        return 0, 1

    def begin(self, arrays: Sequence[Any]) -> None:
        """Nothing to do: no other rank reads."""

    def share(self, array: Any, rows: Callable[[int], Sequence[Any]]) -> None:
        """Nothing to do: no rows are missing."""

    def finish(self, arrays: Sequence[Any]) -> None:
        """Nothing to do: no other rank writes."""

    def alter(self, array: Any, action: Callable[[], object]) -> None:
        action()

    def once(self, make: Callable[[], T]) -> T:
        return make()

    def gather(self, found: Sequence[T]) -> list[T]:
        return list(found)

    def collect(self, own: Any, counts: Sequence[int]) -> Any:
        return own

    def swap(self, sends: Mapping[int, Any], receives: Mapping[int, Any]) -> None:
        """Nothing to do: there are no others."""

    def dividing(self) -> OneRank:
        return self

    def on_first(self, action: Callable[[], T]) -> T:
        return action()


def usable_cores() -> int:
    """Number of cores on which the system lets this process run."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
