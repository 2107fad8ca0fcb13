"""Items of which each rank computes its own and holds copies of some that others compute."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .parts import Part
from .ranks import OneRank, Ranks

if TYPE_CHECKING:
    import numpy as np


class Halo:
    """Items with ascending ``numbers`` (n,), of which the rank r owns those from ``bounds[r]`` to ``bounds[r + 1]``.

    All ranks make one together; a rank must hold every item of its own that another one holds.

    Attributes
    ----------
    low, high : the items of this rank: low <= n < high
    total : how many items the ranks own altogether
    """

    def __init__(self, numbers: np.ndarray, ranks: Ranks, bounds: np.ndarray):
        import numpy as np

        self._ranks, self.numbers = ranks, numbers
        first = np.searchsorted(numbers, bounds).tolist()
        self._runs = {n: slice(*first[n : n + 2]) for n in range(ranks.count) if n != ranks.number}
        self.low, self.high = first[ranks.number : ranks.number + 2]
        counts = ranks.gather([np.diff(first).tolist()])
        self.total = sum(each[number] for number, each in enumerate(counts))
        asked = {n: np.empty(counts[n][ranks.number], np.int64) for n in self._runs}
        ranks.swap({n: numbers[run] for n, run in self._runs.items()}, asked)
        self._wanted = {n: np.searchsorted(numbers, each) for n, each in asked.items()}

    @classmethod
    def alone(cls, numbers: np.ndarray) -> Halo:
        """All items belong to this process."""
        import numpy as np

        return cls(numbers, OneRank(), np.array([0, int(numbers[-1]) + 1 if len(numbers) else 0]))

    @property
    def own(self) -> slice:
        """The items of this rank."""
        return slice(self.low, self.high)

    def complete(self, values: np.ndarray) -> np.ndarray:
        """Fill the rows of ``values`` (n, ...) that other ranks own with those ranks' values; returns ``values``."""
        if self._runs:
            sends = {n: values[rows] for n, rows in self._wanted.items()}
            self._ranks.swap(sends, {n: values[run] for n, run in self._runs.items()})
        return values

    def of(self, array: Any) -> Any:
        """The items (n, ...) of an array with a row for every number, which may be in parts with these bounds."""
        import numpy as np

        if not isinstance(array, Part):
            return array[self.numbers]
        found = np.empty((len(self.numbers), *array.shape[1:]), array.dtype)
        found[self.own] = array.rows[self.numbers[self.own]]
        return self.complete(found)

    def joined(self, values: np.ndarray) -> np.ndarray:
        """The (few) values (k, ...) of all ranks, in rank order."""
        import numpy as np

        found = self._ranks.gather([values])
        return found[0] if len(found) == 1 else np.concatenate(found)
