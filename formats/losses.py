"""Data of a grid that the format of an output cannot hold."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from meshdeform_core.grid import Grid
from meshdeform_core.wording import listed

_ALL = ("vtk", "cgns")
_OF_ALL_BLOCKS = (".vtu", ".xdmf")


def losses(grid: Grid, target: Path, kind: str) -> list[str]:
    """Warnings about fields, IBLANK and solutions that are not written to a file ``target`` of the format ``kind``.

    Fields computed for the file itself (``--field``) do not count.
    """
    names = list(dict.fromkeys(_lost_fields(grid, target, kind)))
    if grid.format is not None and grid.format.name == "cgns" and kind != "cgns" and grid.path is not None:
        from .cgns.format import solutions

        names += solutions(grid.path)
    if not names:
        return []
    return [f"{target.suffix} files cannot hold these data of the grid, which are not written: {listed(names)}"]


def _lost_fields(grid: Grid, target: Path, kind: str) -> Iterator[str]:
    everywhere = {
        (field.location, field.name): sum(f.location == field.location and f.name == field.name for f in grid.fields)
        for field in grid.fields
    }
    for field in grid.fields:
        kept = kind in _ALL or (kind == "plot3d" and field.blanks)
        if target.suffix.lower() in _OF_ALL_BLOCKS:
            kept = field.location in ("node", "cell") and everywhere[field.location, field.name] == grid.n_blocks
        if not kept:
            yield field.name.upper() if field.blanks else field.name
