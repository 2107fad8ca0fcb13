"""Memory: available, used, and refusing work that does not fit before it starts."""

from __future__ import annotations

import ctypes
import itertools
import math
import operator
import os
import platform
import re
import shutil
import sys
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from .errors import CaseError, MethodError
from .parallel import ONE_PROCESS, Ranks, current_sharing, set_sharing
from .parallel.scratch import RESERVE, Scratch, resident_memory

if TYPE_CHECKING:
    from .grid.parts import BlockSizes

_UNITS = ("B", "KiB", "MiB", "GiB", "TiB")
VELOCITY_BYTES, SWEPT_BYTES = 48, 96
"""Bytes per node of a series for velocities of nodes and the levels of which they are differences; for what faces
sweep: in two intervals, their combination, and what is written."""
PICTURE_BYTES = 280 * 2**20
"""Bytes for drawing the pictures of a report: up to 273 MiB were measured."""
SMALL = 5 * 2**26
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
    """How much memory a run may take, on each of the ``ranks`` that share it.

    ``size`` in bytes; ``source`` names the limit, like ``--max-memory allows`` or ``the machine has``; ``taken`` is
    what has been set apart already.
    """

    size: int
    source: str
    taken: int = 0
    ranks: Ranks = ONE_PROCESS

    def require(self, needed: int, what: str, instead: str) -> None:
        """Refuse ``what`` by a :class:`.MethodError` if it needs more, which says what to do ``instead``."""
        if needed > self.size:
            # Rounded up: three digits are wrong by at most this.
            enough = readable(1.005 * needed)
            raise MethodError(f"{what} needs about {enough}, {self.source} {readable(self.size)}; {instead}")

    def after(self, taken: int, what: str) -> MemoryLimit:
        """The limit that remains for methods after ``what`` has taken its share."""
        source = f"{self.source}, after {readable(taken)} for {what},"
        return MemoryLimit(max(self.size - taken, 0), source, self.taken + taken, self.ranks)


UNLIMITED = MemoryLimit(2**62, "the machine has")


def parse_memory(text: str, name: str, ranks: Ranks = ONE_PROCESS) -> MemoryLimit:
    """A limit from ``2GiB``, ``500 MB`` or plain bytes; messages call it ``name``."""
    match = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([kmgt]?)(i?)b?\s*", text.lower())
    if not match or not 0 < float(match[1]) < float("inf"):
        raise CaseError(f"{name} {text!r}: expected a size like 2GiB, 500MB or 1000000 (bytes)")
    base = 1024 if match[3] else 1000
    size = int(float(match[1]) * base ** ("", "k", "m", "g", "t").index(match[2]))
    return MemoryLimit(size, f"{name} allows", ranks=ranks)


class Amounts(NamedTuple):
    """Sizes of the grids of a run, or bytes for each of them, which give a total by :meth:`times`.

    Attributes
    ----------
    program : 1; bytes of the program with its libraries and loops
    node, face_node : nodes, and those on block faces
    outside : nodes on outside faces, which are mostly sources
    largest : nodes of the largest block, where blocks are filled as a whole
    source : of radial basis functions, which refuse by themselves what does not fit
    """

    program: float
    node: float
    face_node: float = 0.0
    outside: float = 0.0
    largest: float = 0.0
    source: float = 0.0

    def times(self, sizes: Amounts) -> float:
        """The total for these sizes."""
        # A rank holds what it fills as a whole, even if its part ends within.
        nodes = max(sizes.node, sizes.largest) if self.largest else sizes.node
        return sum(map(operator.mul, self, sizes._replace(node=nodes)))


