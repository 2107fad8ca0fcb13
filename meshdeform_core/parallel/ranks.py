"""The processes that share the work: MPI ranks, or a single one; and rows of arrays that they send each other."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

if TYPE_CHECKING:
    import numpy as np

T = TypeVar("T")


class Ranks(Protocol):
    """The MPI ranks that share the work, as one of them sees them.

    Attributes
    ----------
    number, count : index of this rank, from 0, and number of ranks
    on_machine : number of ranks on this machine, including this one
    """

    number: int
    count: int
    on_machine: int

    @property
    def cores(self) -> int:
        """Number of the machine's cores that this rank may use."""
        ...

    def gather(self, found: Sequence[T]) -> list[T]:
        """The (small) results of all ranks, in rank order."""
        ...

    def collect(self, own: Any, counts: Sequence[int]) -> Any:
        """The rows of all ranks, ``counts`` of each, concatenated in rank order."""
        ...

    def swap(self, sends: Mapping[int, Any], receives: Mapping[int, Any]) -> None:
        """Exchange arrays with other ranks, by number: send ``sends``, fill ``receives``; empty ones are skipped."""
        ...

    def on_first(self, action: Callable[[], T]) -> T:
        """Run ``action`` on the first rank only, with all cores that it may use, while the others wait; its result is
        returned, or its error raised, on all ranks."""
        ...


class OneRank:
    """A single process; ``cores`` limits the cores it uses."""

    number, count, on_machine = 0, 1, 1

    def __init__(self, cores: int | None = None):
        self._cores = cores

    @property
    def cores(self) -> int:
        return self._cores or usable_cores()

    def gather(self, found: Sequence[T]) -> list[T]:
        return list(found)

    def collect(self, own: Any, counts: Sequence[int]) -> Any:
        return own

    def swap(self, sends: Mapping[int, Any], receives: Mapping[int, Any]) -> None:
        """Nothing to do: there are no others."""

    def on_first(self, action: Callable[[], T]) -> T:
        return action()


def usable_cores() -> int:
    """Number of cores on which the system lets this process run."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Route:
    """Rows of arrays that go to other ranks, and results that come back for them; all ranks make one together.

    Parameters
    ----------
    ranks : that exchange rows
    target : (n,) the rank to which each row of this one goes
    """

    def __init__(self, ranks: Ranks, target: np.ndarray):
        import numpy as np

        small = target.astype(np.min_scalar_type(ranks.count))
        counts = np.bincount(small, minlength=ranks.count)
        everyone = np.array(ranks.gather([counts]))
        self._ranks = ranks
        self._order = np.argsort(small, kind="stable") if ranks.count > 1 else slice(None)
        self._sent, self._received = everyone[ranks.number], everyone[:, ranks.number]

    def there(self, values: np.ndarray) -> np.ndarray:
        """The rows of all ranks' ``values`` (n, ...) that go to this one, rank by rank, otherwise in their order."""
        return self._passed(values[self._order], self._sent, self._received)

    def back(self, results: np.ndarray) -> np.ndarray:
        """Results (n, ...) for the rows of this rank; ``results`` (m, ...) are those for the rows that came here."""
        found = self._passed(results, self._received, self._sent)
        if self._ranks.count > 1:
            found[self._order] = found.copy()
        return found

    def _passed(self, values: np.ndarray, leaving: np.ndarray, coming: np.ndarray) -> np.ndarray:
        """Rows sent in rank order, ``leaving[r]`` to rank r, and received, ``coming[r]`` from it."""
        import numpy as np

        if self._ranks.count == 1:
            return values
        found = np.empty((coming.sum(), *values.shape[1:]), values.dtype)
        sends, receives = (np.split(rows, np.cumsum(n)[:-1]) for rows, n in ((values, leaving), (found, coming)))
        own = self._ranks.number
        receives[own][...] = sends[own]
        others = [number for number in range(self._ranks.count) if number != own]
        self._ranks.swap({n: sends[n] for n in others}, {n: receives[n] for n in others})
        return found


def joined(ranks: Ranks, values: Any) -> Any:
    """The few rows (n, ...) of all ranks, in rank order."""
    import numpy as np

    return np.concatenate(ranks.gather([values]))


def collected(ranks: Ranks, values: Any) -> Any:
    """The rows (n, ...) of all ranks, in rank order."""
    return ranks.collect(values, ranks.gather([len(values)]))
