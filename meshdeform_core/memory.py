"""Memory: available, used, and refusing work that does not fit before it starts."""

from __future__ import annotations

import ctypes
import itertools
import math
import mmap
import operator
import os
import platform
import re
import shutil
import sys
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from .errors import CaseError, MethodError
from .parallel import current_ranks, current_scratch, set_sharing
from .parallel.scratch import RESERVE, Scratch, resident_memory

if TYPE_CHECKING:
    from .grid.parts import BlockSizes

_UNITS = ("B", "KiB", "MiB", "GiB", "TiB")
VELOCITY_BYTES, SWEPT_BYTES = 48, 96
"""Bytes per node of a series for velocities of nodes and the levels of which they are differences; for what faces
sweep: in two intervals, their combination, and what is written."""
PICTURE_BYTES = 280 * 2**20
"""Bytes for drawing the pictures of a report: up to 273 MiB were measured."""
SMALL = 2**28
"""Resident bytes of a process whose freed memory is not worth the time to return it."""
MARGIN = 1.1
"""Work is taken to need this times what its largest stage takes: measured peaks are .9 to 1.1 times that."""
# Bytes of a block, and of a zone of a CGNS file, which has dozens of nodes in the file; of the libraries for CGNS; of
# every rank of several: the MPI library, and per node on block faces a copy of the coordinates near it.
_BLOCK, _ZONE, _CGNS, _MPI, _COPY = 24e3, 110e3, 11e6, 34e6, 60
_OTHER_COPIES = 3
# With large arrays in files: per node coordinates before and after, the verdict and one measure of every cell, and in a
# series what it holds but so much; per node on block faces. Parts of a limit that pages of these files need at least,
# and usually take.
_IN_FILES, _NOT_IN_FILES, _FACES_IN_FILES, _WINDOW, _PAGES = 52, 40, 38, 8, 4
_COMPILER, _COMPILER_BYTES = "libllvmlite", 60e6
"""Name and size of the library that compiles loops and loads those that have been compiled; processes that are not
small return its memory (:func:`release_freed`)."""
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
        """Refuse ``what`` by a :class:`.MethodError` if it needs more, which says what to do ``instead``."""
        if needed > self.size:
            # Rounded up: three digits are wrong by at most this.
            enough = readable(1.005 * needed)
            raise MethodError(f"{what} needs about {enough}, {self.source} {readable(self.size)}; {instead}")

    def after(self, taken: int, what: str) -> MemoryLimit:
        """The limit that remains for methods after ``what`` has taken its share."""
        source = f"{self.source}, after {readable(taken)} for {what},"
        return MemoryLimit(max(self.size - taken, 0), source, self.taken + taken)


UNLIMITED = MemoryLimit(2**62, "the machine has")


def parse_memory(text: str, name: str) -> MemoryLimit:
    """A limit from ``2GiB``, ``500 MB`` or plain bytes; messages call it ``name``."""
    match = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([kmgt]?)(i?)b?\s*", text.lower())
    if not match or not 0 < float(match[1]) < float("inf"):
        raise CaseError(f"{name} {text!r}: expected a size like 2GiB, 500MB or 1000000 (bytes)")
    base = 1024 if match[3] else 1000
    size = int(float(match[1]) * base ** ("", "k", "m", "g", "t").index(match[2]))
    return MemoryLimit(size, f"{name} allows")


class Stage(NamedTuple):
    """Bytes that are in memory when a part of the work takes most, as a sum of parts.

    Attributes
    ----------
    program : of the program with its libraries and loops
    node, face_node : per node, and per node on block faces
    outside : further ones per node on outside faces, which are mostly sources
    largest : per node of the largest block, where blocks are filled as a whole
    source : per source, of radial basis functions, which refuse by themselves what does not fit
    """

    program: float
    node: float
    face_node: float = 0.0
    outside: float = 0.0
    largest: float = 0.0
    source: float = 0.0


