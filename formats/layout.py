"""Block sizes from the header of a file, so that the memory of a grid is known before it is read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from meshdeform_core.grid import FileFormat, Shape
from meshdeform_core.grid.blocks import face_node_count, node_count

from .grids import FORMATS, format_at


@dataclass(frozen=True)
class Layout:
    """Blocks ``(ni, nj, nk)`` in nodes and the variant of a grid file."""

    path: Path
    shapes: tuple[Shape, ...]
    format: FileFormat

    @property
    def n_nodes(self) -> int:
        return node_count(self.shapes)

    @property
    def n_face_nodes(self) -> int:
        """Nodes on block faces."""
        return face_node_count(self.shapes)

    @property
    def n_blocks(self) -> int:
        return len(self.shapes)

    @property
    def n_cells(self) -> int:
        """The single plane of a 2-D block counts as one layer of cells."""
        return node_count([(max(ni - 1, 1), max(nj - 1, 1), max(nk - 1, 1)) for ni, nj, nk in self.shapes])

    @property
    def dimension(self) -> int:
        """2 if the blocks are planes of nodes, else 3."""
        return 2 if 1 in self.shapes[0] else 3

    @property
    def precision(self) -> str:
        """Floating point type of the coordinates in the file."""
        return self.format.precision


def layout_of(path: Path, options: Mapping[str, Any] | None = None) -> Layout | None:
    """The blocks of a grid file without its coordinates; ``None`` if they are known only after reading the whole file,
    because of its format or an ambiguous variant.

    ``options`` as for :func:`.grids.read_grid`, which reports files that cannot be read.

    Raises
    ------
    FormatError
        When the header is damaged.
    """
    module = FORMATS[format_at(path)].load()
    found = module.layout(path, **(options or {})) if hasattr(module, "layout") else None
    return None if found is None else Layout(path, *found)
