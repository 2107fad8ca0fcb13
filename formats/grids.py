"""Which module reads and writes which file: by content when reading, by suffix when writing."""

from __future__ import annotations

import dataclasses
import importlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import FileFormat, Grid

from .files import replacing


@dataclass(frozen=True)
class Format:
    """One row of the format table.

    The module offers ``read(path) -> Grid``, ``write(grid, target, format) -> None`` (``target`` is a temporary path
    with the final suffix) and ``variant(suffix, grid, like, options) -> FileFormat``, which decides how to write.
    """

    module: str
    suffixes: tuple[str, ...]
    title: str

    def load(self) -> ModuleType:
        return importlib.import_module(f"{__package__}.{self.module}")


FORMATS: dict[str, Format] = {
    "plot3d": Format(
        "plot3d",
        (".xyz", ".x", ".g", ".p3d", ".p2d", ".fmt", ".p2dfmt", ".p3dfmt", ".p3dbin", ".p2dbin", ".grd", ".bin"),
        "Plot3D, all variants",
    ),
    "cgns": Format("cgns", (".cgns", ".hdf", ".hdf5", ".adf"), "CGNS, HDF5 and ADF (ADF is read only)"),
    "vtk": Format("vtk", (".vtk", ".vts", ".vtm"), "VTK legacy, .vts and .vtm structured grids"),
    "meshio": Format("meshio_export", (".vtu", ".su2", ".msh", ".inp", ".xdmf", ".med"), "unstructured, write only"),
}
