"""OpenFOAM: blockMeshDict files are read."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from meshdeform_core.grid import FileFormat, Grid

from .block_mesh import read_block_mesh
from .case import dictionary_of, is_case


def read(path: Path) -> Grid:
    """Read a blockMeshDict: the file itself, or a case (folder or ``.foam`` file) that has one.

    Patches keep their names, which are their families, too, and their types; cyclic patches become periodic
    connections. Coordinates are in metres.

    Raises
    ------
    FormatError
        When there is no blockMeshDict, or it is damaged, or it uses what is not supported.
    """
    path = Path(path)
    source = dictionary_of(path) if is_case(path) else path
    grid = read_block_mesh(source)
    return dataclasses.replace(grid, format=FileFormat("openfoam", "float64", {"kind": "blockMeshDict"}), path=path)
