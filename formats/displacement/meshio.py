"""Displacement tables as surfaces, read by meshio."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path
from typing import Any

import meshio
import numpy as np

from meshdeform_core.errors import FormatError

from .cells import split_cells
from .table import NO_TRIANGLES, DisplacementTable, surface_table

# Corners of two-dimensional cells; nodes on edges and inside follow them.
_CORNERS = {"triangle": 3, "triangle6": 3, "triangle7": 3, "quad": 4, "quad8": 4, "quad9": 4}


def read(path: Path, file_format: str) -> DisplacementTable:
    """Read a surface with displacements as point data.

    Raises
    ------
    FormatError
        When the file is damaged, with meshio's message, or has no displacement.
    """
    try:
        # Not meshio.read, which prints errors and ends the program.
        with contextlib.redirect_stderr(io.StringIO()) as doubts:
            mesh = getattr(meshio, file_format).read(_source(path, file_format))
        if doubts.getvalue():
            # meshio has skipped cells.
            raise ValueError(" ".join(doubts.getvalue().split()))
        triangles = [
            split_cells(np.asarray(block.data), _CORNERS.get(block.type, len(block.data[0])))
            for block in mesh.cells
            if len(block.data) and (block.type in _CORNERS or block.type == "polygon")
        ]
    # On damaged files, meshio's readers raise exceptions of any type.
    except Exception as error:
        reason = str(error) or f"{type(error).__name__}, the file is damaged"
        raise FormatError(f"cannot read {path} as {file_format}: {reason}") from error
    return surface_table(path, mesh.points, mesh.point_data, np.concatenate([NO_TRIANGLES, *triangles]))


def _source(path: Path, file_format: str) -> Any:
    """The source for a reader; meshio's Tecplot reader loops on truncated files unless reading at the end raises."""
    if file_format == "tecplot":
        return _EndingText(path.read_text(encoding="utf-8"))
    return str(path)


class _EndingText(io.StringIO):
    def readline(self, size: Any = -1, /) -> Any:
        return _required(super().readline(size))


def _required(line: str) -> str:
    if not line:
        raise EOFError("the file is truncated")
    return line
