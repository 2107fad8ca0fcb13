"""Checks that grids fit into memory, from the headers of their files."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from meshdeform_core.memory import COORDINATE_ARRAYS, Demand, MemoryLimit, machine_memory, parse_memory

from .options import GridInput, parse_pairs

if TYPE_CHECKING:
    from meshdeform_formats.grids import Layout

_UNPACKED = 6
"""Largest ratio of the memory of coordinates to the size of a compressed file in single precision."""


_SMALL = 1 << 20


def limit_of(text: str | None) -> MemoryLimit:
    """``--max-memory``, or the memory of the machine."""
    return machine_memory() if text is None else parse_memory(text, "--max-memory")


def make_room(
    limit: MemoryLimit,
    doing: str,
    sources: Sequence[GridInput],
    folder: Path | None,
    arrays: float = COORDINATE_ARRAYS,
) -> None:
    """Refuse grids that do not fit, before they are read; large arrays are put into files if they fit in that way.

    Parameters
    ----------
    doing : like ``deforming``
    folder : for these files
    arrays : as large as the coordinates of all ``sources`` together, that the work takes

    Raises
    ------
    MethodError
        Stating the required size.
    """
    there = [source for source in sources if source.path.is_file()]
    size = sum(_bytes_of(source.path) for source in there)
    if Demand("", 0, _UNPACKED * size, arrays=arrays).in_memory <= limit.size:
        Demand("", 0, 0).place(limit, None)
        return
    layouts = [layout_at(source) for source in there]
    known = [layout for layout in layouts if layout is not None]
    if len(known) < len(layouts):
        names = " and ".join(str(source.path) for source in there)
        Demand(f"{doing} {names} (read as a whole)", 0, size, arrays=arrays + 1).place(limit, None)
        return
    Demand.of(doing, *known, arrays=arrays).place(limit, folder)


def too_large(limit: MemoryLimit, source: GridInput, more_arrays: int = 0) -> Layout | None:
    """The blocks of a grid that cannot be deformed in memory; ``None`` for others, and where its header does not
    tell."""
    arrays = COORDINATE_ARRAYS + more_arrays
    if not source.path.is_file():
        return None
    if Demand("", 0, _UNPACKED * _bytes_of(source.path), arrays=arrays).in_memory <= limit.size:
        return None
    layout = layout_at(source)
    return layout if layout and Demand.of("deforming", layout, arrays=arrays).in_memory > limit.size else None


def _bytes_of(path: Path) -> int:
    """Size of a file; for small ones, including the files that they may refer to."""
    from meshdeform_formats.inputs import files_behind

    size = os.path.getsize(path)
    return size if size > _SMALL else sum(os.path.getsize(each) for each in files_behind(path) if each.is_file())


def layout_at(source: GridInput) -> Layout | None:
    """The blocks of a grid file, from its header."""
    from meshdeform_formats.grids import layout_of

    return layout_of(source.path, parse_pairs(source.read_as, "--read-as"))


def temporary_folder() -> Path:
    """Folder for temporary files of commands that write no grid: ``TMPDIR``, or the system's default."""
    return Path(tempfile.gettempdir())
