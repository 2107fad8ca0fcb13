"""Whether a grid has room in memory, told before it is read."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from meshdeform_core.memory import COORDINATE_ARRAYS, Demand, MemoryLimit, machine_memory, parse_memory

from .options import GridInput, parse_pairs

if TYPE_CHECKING:
    from meshdeform_formats.layout import Layout

_UNPACKED = 6
"""Coordinates take at most this many times the bytes of their file: in single precision, compressed."""


_SMALL = 1 << 20


def limit_of(text: str | None) -> MemoryLimit:
    """``--max-memory``, or what the machine has."""
    return machine_memory() if text is None else parse_memory(text, "--max-memory")


def make_room(
    limit: MemoryLimit,
    doing: str,
    sources: Sequence[GridInput],
    folder: Path | None,
    arrays: float = COORDINATE_ARRAYS,
) -> None:
    """Refuse grids that do not fit, before they are read; let large arrays lie in files where that makes them fit.

    Parameters
    ----------
    doing : like ``deforming``
    folder : for these files
    arrays : as large as the coordinates of all ``sources`` together, that the work takes

    Raises
    ------
    MethodError
        With the size that is needed.
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
    nodes, faces = sum(each.n_nodes for each in known), sum(each.n_face_nodes for each in known)
    Demand(f"{doing} {nodes:,} nodes", nodes, 24 * nodes, faces, arrays).place(limit, folder)


def too_large(limit: MemoryLimit, source: GridInput) -> Layout | None:
    """The blocks of a grid that cannot be deformed in memory; ``None`` for others, and where its header does not
    tell."""
    if not source.path.is_file() or Demand("", 0, _UNPACKED * _bytes_of(source.path)).in_memory <= limit.size:
        return None
    layout = layout_at(source)
    return layout if layout and Demand("", 0, 24 * layout.n_nodes).in_memory > limit.size else None


def _bytes_of(path: Path) -> int:
    """Size of a file; of a small one, with those that it may refer to."""
    from meshdeform_formats.inputs import files_behind

    size = os.path.getsize(path)
    return size if size > _SMALL else sum(os.path.getsize(each) for each in files_behind(path) if each.is_file())


def layout_at(source: GridInput) -> Layout | None:
    """The blocks of a grid file, from its header."""
    from meshdeform_formats.layout import layout_of

    return layout_of(source.path, parse_pairs(source.read_as, "--read-as"))


def temporary_folder() -> Path:
    """Where commands that write no grid have their files: as ``TMPDIR`` says."""
    return Path(tempfile.gettempdir())
