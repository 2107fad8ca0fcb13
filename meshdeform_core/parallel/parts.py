"""Arrays of which every rank holds only a part.

Row n of such an array belongs to one rank. All ranks run the same program: rows asked for by number, the same on all of
them, are sent by their owners; work on the rows of a rank is done by it :func:`alone <.loops.alone>`.
"""

from __future__ import annotations

import math
import mmap
import threading
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import TYPE_CHECKING, Any, TypeVar

from .loops import alone, current_ranks, empty, for_chunks
from .ranks import OneRank, Ranks

if TYPE_CHECKING:
    import numpy as np

T = TypeVar("T")

# Rows of coordinates per chunk; they fit into the cache of a core.
_ROWS = 1 << 14


class WholeGridNeeded(Exception):
    """What is asked for takes the whole grid on every rank; raised on all ranks alike, with the reason."""


class Part:
    """An array of which this rank holds some consecutive rows.

    Parameters
    ----------
    ranks : that hold the others
    bounds : (n_ranks + 1,) first row of every rank
    shape, dtype : of the whole array

    Attributes
    ----------
    rows : array of this shape in which only the rows of this rank, and those that :meth:`widen` has added, have values;
        the others take no memory
    low, high : first and one past the last row of this rank
    """

    def __init__(self, ranks: Ranks, bounds: np.ndarray, shape: Sequence[int], dtype: Any):
        self.ranks, self.bounds = ranks, bounds
        self.low, self.high = (int(bounds[ranks.number + end]) for end in range(2))
        self.rows = blank(shape, dtype)
        self._held = self.low, self.high
        self._known: tuple[np.ndarray, np.ndarray] | None = None
        self._thread = threading.get_ident()

    @property
    def shape(self) -> tuple[int, ...]:
        """Of the whole array."""
        return self.rows.shape

    @property
    def dtype(self) -> Any:
        return self.rows.dtype

    @property
    def nbytes(self) -> int:
        """Size of the whole array."""
        return self.rows.nbytes

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def own(self) -> Any:
        """The rows of this rank."""
        return self.rows[self.low : self.high]

    @property
    def keeps(self) -> bool:
        """Whether all ranks keep a copy of some rows, see :meth:`keep`."""
        return self._known is not None

    def __getitem__(self, rows: Any) -> Any:
        """A range of rows that this rank holds, or, on all ranks together, rows by number."""
        import numpy as np

        if isinstance(rows, slice):
            first, last, step = rows.indices(len(self))
            if step != 1 or (first < last and (first < self._held[0] or last > self._held[1])):
                raise IndexError(f"rows {first} to {last} of an array in parts; held are {self._held}")
            return self.rows[rows]
        numbers = np.asarray(rows)
        if numbers.dtype.kind not in "iu":
            raise TypeError(f"rows of an array in parts by {numbers.dtype}; expected numbers of rows")
        flat = numbers.ravel()
        found = self._looked_up(flat)
        return (self._sent(flat) if found is None else found).reshape(numbers.shape + self.shape[1:])

    def __array__(self, *_: Any, **__: Any) -> Any:
        """Operations of numpy on all rows take all of them."""
        raise WholeGridNeeded("an operation on all nodes")

    def keep(self, rows: np.ndarray) -> None:
        """Keep a copy of some rows (n,), ascending, on every rank: they need not be sent again."""
        self._known = rows, self._sent(rows)

    def keep_like(self, other: Part) -> None:
        """Keep the rows that another array keeps."""
        if other._known:
            self.keep(other._known[0])

    def _looked_up(self, rows: np.ndarray) -> Any:
        """Rows that all ranks keep; ``None`` if there are others."""
        import numpy as np

        if self._known is None or not len(rows):
            return None
        numbers, values = self._known
        at = np.minimum(np.searchsorted(numbers, rows), len(numbers) - 1)
        return values[at] if np.array_equal(numbers[at], rows) else None

    def _sent(self, rows: np.ndarray) -> Any:
        """Rows from their owners."""
        import numpy as np

        self._require_all()
        order = None
        if np.any(rows[1:] < rows[:-1]):
            order = np.argsort(np.searchsorted(self.bounds, rows, side="right"), kind="stable")
            rows = rows[order]
        first = np.searchsorted(rows, self.bounds) if order is None else self._first_of(rows)
        own = rows[first[self.ranks.number] : first[self.ranks.number + 1]]
        found = self.ranks.collect(self.rows[own], np.diff(first).tolist())
        if order is None:
            return found
        result = np.empty_like(found)
        result[order] = found
        return result

    def _first_of(self, rows: np.ndarray) -> np.ndarray:
        """Where the rows (n,) of each rank begin, which come rank after rank."""
        import numpy as np

        return np.searchsorted(np.searchsorted(self.bounds, rows, side="right"), np.arange(1, self.ranks.count + 2))

    def widen(self, first: int, last: int) -> None:
        """Hold the rows first <= n < last, too, as they are now with their owners; all ranks call this together."""
        self._require_all()
        first, last = min(first, self.low), max(last, self.high)
        wanted = self.ranks.gather([(first, last)])
        sends, receives = {}, {}
        for other, (begin, end) in enumerate(wanted):
            if other != self.ranks.number:
                theirs = slice(int(self.bounds[other]), int(self.bounds[other + 1]))
                sends[other] = self.rows[max(begin, self.low) : min(end, self.high)]
                receives[other] = self.rows[max(first, theirs.start) : min(last, theirs.stop)]
        self.ranks.swap(sends, receives)
        self._held = first, last

    def any(self) -> bool:
        """Whether any element is not zero."""
        return any(self.ranks.gather([bool(self.own.any())]))

    def nonzero_rows(self) -> np.ndarray:
        """Numbers of the elements that are not zero, of an array with one axis."""
        import numpy as np

        return np.concatenate(self.ranks.gather([self.low + np.flatnonzero(self.own)]))

    def min(self) -> Any:
        """The smallest element."""
        return min(self.ranks.gather([self.own.min()] if len(self.own) else []))

    def _require_all(self) -> None:
        """Refuse to wait for ranks that do not take part."""
        if current_ranks().count != self.ranks.count or threading.get_ident() != self._thread:
            raise RuntimeError("a rank reads rows of others by itself")


