"""Arrays of which every rank holds only a part.

Each row of such an array belongs to one rank. All ranks run the same program. When all of them ask for the same rows by
number, the owners send these rows; loops run on the rows of one rank, and must not ask for others.
"""

from __future__ import annotations

import math
import mmap
import threading
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from .loops import current_ranks, empty, for_chunks, holders, rows_at, sharing
from .ranks import OneRank, Ranks
from .scratch import ScratchFile, current_scratch

if TYPE_CHECKING:
    import numpy as np

T = TypeVar("T")

# Rows of coordinates per chunk; they fit into the cache of a core.
_ROWS = 1 << 14


class WholeGridNeeded(Exception):
    """The request requires the whole grid on every rank; raised on all ranks alike, with the reason."""


class Chosen(Protocol):
    """Some rows of an array."""

    @property
    def rows(self) -> np.ndarray:
        """Numbers (n,) of the rows, ascending."""
        ...

    def taken(self, values: np.ndarray, rows: np.ndarray) -> np.ndarray | None:
        """The ``values`` (m, 3), one for each of these rows, of row numbers (n,); ``None`` if any is another row."""
        ...


class Part:
    """An array of which this rank holds some consecutive rows.

    Parameters
    ----------
    ranks : the ranks that hold the parts
    bounds : (n_ranks + 1,) first row of every rank, and the number of rows
    shape, dtype : of the whole array

    Attributes
    ----------
    rows : array of this shape in which only the rows of this rank, and those added by :meth:`widen`, have values; the
        others take no memory
    low, high : first and one past the last row of this rank
    """

    def __init__(self, ranks: Ranks, bounds: np.ndarray, shape: Sequence[int], dtype: Any):
        self.ranks, self.bounds = ranks, bounds
        self.low, self.high = (int(bounds[ranks.number + end]) for end in range(2))
        self.rows, self._file = self._blank(shape, dtype)
        self._held = self.low, self.high
        self._known: tuple[Chosen, np.ndarray] | None = None
        self._thread = threading.get_ident()

    def _blank(self, shape: Sequence[int], dtype: Any) -> tuple[Any, ScratchFile | None]:
        """The rows, in a file with room for those of this rank if memory is limited."""
        import numpy as np

        scratch, width = current_scratch(), math.prod(shape[1:]) * np.dtype(dtype).itemsize
        if not (scratch and scratch.takes((self.high - self.low) * width)):
            return blank(shape, dtype), None
        rows, file = scratch.blank(shape, dtype)
        file.reserve(self.low * width, self.high * width)
        return rows, file

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the whole array."""
        return self.rows.shape

    @property
    def dtype(self) -> Any:
        return self.rows.dtype

    @property
    def nbytes(self) -> int:
        """Size of the whole array in bytes."""
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
        """Refuse numpy operations on the whole array, which is nowhere in memory."""
        raise WholeGridNeeded("an operation on all nodes")

    def keep(self, chosen: Chosen) -> None:
        """Keep a copy of some rows on every rank, so that they need not be sent again."""
        self._known = chosen, self._sent(chosen.rows)

    def keep_like(self, other: Part) -> None:
        """Keep the same rows as another array."""
        if other._known:
            self.keep(other._known[0])

    def _looked_up(self, rows: np.ndarray) -> Any:
        """Rows that all ranks keep; ``None`` if there are others."""
        if self._known is None:
            return None
        chosen, values = self._known
        return chosen.taken(values, rows)

    def _sent(self, rows: np.ndarray) -> Any:
        """The rows, sent by their owners."""
        import numpy as np

        self._require_all()
        order = None
        if np.any(rows[1:] < rows[:-1]):
            order = np.argsort(np.searchsorted(self.bounds, rows, side="right"), kind="stable")
            rows = rows[order]
        first = np.searchsorted(rows, self.bounds) if order is None else self._first_of(rows)
        own = rows[first[self.ranks.number] : first[self.ranks.number + 1]]
        found = self.ranks.collect(rows_at(self.rows, own), np.diff(first).tolist())
        if order is None:
            return found
        result = empty(found.shape, found.dtype)
        result[order] = found
        return result

    def _first_of(self, rows: np.ndarray) -> np.ndarray:
        """Index at which those of the ascending ``rows`` (n,) begin that belong to each rank."""
        import numpy as np

        return np.searchsorted(np.searchsorted(self.bounds, rows, side="right"), np.arange(1, self.ranks.count + 2))

    def widen(self, first: int, last: int) -> None:
        """Also hold copies of the rows first <= n < last as their owners have them now; all ranks must call this."""
        self._require_all()
        first, last = min(first, self.low), max(last, self.high)
        if self._file:
            self._file.reserve(first * self.rows.strides[0], last * self.rows.strides[0])
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
        """Whether any element is nonzero."""
        return any(self.ranks.gather([bool(self.own.any())]))

    def nonzero_rows(self) -> np.ndarray:
        """Indices of the nonzero elements of a one-dimensional array."""
        import numpy as np

        return np.concatenate(self.ranks.gather([self.low + np.flatnonzero(self.own)]))

    def min(self) -> Any:
        """The smallest element."""
        return min(self.ranks.gather([self.own.min()] if len(self.own) else []))

    def _require_all(self) -> None:
        """Raise an error rather than wait for ranks that do not take part."""
        if current_ranks().count != self.ranks.count or threading.get_ident() != self._thread:
            raise RuntimeError("a rank reads rows of others by itself")


def blank(shape: Sequence[int], dtype: Any) -> Any:
    """An array of zeros whose pages take memory only once written to; it does not count towards a limit on data."""
    import numpy as np

    if not hasattr(mmap, "MAP_ANONYMOUS"):
        return np.zeros(shape, dtype)
    size = max(math.prod(shape) * np.dtype(dtype).itemsize, 1)
    reserve = getattr(mmap, "MAP_NORESERVE", 0)
    flags = mmap.MAP_SHARED | mmap.MAP_ANONYMOUS | reserve
    return np.ndarray(shape, dtype, buffer=mmap.mmap(-1, size, flags=flags))


def alike(array: Any, width: int = 3) -> Any:
    """A new, uninitialised array (n, width), in parts if ``array`` (n, ...) is."""
    shape = len(array), width
    return Part(array.ranks, array.bounds, shape, "float64") if isinstance(array, Part) else empty(shape)


def require_whole(array: Any, what: str) -> None:
    """Require that the array is not in parts, for operations on all rows; ``what`` names the operation.

    Raises
    ------
    WholeGridNeeded
        If the array is in parts.
    """
    if isinstance(array, Part):
        raise WholeGridNeeded(what)


def require_undivided(what: str) -> None:
    """Require that a grid about to be read will not be in parts; ``what`` is the reason.

    Raises
    ------
    WholeGridNeeded
        If it would be.
    """
    if holders().count > 1:
        raise WholeGridNeeded(what)


def ranks_of(array: Any) -> Ranks:
    """The ranks that hold an array in parts; this process alone for any other array."""
    return array.ranks if isinstance(array, Part) else OneRank()


def rows_of(array: Any) -> Any:
    """For an array in parts, the plain array with the rows that this rank holds; any other array itself."""
    return array.rows if isinstance(array, Part) else array


def own_rows(array: Any) -> tuple[int, int]:
    """First and one past the last row of this rank; all rows of an array that is not in parts."""
    return (array.low, array.high) if isinstance(array, Part) else (0, len(array))


def for_rows(fill: Callable[[slice], object], array: Any) -> None:
    """Call ``fill(rows)`` for slices of ``array`` (n, ...), for an array in parts only for the rows of this rank.

    For values that cost less to compute on every rank than to send.
    """
    begin, end = own_rows(array)

    def work(lo: int, hi: int) -> None:
        fill(slice(begin + lo, begin + hi))

    if isinstance(array, Part):
        on_each(array, lambda: for_chunks(work, end - begin, _ROWS))
    else:
        for_chunks(work, len(array), _ROWS)


def check_rows(look: Callable[[slice], object], array: Any) -> None:
    """Call ``look(rows)`` for slices of ``array`` (n, ...), for an array in parts only for the rows of this rank."""
    begin, end = own_rows(array)
    for_chunks(lambda lo, hi: look(slice(begin + lo, begin + hi)), end - begin, _ROWS)


def of_all(array: Any, value: T) -> list[T]:
    """The values of all ranks if the array is in parts, otherwise only ``value``."""
    return ranks_of(array).gather([value])


def summed(array: Any, values: np.ndarray) -> np.ndarray:
    """Sum of the ``values`` of all ranks if the array is in parts, in rank order; otherwise ``values``.

    All of them must have the same shape. Only some are in memory for all ranks at a time.
    """
    ranks = ranks_of(array)
    if ranks.count == 1:
        return values
    own = values.ravel()
    result = own.copy()
    for first in range(0, own.size, _ROWS):
        some = own[first : first + _ROWS]
        every = ranks.collect(some, [len(some)] * ranks.count)
        result[first : first + _ROWS] = every.reshape(ranks.count, -1).sum(axis=0)
    return result.reshape(values.shape)


def numbered(array: Any, count: int) -> tuple[int, int]:
    """Number of this rank's first item, if it has ``count`` and items are numbered rank by rank; and their total."""
    counts = of_all(array, count)
    return sum(counts[: ranks_of(array).number]), sum(counts)


def held_together(array: Any) -> AbstractContextManager[None]:
    """Context for work by all ranks that hold parts of the array, outside the run that distributed it."""
    return sharing(array.ranks, None) if isinstance(array, Part) else nullcontext()


def together(array: Any, action: Callable[[], T]) -> T:
    """The result, on all ranks, of ``action`` of the first rank alone: of those that hold parts of the array, else of
    all."""
    return (array.ranks if isinstance(array, Part) else current_ranks()).on_first(action)


def combined(operation: Callable[..., object], one: Any, two: Any) -> Any:
    """A new array (n, 3), in parts if ``one`` is, filled by ``operation(one, two, out=...)``, like ``np.subtract``."""
    result = alike(one)
    for_rows(lambda rows: operation(one[rows], two[rows], out=result[rows]), result)
    return result


def on_each(array: Part, action: Callable[[], object]) -> None:
    """Run ``action`` on every rank of an array; an error on one rank is raised on all."""
    failures = list[Exception]()
    try:
        action()
    except Exception as error:
        failures.append(error)
    for failure in array.ranks.gather(failures):
        raise failure
