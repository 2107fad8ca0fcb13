"""Memory: available, used, and refusing work that does not fit before it starts."""

from __future__ import annotations

import ctypes
import mmap
import os
import platform
import re
import shutil
import sys
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from .errors import CaseError, MethodError
from .parallel import current_ranks
from .parallel.scratch import RESERVE, Scratch, current_scratch, resident_memory, set_scratch

_UNITS = ("B", "KiB", "MiB", "GiB", "TiB")
# The program with its libraries: up to 235 MiB were measured, with rbf. Coordinates before and after, displacement, arc
# lengths, topology, fast sums, quality: peaks of 5.4 to 6.4 coordinate arrays were measured with tfi, idw and idw-tfi
# from 2.7 to 21 million nodes, of 7.6 with the earlier levels of a series, 8.1 with all fields and 8.5 with repairs.
PROGRAM_BYTES, COORDINATE_ARRAYS = 240 * 2**20, 9
VELOCITY_ARRAYS, SWEPT_ARRAYS = 2, 4
"""Coordinate arrays for the grid velocity of a series and the levels of which it is a difference; for the volumes swept
by faces: those of two intervals, their combination, and what is written."""
SMOOTHNESS_ARRAYS = 2
"""Coordinate arrays for the two earlier levels of a series from which the acceleration of its nodes is computed."""
WRITING_ARRAYS = 2
"""Coordinate arrays for writing a level while the next one is computed."""
PICTURE_BYTES = 280 * 2**20
"""Bytes for drawing the pictures of a report: up to 273 MiB were measured."""
# With large arrays in files: bytes of everything else per node and per node on block faces; one part in this many of
# the limit is for the pages of the files in use.
_BESIDE_FILES, _PER_FACE_NODE, _WINDOW = 6, 85, 8
# Bytes that the HDF5 library holds for a zone while it is read, and the program for a block: 158 KiB were measured with
# CGNS files, 32 KiB with Plot3D.
_PER_BLOCK = 160 * 2**10
_OTHER_COPIES = 3
# For a rank that holds a part of the grid: largest size of the part relative to the mean, bytes per node on block faces
# for data that all ranks hold (idw-tfi, 4 ranks, 4 to 30 million nodes in one block: 460 to 560 were measured), and
# bytes of the MPI library.
_LARGEST_PART, _PER_SHELL_NODE, _MPI_BYTES = 1.25, 630, 32 * 2**20
_COMPILER = "libllvmlite"
"""Name of the library that compiles loops, and loads those that have been compiled."""
_PER_NODE = 24
"""Bytes of the coordinates."""
SMALL = 2**28
"""Resident bytes of a process whose freed memory is not worth the time to return it."""
_INSTEAD = "allow more, or use a machine that has it"


def readable(size: float) -> str:
    """A size in bytes as text, such as ``1.5 GiB``."""
    unit = 0
    while size >= 1024 and unit < len(_UNITS) - 1:
        size, unit = size / 1024, unit + 1
    return f"{size:.0f} {_UNITS[unit]}" if size >= 999.5 else f"{size:.3g} {_UNITS[unit]}"


@dataclass(frozen=True)
class MemoryLimit:
    """How much memory a run may take.

    ``size`` in bytes; ``source`` names the limit, like ``--max-memory allows`` or ``the machine has``; ``taken`` is
    what has been set apart already.
    """

    size: int
    source: str
    taken: int = 0

    def require(self, needed: int, what: str, instead: str) -> None:
        """Refuse ``what`` if it needs more than the limit.

        Raises
        ------
        MethodError
            Stating the size, the limit and what to do ``instead``.
        """
        if needed > self.size:
            # Rounded up: three digits are wrong by at most this.
            enough = readable(1.005 * needed)
            raise MethodError(f"{what} needs about {enough}, {self.source} {readable(self.size)}; {instead}")

    def after(self, taken: int, what: str) -> MemoryLimit:
        """The limit that remains for methods after ``what`` has taken its share."""
        source = f"{self.source}, after {readable(taken)} for {what},"
        return MemoryLimit(max(self.size - taken, 0), source, self.taken + taken)

    @property
    def spare(self) -> int:
        """Bytes for data that only save time, once a first grid has been made: a quarter, if still available."""
        share = self.size // 4
        return min(share, self.left - share)

    @property
    def left(self) -> int:
        """Bytes that the process may still take beyond its peak so far; everything if nothing has been set apart."""
        return self.size + self.taken - max(self.taken, peak_memory()) if self.taken else self.size


UNLIMITED = MemoryLimit(2**62, "the machine has")


