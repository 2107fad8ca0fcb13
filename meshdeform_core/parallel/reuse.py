"""Memory of large arrays that is used again instead of being returned to the system.

The system clears memory before it gives it away. For work at the speed of memory, like the levels of a series by TFI,
that takes as long as the work on it.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

# Smaller arrays come from memory that the C library keeps anyway.
_SMALL = 1 << 20
# Arrays of one size that are kept: a level is written while the next one is computed.
_EACH = 3

_limit = 0
_kept: dict[int, deque[Any]] = {}


@contextmanager
def reusing_memory() -> Iterator[None]:
    """Let :func:`allow` have an effect within the block; what is kept is given back at its end."""
    global _limit
    try:
        yield
    finally:
        _limit = 0
        _kept.clear()


def allow(size: int) -> None:
    """Keep at most ``size`` bytes of arrays that are no longer used, from now on."""
    global _limit
    _limit = size


def uninitialised(shape: Sequence[int], dtype: Any) -> Any:
    """An array of its own, in memory of an earlier one where there is some of that size."""
    # Imported late: the number of threads of linear algebra must be set before numpy is loaded.
    import numpy as np

    kind = np.dtype(dtype)
    size = math.prod(shape) * kind.itemsize
    if size < _SMALL or size > _limit:
        return np.empty(shape, kind)
    try:
        memory = _kept[size].pop()
    except (KeyError, IndexError):
        memory = np.empty(size, np.uint8)
    return np.asarray(_Lease(memory)).view(kind).reshape(shape)


class _Lease:
    """Owner of an array's memory; when the array and all views of it are gone, the memory can be used again."""

    def __init__(self, memory: Any):
        self._memory = memory
        self.__array_interface__ = memory.__array_interface__

    def __del__(self) -> None:
        size = self._memory.nbytes
        # A copy of the values: other threads may add a size.
        held = sum(each * len(memories) for each, memories in list(_kept.items()))
        if held + size <= _limit:
            _kept.setdefault(size, deque(maxlen=_EACH)).append(self._memory)