# Measured from 0.3 to 12 million nodes in 1 to 1,000 blocks (tests/cli/test_expense.py, benchmarks/large.py).
_RADIAL = Stage(183e6, 70, 50, source=7400)
_MOVING = {
    "tfi": Stage(137e6, 52, 110, largest=22),
    "idw": Stage(139e6, 88, 50, 395),
    "idw-tfi": Stage(139e6, 57, 80, 395),
}
"""While nodes move."""
_JUDGING = Stage(151e6, 49, 185)
"""While the grid is judged: faces get roles, lines at walls and interfaces are measured; the method has been freed."""
_FIELDS = Stage(160e6, 190, 150)
"""While fields of nodes and cells are measured and written."""
_BESIDE_FILES = Stage(241e6, 3.6, 58)
"""What is not in files where large arrays are."""
_LEVELS = 120
"""Bytes per node of a series: undeformed cells, the two levels before, and the one that is being written."""


class Work(NamedTuple):
    """The stages of some work, and bytes per node that it holds during all of them."""

    stages: tuple[Stage, ...]
    more: float = 0.0


def deforming(method: str, fields: bool = False, beside: float | None = None) -> Work:
    """A deformation by a method; a repair asks for its own memory when it begins.

    ``fields``: whether any are written; ``beside``: bytes per node for the velocities of a series, ``None`` of a single
    grid.
    """
    moving = _RADIAL if "rbf" in method else _MOVING.get(method, _MOVING.get(method.split("-")[0], _RADIAL))
    return Work((moving, _JUDGING, *([_FIELDS] if fields else [])), 0.0 if beside is None else _LEVELS + beside)


def passing(arrays: float) -> Work:
    """Work that deforms nothing and takes so many arrays of the size of the coordinates."""
    return Work((Stage(185e6, 24 * arrays),))


REPAIRING = passing(8.5)
"""A repair of a grid that another program deformed, beside its search, which asks for its own memory."""


