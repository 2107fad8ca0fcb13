"""Large arrays in files mapped into memory, for grids that do not fit.

The operating system keeps as much of such a file in memory as fits; a watching thread, and the loops themselves,
release pages before the process exceeds its limit. All loops traverse large arrays from one end to the other, so each
pass reads them once. Results do not depend on where an array is stored.
"""

from __future__ import annotations

import math
import mmap
import os
import threading
import time
import weakref
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ..errors import MethodError

SMALLEST = 1 << 24
"""Size in bytes from which an array may be stored in a file."""
# Pages are released when memory comes within this many bytes (at most half the limit) of the limit: as much as was seen
# to be touched between two checks on a busy machine.
RESERVE = 384 * 2**20
# Pages of files are also released when they exceed one part in this many of the limit (at least what is reserved): the
# more memory is free, the longer a busy system may keep the watching thread waiting.
_FILES = 4
_SECONDS = 0.01


class Scratch:
    """Storage of large arrays if memory is limited.

    Parameters
    ----------
    folder : for the files, which have no names and disappear with the process, however it ends
    limit : bytes of memory that the process may use, mapped files included
    """

    def __init__(self, folder: Path, limit: int) -> None:
        self._folder = folder
        self._full, self._files = max(limit - RESERVE, limit // 2), max(limit // _FILES, RESERVE)
        self._maps: list[weakref.ref[mmap.mmap]] = []
        self._lock, self._watched = threading.Lock(), False

    def takes(self, size: int) -> bool:
        """Whether an array of ``size`` bytes is stored in a file."""
        return size >= SMALLEST

    def empty(self, shape: Sequence[int], dtype: Any) -> Any:
        """An array of zeros in a file, with room for all of it on the disk."""
        array, reserve = self.blank(shape, dtype)
        reserve(0, array.nbytes)
        return array

    def blank(self, shape: Sequence[int], dtype: Any) -> tuple[Any, Callable[[int, int], None]]:
        """An array of zeros in a file that takes no room on the disk, and ``reserve(first, last)``, to be called before
        these bytes are written to: if the disk were full, a write to the mapping would end the process by a signal.
        """
        # Imported late, as it takes a tenth of the time of ``--help``.
        import tempfile

        import numpy as np

        size = math.prod(shape) * np.dtype(dtype).itemsize
        with self._errors(size):
            file = tempfile.TemporaryFile(dir=self._folder)  # noqa: SIM115
            file.truncate(size)
            mapped = mmap.mmap(file.fileno(), size)
        weakref.finalize(mapped, file.close)

        def reserve(first: int, last: int) -> None:
            if last > first:
                with self._errors(last - first):
                    os.posix_fallocate(file.fileno(), first, last - first)

        with self._lock:
            self._maps = [each for each in self._maps if each() is not None] + [weakref.ref(mapped)]
            if not self._watched:
                self._watched = True
                threading.Thread(target=self._watch, name="scratch", daemon=True).start()
        return np.frombuffer(mapped, dtype).reshape(shape), reserve

    @contextmanager
    def _errors(self, size: int) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise MethodError(
                f"a grid larger than the memory needs a file of {size / 2**30:.3g} GiB in {self._folder} to work in: "
                f"{error.strerror}; make room there, work on another disk, or allow more memory"
            ) from error

    def _watch(self) -> None:
        """Release pages when needed, as long as there are files."""
        while True:
            with self._lock:
                if all(one() is None for one in self._maps):
                    self._watched = False
                    return
            self.look()
            time.sleep(_SECONDS)

    def look(self) -> None:
        """Release pages if there are too many in memory; also called by loops, as a busy system may not wake the
        watching thread in time."""
        if not self._maps:
            return
        resident, mapped = resident_memory()
        if resident > self._full or mapped > self._files:
            for one in self._maps:
                if (each := one()) is not None:
                    each.madvise(mmap.MADV_DONTNEED)


def resident_memory() -> tuple[int, int]:
    """Bytes of resident memory of this process, and of mapped files in it."""
    with open("/proc/self/statm", "rb") as file:
        resident, mapped = file.read().split()[1:3]
    return int(resident) * mmap.PAGESIZE, int(mapped) * mmap.PAGESIZE
