"""HDF5 output that survives a full disk.

The HDF5 library cannot close a file whose last bytes it failed to write: it prints errors, keeps the file open, and may
crash the process at exit. It therefore writes through an object that reports no failure to the library; the first
failure is recorded, later writes are dropped, and the failure is raised when the file is closed.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
from h5py import h5f

from meshdeform_core import interruption

_MOST = 1 << 20
"""Largest number of bytes buffered to be written together."""


@contextmanager
def hdf5_output(path: Path, mode: str, **options: Any) -> Iterator[h5py.File]:
    """An HDF5 file open for writing: ``mode`` is ``w`` or ``r+``, ``options`` are those of ``h5py.File``.

    Raises
    ------
    OSError
        At the end of the block, if anything could not be written.
    FormatError
        When the library failed for another reason.
    """
    with target(path, mode) as sink, h5py.File(sink, mode, **options) as file:
        yield file


@contextmanager
def target(path: Path, mode: str) -> Iterator[Sink]:
    """A file object that ``h5py.File`` accepts instead of a path, for libraries that open the file themselves."""
    sink = Sink(path, mode)
    try:
        # An exception from a signal handler must not pass through the library either.
        with interruption.deferred():
            yield sink
    except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
        raise sink.failure or error from error
    finally:
        _close(sink)
    if sink.failure is not None:
        raise sink.failure


def _close(sink: Sink) -> None:
    """Close the file, after any HDF5 files left open on it."""
    # h5py identifies a file by the object that it was opened with.
    name = repr(sink).encode()
    for left in h5f.get_obj_ids(h5f.OBJ_ALL, h5f.OBJ_FILE):
        if left.valid and left.name == name:
            h5py.File(left).close()
    sink.close()


class Sink:
    """A file object for ``h5py.File``; after the first error of the system, ``failure``, nothing more is written."""

    def __init__(self, path: Path, mode: str):
        flags = os.O_RDWR | getattr(os, "O_BINARY", 0) | (os.O_CREAT | os.O_TRUNC if mode == "w" else 0)
        self._file = os.open(path, flags, 0o666)
        self._at = 0
        # The library writes the headers of thousands of nodes one by one, mostly in ascending order.
        self._begin, self._waiting = 0, bytearray()
        self.failure: OSError | None = None

    def close(self) -> None:
        self.flush()
        os.close(self._file)

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        if whence == os.SEEK_END:
            self.flush()
        start = {os.SEEK_SET: 0, os.SEEK_CUR: self._at}.get(whence)
        self._at = offset + (os.fstat(self._file).st_size if start is None else start)
        return self._at

    def tell(self) -> int:
        return self._at

    def readinto(self, buffer: Any) -> int:
        """Fill ``buffer``; dropped bytes read as zeros."""
        self.flush()
        view = memoryview(buffer).cast("B")
        done = 0
        os.lseek(self._file, self._at, os.SEEK_SET)
        while done < len(view) and (data := os.read(self._file, len(view) - done)):
            view[done : done + len(data)] = data
            done += len(data)
        view[done:] = bytes(len(view) - done)
        self._at += len(view)
        return len(view)

    def write(self, buffer: Any) -> int:
        view = memoryview(buffer).cast("B")
        if self._at != self._begin + len(self._waiting) or len(self._waiting) > _MOST:
            self.flush()
        if not self._waiting:
            self._begin = self._at
        if len(view) > _MOST:
            self.flush()
            self._put(view, self._at)
        else:
            self._waiting += view
        self._at += len(view)
        return len(view)

    def flush(self) -> None:
        """Write the buffered bytes."""
        if self._waiting:
            self._put(memoryview(self._waiting), self._begin)
        self._waiting = bytearray()

    def _put(self, view: memoryview, at: int) -> None:
        if self.failure is None and interruption.requested() is None:
            try:
                os.lseek(self._file, at, os.SEEK_SET)
                done = 0
                while done < len(view):
                    done += os.write(self._file, view[done:])
            except OSError as error:
                self.failure = error

    def truncate(self, size: int | None = None) -> int:
        self.flush()
        size = self._at if size is None else size
        if self.failure is None:
            try:
                os.ftruncate(self._file, size)
            except OSError as error:
                self.failure = error
        return size

    def read(self, size: int) -> bytes:
        data = bytearray(size)
        self.readinto(data)
        return bytes(data)
