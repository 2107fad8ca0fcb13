"""Rows of a grid: whole, or divided among ranks, in memory or in a file.

A whole grid is the part of one rank. Of a grid in parts, each row belongs to one rank, and all ranks run the same
program: when all of them ask for the same rows by number, the owners send these rows; loops run on the rows of one
rank, and must not ask for others.
"""

from __future__ import annotations

import math
import mmap
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any, TypeVar

from .loops import current_sharing, empty, for_chunks
from .ranks import ONE_PROCESS, Ranks, WholeGridNeeded

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

T = TypeVar("T")

# Rows of coordinates per chunk; they fit into the cache of a core.
_ROWS = 1 << 14
# Where one row of a mapped file is read, Linux may bring the 2^21 bytes around it into memory. Between two looks at the
# resident size, so many of these stretches are touched, half of what is reserved, and at most so many rows are read.
_STRETCH, _STRETCHES, _FAR_APART = 21, 96, 1 << 16


class Nodes:
    """Rows of an array (n, ...), of which each of some ranks holds consecutive ones.

    A whole array is an ordinary one wherever it is passed on, an array in parts is passed on as this object:
    ``Nodes.of`` takes both. Methods that do something with all ranks must be called by all of them.

    Parameters
    ----------
    ranks : the ranks that hold the parts
    bounds : (n_ranks + 1,) first row of every rank, and the number of rows
    rows : array of all rows in which those of this rank have values
    reserve : called with the ends of further bytes before they are written to, if the array is in a file

    Attributes
    ----------
    rows : as above; rows added by :meth:`widen` have values, too, the others take no memory
    low, high : first and one past the last row of this rank, together ``ends``
    shape, dtype : of the whole array
    divided : whether several ranks hold the rows
    """

    def __init__(
        self, ranks: Ranks, bounds: ArrayLike, rows: Any, reserve: Callable[[int, int], object] = lambda *_: None
    ):
        import numpy as np

        self.ranks, self.bounds, self.rows, self._reserve = ranks, np.asarray(bounds), rows, reserve
        self.shape, self.dtype, self.divided = rows.shape, rows.dtype, ranks.count > 1
        self.low, self.high = self.bounds[ranks.number : ranks.number + 2].tolist()
        self.ends = self._held = self.low, self.high

    @classmethod
    def of(cls, array: Any) -> Nodes:
        """The rows of an array, in parts or whole."""
        return array if isinstance(array, cls) else cls(ONE_PROCESS, (0, len(array)), array)

    @classmethod
    def new(cls, ranks: Ranks, bounds: ArrayLike, shape: Sequence[int], dtype: Any = "float64") -> Any:
        """An uninitialised array of this shape, in parts if there are several ranks; in a file, with room for the rows
        of this rank, if memory is limited."""
        import numpy as np

        if ranks.count == 1:
            return empty(shape, dtype)

        scratch, width = current_sharing().scratch, math.prod(shape[1:]) * np.dtype(dtype).itemsize
        low, high = np.asarray(bounds)[ranks.number : ranks.number + 2].tolist()
        if not (scratch and scratch.takes((high - low) * width)):
            return cls(ranks, bounds, blank(shape, dtype))
        rows, reserve = scratch.blank(shape, dtype)
        reserve(low * width, high * width)
        return cls(ranks, bounds, rows, reserve)

    def like(self, *width: int, dtype: Any = "float64") -> Any:
        """A new, uninitialised array (n, *width), in parts if this one is."""
        return Nodes.new(self.ranks, self.bounds, (len(self), *width), dtype)

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def own(self) -> Any:
        """The rows of this rank."""
        return self.rows[self.low : self.high]

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
        return self._sent(numbers.ravel()).reshape(numbers.shape + self.shape[1:])

    def at(self, numbers: Any) -> Any:
        """Rows by number, in any order, from the ranks that hold them."""
        return self[numbers] if self.divided else _rows_at(self.rows, numbers)

    def __array__(self, *_: Any, **__: Any) -> Any:
        """Refuse numpy operations on the whole array, which is nowhere in memory."""
        raise WholeGridNeeded("an operation on all nodes")

    def _sent(self, rows: Any) -> Any:
        """The rows, sent by their owners."""
        import numpy as np

        holder = np.searchsorted(self.bounds, rows, side="right").astype(np.int32) - 1
        counts = np.bincount(holder, minlength=self.ranks.count).tolist()
        found = self.ranks.collect(_rows_at(self.rows, rows[holder == self.ranks.number]), counts)
        if (holder[1:] < holder[:-1]).any():
            sent, found = found, empty(found.shape, found.dtype)
            found[np.argsort(holder, kind="stable")] = sent
        return found

    def widen(self, first: int, last: int) -> None:
        """Also hold copies of the rows first <= n < last as their owners have them now; all ranks must call this."""
        if not self.divided:
            return
        (low, high), held = self.ends, self._held
        first, last = min(first, low), max(last, high)
        for begin, end in ((first, held[0]), (held[1], last)):
            self._reserve(begin * self.rows.strides[0], end * self.rows.strides[0])
        wanted = self.ranks.gather([(first, last)])
        sends, receives = {}, {}
        for other, (begin, end) in enumerate(wanted):
            if other != self.ranks.number:
                theirs = slice(*self.bounds[other : other + 2].tolist())
                sends[other] = self.rows[max(begin, low) : min(end, high)]
                receives[other] = self.rows[max(first, theirs.start) : min(last, theirs.stop)]
        self.ranks.swap(sends, receives)
        self._held = first, last

    def each(self, fill: Callable[[slice], object]) -> None:
        """Call ``fill(rows)`` for slices of the rows of this rank, on all threads; errors as in :meth:`on_each`."""
        low, high = self.ends
        self.on_each(lambda: for_chunks(lambda lo, hi: fill(slice(low + lo, low + hi)), high - low, _ROWS))

    def on_each(self, action: Callable[[], object]) -> None:
        """Run ``action`` on every rank; an error on one rank is raised on all."""
        failures = list[Exception]()
        try:
            action()
        except Exception as error:
            failures.append(error)
        for failure in self.ranks.gather(failures):
            raise failure

    def gather(self, value: T) -> list[T]:
        """The values of all ranks."""
        return self.ranks.gather([value])

    def total(self, values: Any) -> Any:
        """Sum of the ``values`` of all ranks, arrays of the same shape, in rank order."""
        import numpy as np

        return np.sum(self.gather(values), axis=0) if self.divided else values

    def combined(self, operation: Callable[..., object], other: Any) -> Any:
        """A new array (n, 3) filled by ``operation(this, other, out=...)``, like ``np.subtract``."""
        result, this = self.like(3), self if self.divided else self.rows
        self.each(lambda rows: operation(this[rows], other[rows], out=result[rows]))
        return result

    def require_whole(self, what: str) -> None:
        """Raise :class:`.WholeGridNeeded` if the array is in parts, for ``what`` takes all rows."""
        self.ranks.require_one(what)