# All bytes of a stage when it takes most, from the largest resident sizes of runs with .3 to 60 million nodes in 1 to
# 1,000 blocks, to about 15 % (benchmarks/foretold.py).
_MOVING = {
    "tfi": Amounts(188e6, 55, 120, largest=24),
    "idw": Amounts(192e6, 95, 60, 430),
    "idw-tfi": Amounts(192e6, 63, 90, 430),
    "rbf": Amounts(196e6, 77, 55, source=6500),
}
"""While nodes move; other methods, and those with radial basis functions in any step, as ``rbf``."""
_JUDGING = Amounts(196e6, 52, 175, 170)
"""While the grid is judged: faces get roles, lines at walls and interfaces are measured; the method has been freed."""
_FIELDS = Amounts(190e6, 205, 165)
"""While fields of nodes and cells are measured and written."""
_LEVELS = 130
"""Per node of a series: undeformed cells, the two levels before, and the one that is being written."""
_PASSING = Amounts(228e6, 26)
"""Where nothing is deformed, per array of the size of the coordinates."""
_BESIDE_FILES, _IN_FILES = Amounts(232e6, 6, 46), Amounts(0, 52, 38)
"""What is not in files where large arrays are, and their size; the levels of a series are in files but for 50 bytes."""
_BLOCK, _ZONE, _CGNS, _DATA = 26e3, 90e3, 12e6, 3.3
"""During all stages: of a block, of a zone of a CGNS file, which has dozens of nodes in the file, of the libraries for
CGNS, and per byte of data other than coordinates."""
_MPI, _COPY = 37e6, 66
"""On every rank of several: the MPI library, and per node on block faces a copy of the coordinates near it."""
_WINDOW, _PAGES = 8, 4
"""Parts of a limit that pages of files need at least, and usually take."""


class Work(NamedTuple):
    """The stages of some work, and bytes per node that it holds during all of them."""

    stages: tuple[Amounts, ...]
    more: float = 0.0


def deforming(method: str, fields: bool = False, beside: float | None = None) -> Work:
    """A deformation by a method; a repair asks for its own memory when it begins.

    ``fields``: whether any are written; ``beside``: bytes per node for the velocities of a series, ``None`` without.
    """
    first = "rbf" if "rbf" in method else method.split("-")[0]
    moving = _MOVING.get(method) or _MOVING.get(first, _MOVING["rbf"])
    return Work((moving, _JUDGING, *([_FIELDS] if fields else [])), 0.0 if beside is None else _LEVELS + beside)


def passing(arrays: float) -> Work:
    """Work that deforms nothing and takes so many arrays of the size of the coordinates."""
    return Work((_PASSING._replace(node=arrays * _PASSING.node),))


REPAIRING = passing(8.5)
"""A repair of a grid that another program deformed, beside its search, which asks for its own memory."""


