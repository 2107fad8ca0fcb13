"""HDF5 output that survives a full disk.

The HDF5 library cannot close a file whose last bytes it failed to write: it prints errors, keeps the file open, and may
crash the process at exit. It therefore writes through an object that reports no failure to the library; the first
failure is recorded, later writes are dropped, and the failure is raised when the file is closed.
"""

from __future__ import annotations

import io
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
from h5py import h5f

from meshdeform_core import interruption

_BUFFER = 1 << 20


@contextmanager
def hdf5_output(path: Path, mode: str, **options: Any) -> Iterator[h5py.File]:
    """An HDF5 file open for writing: ``mode`` is ``w`` or ``r+``, ``options`` are those of ``h5py.File``.

    Raises OSError at the end of the block, if anything could not be written. Raises FormatError when the library failed
    for another reason.
    """
    raw = _Unfailing(path, "w+" if mode == "w" else mode)
    # The library writes the headers of thousands of nodes one by one, mostly in ascending order.
    sink = io.BufferedRandom(raw, _BUFFER)
    try:
        # An exception from a signal handler must not pass through the library either.
        with interruption.deferred(), h5py.File(sink, mode, **options) as file:
            yield file
    except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
        raise raw.failure or error from error
    finally:
        # A file that could not be closed comes first; h5py identifies it by the object that it was opened with.
        for left in h5f.get_obj_ids(h5f.OBJ_ALL, h5f.OBJ_FILE):
            if left.valid and left.name == repr(sink).encode():
                h5py.File(left).close()
        sink.close()
    if raw.failure is not None:
        raise raw.failure


class _Unfailing(io.FileIO):
    """After the first error of the system, ``failure``, nothing more is written, as if it had been."""

    failure: OSError | None = None

    def write(self, data: Any) -> int:
        if self.failure is None and interruption.requested() is None:
            try:
                return super().write(data)
            except OSError as error:
                self.failure = error
        self.seek(len(data), os.SEEK_CUR)
        return len(data)

    def readinto(self, buffer: Any) -> int:
        """Bytes that were not written are zeros."""
        count = super().readinto(buffer)
        if self.failure is not None:
            buffer[count:] = bytes(len(buffer) - count)
        return count if self.failure is None else len(buffer)

    def truncate(self, size: int | None = None) -> int:
        if self.failure is None:
            try:
                return super().truncate(size)
            except OSError as error:
                self.failure = error
        return self.tell() if size is None else size