def _rows_at(array: Any, rows: Any) -> Any:
    """``array[rows]`` for rows by number, in any order; of an array in a file a few at a time.

    Nodes on block faces lie all over a grid: all at once, they would bring most of its file into memory.
    """
    import numpy as np

    scratch = current_sharing().scratch
    if scratch is None:
        # A quarter of the time that array[rows] takes.
        plain = isinstance(array, np.ndarray) and array.flags.c_contiguous
        return np.asarray(array).take(rows, axis=0) if plain else array[rows]
    flat, found = rows.ravel(), empty((rows.size, *array.shape[1:]), array.dtype)
    for lo in range(0, flat.size, _FAR_APART):
        stretch = flat[lo : lo + _FAR_APART].astype(np.int64) * array.strides[0] >> _STRETCH
        others = lo + 1 + np.flatnonzero(np.diff(stretch))
        ends = [lo, *others[_STRETCHES - 1 :: _STRETCHES].tolist(), lo + len(stretch)]
        for begin, end in pairwise(ends):
            found[begin:end] = array[flat[begin:end]]
            scratch.look()
    return found.reshape(rows.shape + array.shape[1:])


def blank(shape: Sequence[int], dtype: Any) -> Any:
    """An array of zeros whose pages take memory only once written to; it does not count towards a limit on data."""
    import numpy as np

    if not hasattr(mmap, "MAP_ANONYMOUS"):
        return np.zeros(shape, dtype)
    size = max(math.prod(shape) * np.dtype(dtype).itemsize, 1)
    reserve = getattr(mmap, "MAP_NORESERVE", 0)
    flags = mmap.MAP_SHARED | mmap.MAP_ANONYMOUS | reserve
    return np.ndarray(shape, dtype, buffer=mmap.mmap(-1, size, flags=flags))
