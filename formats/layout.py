"""Block sizes from the header of a file, so that the memory of a grid is known before it is read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from meshdeform_core.grid import FileFormat, Shape
from meshdeform_core.grid.sizes import BlockSizes

from .grids import FORMATS, format_at


@dataclass(frozen=True)
class Layout(BlockSizes):
    """Blocks ``(ni, nj, nk)`` in nodes and the variant of a grid file."""

    path: Path
    shapes: tuple[Shape, ...]
    format: FileFormat


def layout_of(path: Path, options: Mapping[str, Any] | None = None) -> Layout | None:
    """The blocks of a grid file without its coordinates; ``None`` if they are known only after reading the whole file,
    because of its format or an ambiguous variant.

    ``options`` as for :func:`.grids.read_grid`, which reports files that cannot be read.

    Raises FormatError when the header is damaged.
    """
    module = FORMATS[format_at(path)].load()
    found = module.layout(path, **(options or {})) if hasattr(module, "layout") else None
    return None if found is None else Layout(path, *found)
