"""Large arrays in files mapped into memory, for grids that do not fit.

The system keeps as much of such a file in memory as there is room; a watch returns the pages to it before the process
exceeds its limit. All loops pass through large arrays from one end to the other, so that each pass reads them once.
Results do not depend on where an array lies.
"""

from __future__ import annotations

import math
import mmap
import os
import threading
import time
import weakref
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any

from ..errors import MethodError

SMALLEST = 1 << 24
"""Bytes from which an array may lie in a file."""
# Bytes below the limit from which on pages are returned, at most half of it: what was seen to be touched between two
# looks on a busy machine.
RESERVE = 384 * 2**20
_SECONDS = 0.01


class Scratch:
    """Where large arrays lie if memory is limited.

    Parameters
    ----------
    folder : for the files; they have no names and vanish with the process, however it ends
    limit : bytes that the process may take, mapped files included
    """

    def __init__(self, folder: Path, limit: int) -> None:
        self._folder = folder
        self._full = max(limit - RESERVE, limit // 2)
        self._maps: list[weakref.ref[mmap.mmap]] = []
        self._lock, self._watched, self._used = threading.Lock(), False, False

    def takes(self, size: int) -> bool:
        """Whether an array of so many bytes lies in a file."""
        return size >= SMALLEST

    def empty(self, shape: Sequence[int], dtype: Any) -> Any:
        """An array in a file; its values are zero.

        Raises
        ------
        MethodError
            When the disk has no room for it.
        """
        import numpy as np

        mapped = self._mapped(math.prod(shape) * np.dtype(dtype).itemsize)
        self._used = True
        with self._lock:
            self._maps = [each for each in self._maps if each() is not None] + [weakref.ref(mapped)]
            if not self._watched:
                self._watched = True
                threading.Thread(target=self._watch, name="scratch", daemon=True).start()
        return np.frombuffer(mapped, dtype).reshape(shape)

    def _mapped(self, size: int) -> mmap.mmap:
        # A tenth of the time of ``--help``.
        import tempfile

        try:
            with tempfile.TemporaryFile(dir=self._folder) as file:
                # Without room a later write to the mapping would end the process by a signal.
                os.posix_fallocate(file.fileno(), 0, size)
                return mmap.mmap(file.fileno(), size)
        except OSError as error:
            raise MethodError(
                f"a grid larger than the memory needs a file of {size / 2**30:.3g} GiB in {self._folder} to work in: "
                f"{error.strerror}; make room there, write the output to another disk, or allow more memory"
            ) from error

    def _watch(self) -> None:
        """Return pages to the system while there are files; ends with the last of them."""
        while True:
            with self._lock:
                maps = [each for each in (one() for one in self._maps) if each is not None]
                if not maps:
                    self._watched = False
                    return
            self.look(maps)
            # The files of arrays that nothing else holds any more are closed.
            del maps
            time.sleep(_SECONDS)

    def look(self, maps: Sequence[mmap.mmap | None] | None = None) -> None:
        """Return pages to the system if there are too many: called by loops too, as a busy system may not wake the
        watch in time."""
        if self._used and resident_memory() > self._full:
            for each in [one() for one in self._maps] if maps is None else maps:
                if each is not None:
                    each.madvise(mmap.MADV_DONTNEED)


def resident_memory() -> int:
    """Bytes of this process that are in memory, mapped files included."""
    with open("/proc/self/statm", "rb") as file:
        return int(file.read().split()[1]) * mmap.PAGESIZE


_scratch: ContextVar[Scratch | None] = ContextVar("scratch", default=None)


def current_scratch() -> Scratch | None:
    """Where large arrays lie; ``None``: in memory."""
    return _scratch.get()


def set_scratch(scratch: Scratch | None) -> None:
    """Let large arrays lie there from now on."""
    _scratch.set(scratch)


@contextmanager
def scratch_in(scratch: Scratch) -> Iterator[None]:
    """Let large arrays made within the block lie there."""
    before = _scratch.set(scratch)
    try:
        yield
    finally:
        _scratch.reset(before)