def parse_memory(text: str, name: str) -> MemoryLimit:
    """A limit from ``2GiB``, ``500 MB`` or plain bytes; messages call it ``name``.

    Raises
    ------
    CaseError
        For any other text.
    """
    match = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([kmgt]?)(i?)b?\s*", text.lower())
    if not match or not 0 < float(match[1]) < float("inf"):
        raise CaseError(f"{name} {text!r}: expected a size like 2GiB, 500MB or 1000000 (bytes)")
    base = 1024 if match[3] else 1000
    size = int(float(match[1]) * base ** ("", "k", "m", "g", "t").index(match[2]))
    return MemoryLimit(size, f"{name} allows")


class Sizes(Protocol):
    """Sizes of a grid, or of one of which only the file header has been read."""

    @property
    def n_nodes(self) -> int: ...
    @property
    def n_face_nodes(self) -> int: ...
    @property
    def n_blocks(self) -> int: ...


@dataclass(frozen=True)
class Demand:
    """The memory that work on a grid takes, by its size.

    Attributes
    ----------
    what : description for messages, such as ``deforming 8,000 nodes``
    nodes, face_nodes, blocks : of the grid; ``face_nodes`` on block faces
    coordinate_bytes : size of the coordinates
    arrays : number of arrays of that size that the work takes
    other_bytes : size of point and cell data and displacement tables, which are read, kept and written again
    """

    what: str
    nodes: int
    coordinate_bytes: int
    face_nodes: int = 0
    arrays: float = COORDINATE_ARRAYS
    other_bytes: int = 0
    blocks: int = 0

    @classmethod
    def of(cls, doing: str, *grids: Sizes, arrays: float = COORDINATE_ARRAYS, other_bytes: int = 0) -> Demand:
        """The memory that ``doing`` something, such as ``deforming``, with one or more grids takes."""
        nodes, faces = sum(grid.n_nodes for grid in grids), sum(grid.n_face_nodes for grid in grids)
        blocks = sum(grid.n_blocks for grid in grids)
        return cls(f"{doing} {nodes:,} nodes", nodes, _PER_NODE * nodes, faces, arrays, other_bytes, blocks)

    @property
    def in_memory(self) -> int:
        """Bytes taken if everything is in memory."""
        own = _OTHER_COPIES * self.other_bytes + _PER_BLOCK * self.blocks
        whole = PROGRAM_BYTES + int(self.arrays * self.coordinate_bytes) + own
        # In a small grid, most of the memory of a part is for data that all ranks hold.
        parts = current_ranks().count
        return min(whole, self._of_part(parts)) if parts > 1 else whole

    def _of_part(self, parts: int) -> int:
        """Bytes for a rank that holds one of several parts of the grid, and the data near block faces."""
        part = _LARGEST_PART * self.arrays * self.coordinate_bytes / parts
        shell = _PER_SHELL_NODE * self.face_nodes + _PER_BLOCK * self.blocks
        return PROGRAM_BYTES + _MPI_BYTES + int(part) + shell + _OTHER_COPIES * self.other_bytes

    def beside_files(self, limit: MemoryLimit) -> int:
        """Bytes taken if large arrays are stored in files (:mod:`.parallel.scratch`); of each rank, if several hold
        the grid. Above the ``limit`` it is the smallest limit that is enough."""
        rest = _BESIDE_FILES * self._nodes_of_part + _PER_FACE_NODE * self.face_nodes + _PER_BLOCK * self.blocks
        rest += _OTHER_COPIES * self.other_bytes + _MPI_BYTES * (current_ranks().count > 1)
        rest += PROGRAM_BYTES + RESERVE
        return rest + max(limit.size // _WINDOW, -(-rest // (_WINDOW - 1)))

    @property
    def _nodes_of_part(self) -> int:
        """Most nodes that a rank holds."""
        parts = current_ranks().count
        return int(_LARGEST_PART * self.nodes / parts) if parts > 1 else self.nodes

    @property
    def _in_files(self) -> int:
        """Bytes of the files of a rank, or of a process alone."""
        shell = (_PER_SHELL_NODE - _PER_FACE_NODE) * self.face_nodes if current_ranks().count > 1 else 0
        return 2 * _PER_NODE * self._nodes_of_part + shell

    def left_of(self, limit: MemoryLimit) -> MemoryLimit:
        """The part of ``limit`` that program and grid leave.

        Raises
        ------
        MethodError
            When they leave nothing.
        """
        needed = self.beside_files(limit) if current_scratch() else self.in_memory
        limit.require(needed, self.what, _INSTEAD)
        return limit.after(needed, "program and grid")

    def place(self, limit: MemoryLimit, folder: Path | None) -> None:
        """Store large arrays in files in ``folder``, if given, when they do not fit into memory.

        All ranks that hold the grid decide alike. If they are on several machines, which see ``folder`` through a
        network, each has its files in its own folder for temporary files instead.

        Raises
        ------
        MethodError
            When the rest does not fit into memory either, or the files do not fit on the disk.
        """
        possible = folder is not None and sys.platform == "linux" and self.in_memory > limit.size
        files = _folder_of_rank(folder) if folder and possible else None
        set_scratch(Scratch(files, limit.size) if files else None)
        needed = min(self.in_memory, self.beside_files(limit)) if files else self.in_memory
        limit.require(needed, self.what, _INSTEAD)
        if files:
            _require_disk(self._in_files, self.what, files)


def _folder_of_rank(folder: Path) -> Path:
    """``folder``; of ranks on several machines the local folder for temporary files."""
    # Imported late, as it takes a tenth of the time of ``--help``.
    import tempfile

    return Path(tempfile.gettempdir()) if _on_several_machines() else folder


def _on_several_machines() -> bool:
    return current_ranks().on_machine < current_ranks().count


def _require_disk(size: int, what: str, folder: Path) -> None:
    """Raise an error, the same on all ranks, if a disk has no room for the files, each of ``size`` bytes together, of
    all ranks on its machine."""
    ranks, free = current_ranks(), shutil.disk_usage(folder).free
    machine = f" of {platform.node()}" if _on_several_machines() else ""
    shared = f" for {ranks.on_machine} ranks" if ranks.on_machine > 1 else ""
    needed, lacks = ranks.on_machine * size, list[str]()
    if needed > free:
        lacks.append(
            f"{what} beyond the memory needs files of {readable(needed)}{shared} to work in; the disk of {folder}"
            f"{machine} has {readable(free)} free: make room there, choose another disk, or allow more memory"
        )
    for lack in ranks.gather(lacks):
        raise MethodError(lack)


def machine_memory() -> MemoryLimit:
    """Memory available without swapping, as far as the system reports it; several ranks share it equally.

    The smallest share applies to all ranks, as the limit influences what they do and all must do the same.
    """
    ranks = current_ranks()
    source = "the machine has" if ranks.on_machine == 1 else f"each of {ranks.on_machine} ranks on the machine has"
    return MemoryLimit(min(ranks.gather([_available_memory() // ranks.on_machine])), source)


def _available_memory() -> int:
    available = _first_number(Path("/proc/meminfo"), "MemAvailable:")
    try:
        return available * 1024 if available is not None else os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, AttributeError):
        return 2**62


def peak_memory() -> int:
    """Largest resident size of this process so far, in bytes; 0 where the system does not report it."""
    # On Linux ru_maxrss, unlike VmHWM, includes the size of the parent when the process was started.
    status = _first_number(Path("/proc/self/status"), "VmHWM:")
    if status is not None:
        return status * 1024
    try:
        import resource
    except ImportError:
        return 0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024


def release_freed() -> None:
    """Return to the system, before more memory is taken, what the C library retains of freed memory (GNU C library
    only), and code and constants of the compiler, some 65 MiB, which only loading a loop needs (Linux; they are read
    again then). Small processes save the 4 ms."""
    with suppress(OSError, AttributeError, TypeError):
        if resident_memory() < SMALL:
            return
        library = ctypes.CDLL(None)
        library.malloc_trim(0)
        for begin, end in _as_in_file(_read_only_parts(_COMPILER)):
            library.madvise(ctypes.c_void_p(begin), ctypes.c_size_t(end - begin), mmap.MADV_DONTNEED)


def _read_only_parts(library: str) -> list[tuple[int, int]]:
    """First and one past the last address of the parts of a shared library in this process that are not writable."""
    with open("/proc/self/maps", encoding="utf-8", errors="replace") as maps:
        found = [line.split()[0].split("-") for line in maps if library in line and re.search(" r-.p ", line)]
    return [(int(begin, 16), int(end, 16)) for begin, end in found]


def _as_in_file(parts: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Those of some parts of a library, by their addresses, that can be read from its file again, page by page.

    Pages with addresses, which are filled in when the library is loaded, cannot, though they are read-only afterwards.
    """
    import numpy as np

    found = []
    with open("/proc/self/pagemap", "rb", buffering=0) as pages:
        for begin, end in parts:
            count = (end - begin) // mmap.PAGESIZE
            pages.seek(begin // mmap.PAGESIZE * 8)
            # The highest bits of a page: in memory, swapped, of a file.
            known = np.frombuffer(pages.read(count * 8), dtype=np.uint64) >> 61
            if len(known) == count and ((known == 0b000) | (known == 0b101)).all():
                found.append((begin, end))
    return found


def _first_number(path: Path, key: str) -> int | None:
    """The number (KiB) after ``key`` in a system file; ``None`` if there is no such file or key."""
    try:
        lines = path.read_text(encoding="ascii", errors="replace").splitlines()
    except OSError:
        return None
    return next((int(line.split()[1]) for line in lines if line.startswith(key)), None)