def blank(shape: Sequence[int], dtype: Any) -> Any:
    """An array whose pages take memory once they are written to; not counted by a limit on data."""
    import numpy as np

    if not hasattr(mmap, "MAP_ANONYMOUS"):
        return np.zeros(shape, dtype)
    size = max(math.prod(shape) * np.dtype(dtype).itemsize, 1)
    reserve = getattr(mmap, "MAP_NORESERVE", 0)
    flags = mmap.MAP_SHARED | mmap.MAP_ANONYMOUS | reserve
    return np.ndarray(shape, dtype, buffer=mmap.mmap(-1, size, flags=flags))


def alike(array: Any, width: int = 3) -> Any:
    """A new array (n, width) without values, in parts if ``array`` (n, ...) is."""
    shape = len(array), width
    return Part(array.ranks, array.bounds, shape, "float64") if isinstance(array, Part) else empty(shape)


def require_whole(array: Any, what: str) -> None:
    """Refuse what takes all rows.

    Raises
    ------
    WholeGridNeeded
        If the array is in parts.
    """
    if isinstance(array, Part):
        raise WholeGridNeeded(what)


def ranks_of(array: Any) -> Ranks:
    """The ranks that hold an array in parts; this process alone for any other array."""
    return array.ranks if isinstance(array, Part) else OneRank()


def rows_of(array: Any) -> Any:
    """The array with the rows that this rank holds, or the array itself."""
    return array.rows if isinstance(array, Part) else array


def own_rows(array: Any) -> tuple[int, int]:
    """First and one past the last row of this rank; all of an array that is not in parts."""
    return (array.low, array.high) if isinstance(array, Part) else (0, len(array))


def apart(array: Any) -> AbstractContextManager[None]:
    """For work on the rows of this rank: no loop is shared with other ranks, if the array is in parts."""
    return alone() if isinstance(array, Part) else nullcontext()


def for_rows(fill: Callable[[slice], object], array: Any) -> None:
    """Let ``fill(rows)`` fill slices of ``array`` (n, ...), of a part its own rows.

    For values that cost less to compute than to send.
    """
    begin, end = own_rows(array)

    def work(lo: int, hi: int) -> None:
        fill(slice(begin + lo, begin + hi))

    if isinstance(array, Part):
        on_each(lambda: for_chunks(work, end - begin, _ROWS))
    else:
        for_chunks(work, len(array), _ROWS)


def check_rows(look: Callable[[slice], object], array: Any) -> None:
    """Let ``look(rows)`` look at slices of ``array`` (n, ...): of a part its own rows, else every rank at all."""
    begin, end = own_rows(array)
    with apart(array):
        for_chunks(lambda lo, hi: look(slice(begin + lo, begin + hi)), end - begin, _ROWS)


def of_all(array: Any, value: T) -> list[T]:
    """The values of all ranks, if the array is in parts."""
    return ranks_of(array).gather([value])


def numbered(array: Any, count: int) -> tuple[int, int]:
    """Number of the first of this rank's ``count`` items, which follow those of the ranks before, and of all items."""
    counts = of_all(array, count)
    return sum(counts[: ranks_of(array).number]), sum(counts)


def on_each(action: Callable[[], object]) -> None:
    """Run ``action`` on every rank by itself; an error on one of them is raised on all."""
    ranks, failures = current_ranks(), list[Exception]()
    try:
        with alone():
            action()
    except Exception as error:
        failures.append(error)
    for failure in ranks.gather(failures):
        raise failure