@dataclass(frozen=True)
class Demand:
    """The memory that work takes, by the sizes of grids; of several ranks, on the one that takes most.

    ``what`` describes it for messages, such as ``deforming 8,000 nodes``; ``other_bytes`` are those of blocks, of
    libraries, and of data other than coordinates.
    """

    what: str
    work: Work
    sizes: Amounts
    other_bytes: float = 0.0

    @classmethod
    def of(cls, doing: str, work: Work, *grids: BlockSizes, data: int = 0, ranks: Ranks = ONE_PROCESS) -> Demand:
        """The memory that ``doing`` something, such as ``deforming``, with grids takes.

        ``data`` are bytes of point and cell data and displacement tables, which are read, kept and written again.
        """
        faces = sum(grid.n_face_nodes for grid in grids)
        whole = nodes = sum(grid.n_nodes for grid in grids)
        other = _DATA * data
        if ranks.count > 1:
            from .numerics.pieces import bounds_of

            ends = (bounds_of(grid.shapes, ranks.count).tolist() for grid in grids)
            nodes = sum(max(last - first for first, last in itertools.pairwise(each)) for each in ends)
            other += _MPI + _COPY * faces
        for grid in grids:
            in_zones = grid.format is not None and grid.format.name == "cgns"
            other += len(grid.shapes) * (_ZONE if in_zones else _BLOCK) + _CGNS * in_zones
        outside = sum(map(_outside, grids))
        largest = max((math.prod(shape) for grid in grids for shape in grid.shapes), default=0)
        return cls(f"{doing} {whole:,} nodes", work, Amounts(1, nodes, faces, outside, largest), other)

    @property
    def in_memory(self) -> int:
        """Bytes taken if everything is in memory, without the sources, which are known only from coordinates."""
        return self._in_memory(0)

    def _in_memory(self, sources: float) -> int:
        sizes = self.sizes._replace(source=sources)
        taken = max(stage.times(sizes) for stage in self.work.stages)
        return int(taken + self.work.more * sizes.node + self.other_bytes)

    @property
    def _rest(self) -> int:
        """Bytes of what is not in files."""
        return int(_BESIDE_FILES.times(self.sizes) + self.other_bytes)

    def beside_files(self, limit: MemoryLimit) -> int:
        """Bytes taken if large arrays are stored in files (:mod:`.parallel.scratch`). Above the ``limit`` it is the
        smallest limit that is enough."""
        rest = self._rest + RESERVE
        return rest + max(limit.size // _WINDOW, -(-rest // (_WINDOW - 1)))

    @property
    def file_bytes(self) -> int:
        """Bytes of the files of a rank, or of a process alone, if large arrays are stored in files."""
        return int(_IN_FILES.times(self.sizes) + max(self.work.more - 50, 0) * self.sizes.node)

    def foretold(self, limit: MemoryLimit, sources: float) -> tuple[int, int]:
        """Largest resident bytes under a limit with so many sources, which a run does not know when it decides between
        memory and files, and bytes of files; refused is what does not fit in any way."""
        if self.in_memory <= limit.size:
            return min(self._in_memory(sources), limit.size), 0
        limit.require(min(self.in_memory, self.beside_files(limit)), self.what, _INSTEAD)
        return min(self._rest + max(limit.size // _PAGES, RESERVE), limit.size), self.file_bytes

    def left_of(self, limit: MemoryLimit) -> MemoryLimit:
        """The part of ``limit`` that program and grid leave; an error if they leave nothing."""
        needed = self.beside_files(limit) if current_sharing().scratch else self.in_memory
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

        ranks, several = limit.ranks, limit.ranks.on_several_machines
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


def _outside(grid: BlockSizes) -> float:
    """Nodes on outside faces, which only coordinates tell: as if equal cubes formed a cube or, where all blocks have
    the same few layers, one layer of blocks formed a plate."""
    faces, count = grid.n_face_nodes, len(grid.shapes)
    for layers in (set(along) for along in zip(*grid.shapes, strict=True)):
        ends = 2 * grid.n_nodes / max(layers)
        if len(layers) == 1 and faces / 2 < ends < faces:
            return ends + (faces - ends) / count ** (1 / 2)
    return faces / count ** (1 / 3)


def machine_memory(ranks: Ranks = ONE_PROCESS) -> MemoryLimit:
    """Memory available without swapping, as far as the system reports it; several ranks share it equally.

    The smallest share applies to all ranks, as the limit influences what they do and all must do the same.
    """
    source = "the machine has" if ranks.on_machine == 1 else f"each of {ranks.on_machine} ranks on the machine has"
    size = _bytes_in(Path("/proc/meminfo"), "MemAvailable:") or 2**62
    if size == 2**62:
        with suppress(OSError, ValueError, AttributeError):
            size = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return MemoryLimit(min(ranks.gather([size // ranks.on_machine])), source, ranks=ranks)


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
    only). Small processes save the time."""
    with suppress(OSError, AttributeError, TypeError):
        if resident_memory()[0] >= SMALL:
            ctypes.CDLL(None).malloc_trim(0)


def _bytes_in(path: Path, key: str) -> int:
    """The number (KiB) after ``key`` in a system file, as bytes; 0 if there is no such file or key."""
    with suppress(OSError):
        lines = path.read_text(encoding="ascii", errors="replace").splitlines()
        return next((1024 * int(line.split()[1]) for line in lines if line.startswith(key)), 0)
    return 0