@dataclass(frozen=True)
class Demand:
    """The memory that work takes, by the sizes of grids; of several ranks, on the one that takes most.

    Attributes
    ----------
    what : description for messages, such as ``deforming 8,000 nodes``
    work : its stages
    nodes, face_nodes : of the grids; those of this rank, and those on all block faces
    outside, largest, sources : what the parts of a stage are multiplied with
    other_bytes : of blocks, of libraries, and of data other than coordinates
    """

    what: str
    work: Work
    nodes: int
    face_nodes: int = 0
    outside: float = 0.0
    largest: int = 0
    sources: int = 0
    other_bytes: float = 0.0

    @classmethod
    def of(cls, doing: str, work: Work, *grids: BlockSizes, data: int = 0, sources: int = 0) -> Demand:
        """The memory that ``doing`` something, such as ``deforming``, with grids takes.

        ``data`` are bytes of point and cell data and displacement tables, which are read, kept and written again.
        """
        ranks, faces = current_ranks().count, sum(grid.n_face_nodes for grid in grids)
        whole = nodes = sum(grid.n_nodes for grid in grids)
        other = float(_OTHER_COPIES * data)
        if ranks > 1:
            from .numerics.pieces import bounds_of

            ends = (bounds_of(grid.shapes, ranks).tolist() for grid in grids)
            nodes = sum(max(last - first for first, last in itertools.pairwise(each)) for each in ends)
            other += _MPI + _COPY * faces
        for grid in grids:
            in_zones = grid.format is not None and grid.format.name == "cgns"
            other += len(grid.shapes) * (_ZONE if in_zones else _BLOCK) + _CGNS * in_zones
        # How much of the block faces lies outside is known only from coordinates: as if equal cubes formed a cube.
        outside = sum(grid.n_face_nodes / len(grid.shapes) ** (1 / 3) for grid in grids)
        largest = max((math.prod(shape) for grid in grids for shape in grid.shapes), default=0)
        return cls(f"{doing} {whole:,} nodes", work, nodes, faces, outside, largest, sources, other)

    @property
    def in_memory(self) -> int:
        """Bytes taken if everything is in memory."""
        size = max(map(self._bytes_of, self.work.stages)) + self.work.more * self.nodes
        return int(MARGIN * max(size, min(size + _COMPILER_BYTES, SMALL)))

    def _bytes_of(self, stage: Stage) -> float:
        # A rank holds what it fills as a whole, even if its part ends within.
        nodes = max(self.nodes, self.largest) if stage.largest else self.nodes
        sizes = 1, nodes, self.face_nodes, self.outside, self.largest, self.sources
        return sum(map(operator.mul, stage, sizes)) + self.other_bytes

    def beside_files(self, limit: MemoryLimit) -> int:
        """Bytes taken if large arrays are stored in files (:mod:`.parallel.scratch`). Above the ``limit`` it is the
        smallest limit that is enough."""
        rest = int(MARGIN * self._bytes_of(_BESIDE_FILES)) + RESERVE
        return rest + max(limit.size // _WINDOW, -(-rest // (_WINDOW - 1)))

    @property
    def file_bytes(self) -> int:
        """Bytes of the files of a rank, or of a process alone, if large arrays are stored in files."""
        per_node = _IN_FILES + max(self.work.more - _NOT_IN_FILES, 0)
        return int(per_node * self.nodes + _FACES_IN_FILES * self.face_nodes)

    def foretold(self, limit: MemoryLimit) -> tuple[int, int]:
        """Largest resident bytes under a limit, which may be too small even for large arrays in files, and those of
        files."""
        # A run decides before it knows its sources; what these take beyond the limit is refused later.
        without = replace(self, sources=0)
        if without.in_memory <= limit.size:
            return min(self.in_memory, limit.size), 0
        limit.require(min(without.in_memory, self.beside_files(limit)), self.what, _INSTEAD)
        pages = max(limit.size // _PAGES, RESERVE)
        return min(int(MARGIN * self._bytes_of(_BESIDE_FILES)) + pages, limit.size), self.file_bytes

    def left_of(self, limit: MemoryLimit) -> MemoryLimit:
        """The part of ``limit`` that program and grid leave; an error if they leave nothing."""
        needed = self.beside_files(limit) if current_scratch() else self.in_memory
        limit.require(needed, self.what, _INSTEAD)
        return limit.after(needed, "program and grid")

    def place(self, limit: MemoryLimit, folder: Path | None) -> None:
        """Store large arrays in files in ``folder``, if given, when they do not fit into memory; an error when the rest
        does not either, or when the disk has no room for the files.

        All ranks that hold the grid decide alike. If they are on several machines, which see ``folder`` through a
        network, each has its files in its own folder for temporary files instead.
        """
        # Imported late, as it takes a tenth of the time of ``--help``.
        import tempfile

        ranks = current_ranks()
        several = ranks.on_machine < ranks.count
        possible = folder is not None and sys.platform == "linux" and self.in_memory > limit.size
        files = (Path(tempfile.gettempdir()) if several else folder) if possible else None
        set_sharing(scratch=Scratch(files, limit.size) if files else None)
        limit.require(min(self.in_memory, self.beside_files(limit)) if files else self.in_memory, self.what, _INSTEAD)
        if files is None:
            return
        needed, free, lacks = ranks.on_machine * self.file_bytes, shutil.disk_usage(files).free, list[str]()
        if needed > free:
            shared = f" for {ranks.on_machine} ranks" if ranks.on_machine > 1 else ""
            lacks.append(
                f"{self.what} beyond the memory needs files of {readable(needed)}{shared} to work in; the disk of "
                f"{files}{f' of {platform.node()}' if several else ''} has {readable(free)} free: make room there, "
                "choose another disk, or allow more memory"
            )
        # The same error on all ranks.
        for lack in ranks.gather(lacks):
            raise MethodError(lack)


def machine_memory() -> MemoryLimit:
    """Memory available without swapping, as far as the system reports it; several ranks share it equally.

    The smallest share applies to all ranks, as the limit influences what they do and all must do the same.
    """
    ranks = current_ranks()
    source = "the machine has" if ranks.on_machine == 1 else f"each of {ranks.on_machine} ranks on the machine has"
    size = _bytes_in(Path("/proc/meminfo"), "MemAvailable:") or 2**62
    if size == 2**62:
        with suppress(OSError, ValueError, AttributeError):
            size = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return MemoryLimit(min(ranks.gather([size // ranks.on_machine])), source)


def peak_memory() -> int:
    """Largest resident size of this process so far, in bytes; 0 where the system does not report it."""
    # On Linux ru_maxrss, unlike VmHWM, includes the size of the parent when the process was started.
    peak = _bytes_in(Path("/proc/self/status"), "VmHWM:")
    if not peak:
        with suppress(ImportError):
            import resource

            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    return peak


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


def _bytes_in(path: Path, key: str) -> int:
    """The number (KiB) after ``key`` in a system file, as bytes; 0 if there is no such file or key."""
    with suppress(OSError):
        lines = path.read_text(encoding="ascii", errors="replace").splitlines()
        return next((1024 * int(line.split()[1]) for line in lines if line.startswith(key)), 0)
    return 0
