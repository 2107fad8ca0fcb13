"""Coordinates of a block as most files hold them: component after component, each with i running fastest.

A grid stores x, y and z of a node together, with k running fastest. Converting one component at a time would load every
cache line three times; a few lines along j are converted at a time, so that they stay in the cache between uses.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.grid import FloatArray
from meshdeform_core.parallel import carried, for_chunks, thread_count

T = TypeVar("T")
# Larger blocks are converted component by component, without a copy of the block.
_TOGETHER = 1 << 28
_LINES = 8
_AHEAD = 3


def common_type(stored: Iterable[Any]) -> np.dtype[Any]:
    """The native type of numbers that holds those of all ``stored`` arrays or datasets."""
    return np.result_type(*(each.dtype.newbyteorder("=") for each in stored))


def split(block: FloatArray, kind: np.dtype[Any], count: int = 3) -> Iterator[NDArray[Any]]:
    """The first ``count`` components (nk, nj, ni) of a block (ni, nj, nk, 3), of type ``kind``."""
    for axes in _groups(block, count):
        out = np.empty((axes.stop - axes.start, *block.shape[2::-1]), kind)

        def work(lo: int, hi: int, out: NDArray[Any] = out, axes: slice = axes) -> None:
            out[:, :, lo:hi] = block[:, lo:hi, :, axes].T

        for_chunks(work, block.shape[1], _LINES)
        yield from out


def merge(block: FloatArray, components: Iterator[NDArray[Any]], count: int = 3) -> None:
    """Fill the first ``count`` components of a block (ni, nj, nk, 3) from arrays of nk nj ni numbers each."""
    for axes in _groups(block, count):
        arrays = [next(components).reshape(block.shape[2::-1]) for _ in range(axes.start, axes.stop)]

        def work(lo: int, hi: int, arrays: Sequence[NDArray[Any]] = arrays, first: int = axes.start) -> None:
            # NaN in the file is reported by the caller, not by a warning of the conversion.
            with np.errstate(invalid="ignore"):
                for axis, array in enumerate(arrays, first):
                    block[:, lo:hi, :, axis] = array[:, lo:hi].T

        for_chunks(work, block.shape[1], _LINES)


def _groups(block: FloatArray, count: int) -> list[slice]:
    if 8 * count * math.prod(block.shape[:3]) <= _TOGETHER:
        return [slice(0, count)]
    return [slice(axis, axis + 1) for axis in range(count)]


def ahead(items: Iterable[T]) -> Iterator[T]:
    """Yield the items; a separate thread produces a few of them in advance."""
    if thread_count() == 1:
        yield from items
        return
    iterator, end, following = iter(items), object(), carried(next)
    with ThreadPoolExecutor(1) as pool:
        coming = deque(pool.submit(following, iterator, end) for _ in range(_AHEAD))
        while (item := coming.popleft().result()) is not end:
            coming.append(pool.submit(following, iterator, end))
            yield item  # type: ignore[misc]
