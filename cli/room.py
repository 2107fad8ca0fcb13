"""Checks that grids fit into memory, from the headers of their files."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from meshdeform_core.memory import Demand, MemoryLimit, Work, machine_memory, parse_memory
from meshdeform_core.parallel.scratch import set_scratch

from .options import GridInput, parse_pairs

if TYPE_CHECKING:
    from meshdeform_formats.grids import Layout

_NODES = 4
"""Bytes of a file that hold one node at most: compressed, in single precision."""

_COORDINATES = 24
_SMALL = 1 << 20


def limit_of(text: str | None) -> MemoryLimit:
    """``--max-memory``, or the memory of the machine."""
    return machine_memory() if text is None else parse_memory(text, "--max-memory")


def make_room(limit: MemoryLimit, doing: str, work: Work, sources: Sequence[GridInput], folder: Path | None) -> None:
    """Refuse grids that do not fit, before they are read; large arrays are put into files if they fit in that way.

    Parameters
    ----------
    doing : like ``deforming``
    folder : for these files

    Raises
    ------
    MethodError
        Stating the required size.
    """
    there = [source for source in sources if source.path.is_file()]
    size = sum(_bytes_of(source.path) for source in there)
    if _at_most(work, size).in_memory <= limit.size:
        set_scratch(None)
        return
    layouts = [layout_at(source) for source in there]
    known = [layout for layout in layouts if layout is not None]
    if len(known) < len(layouts):
        names = " and ".join(str(source.path) for source in there)
        whole = work._replace(more=work.more + _COORDINATES)
        Demand(f"{doing} {names} (read as a whole)", whole, size // _COORDINATES).place(limit, None)
        return
    Demand.of(doing, work, *known).place(limit, folder)


def too_large(limit: MemoryLimit, work: Work, source: GridInput) -> Layout | None:
    """The blocks of a grid that cannot be deformed in memory; ``None`` for others, and where its header does not
    tell."""
    if not source.path.is_file() or _at_most(work, _bytes_of(source.path)).in_memory <= limit.size:
        return None
    layout = layout_at(source)
    return layout if layout and Demand.of("deforming", work, layout).in_memory > limit.size else None


def _at_most(work: Work, size: int) -> Demand:
    """What the grid in a file of this size takes at most: every node may be on a face outside."""
    nodes = size // _NODES
    return Demand("", work, nodes, nodes, nodes, nodes)


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
