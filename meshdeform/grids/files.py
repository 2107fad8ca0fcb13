"""Grids in files."""

from __future__ import annotations

from pathlib import Path

from meshdeform_core.errors import FormatError, GridError

from .grid import Grid


def read(path: str | Path, *, boundary_file: str | Path | None = None, **variant: str) -> Grid:
    """Read a block-structured grid: Plot3D, CGNS, VTK or a blockMeshDict of OpenFOAM, recognised by its content.

    Parameters
    ----------
    boundary_file : NASA neutral map file with the boundaries, for formats that hold none
    variant : how to read an ambiguous Plot3D file, like ``byte_order="big"`` (see docs/formats.md)

    Raises
    ------
    FormatError, GridError
        When the file is missing, damaged, ambiguous or not a block-structured grid.
    """
    from meshdeform_formats.grids import read_grid_with_boundaries

    boundaries = None if boundary_file is None else _path(boundary_file)
    return Grid._of(read_grid_with_boundaries(_path(path), boundaries, variant))


def write(grid: Grid, path: str | Path, *, force: bool = False, **variant: str) -> None:
    """Write a grid; the suffix selects the format. By default the variant is that of the file the grid was read from.

    The file is replaced as a whole or, if anything fails, left untouched.

    Parameters
    ----------
    grid : if it is in parts, all ranks call this together, and each writes its part
    force : overwrite an existing file; the file that the grid was read from is never overwritten
    variant : format variant, like ``encoding="ascii"`` (see docs/formats.md)

    Raises
    ------
    FormatError
        When the file exists, cannot be written, or the format has no such variant.
    """
    from meshdeform_formats.grids import complete_for_export, write_grid

    if not isinstance(grid, Grid):
        raise GridError(f"found a {type(grid).__name__}; expected a Grid to write")
    target, own = _path(path), grid._core
    if target.exists():
        if own.path is not None and own.path.exists() and target.samefile(own.path):
            raise FormatError(f"{target} is the file that the grid was read from; choose another name")
        if not force:
            raise FormatError(f"{target} exists; choose another name, or force=True to overwrite it")
    with grid._together():
        write_grid(complete_for_export(own, target), target, variant)


def _path(path: object) -> Path:
    if not isinstance(path, str | Path):
        raise FormatError(f"file name {path!r} is a {type(path).__name__}; expected a string or a Path")
    if "\0" in str(path):
        raise FormatError(f"file name {str(path)!r} has a null character; expected the name of a file")
    return Path(path)
