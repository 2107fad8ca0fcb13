"""Displacement tables: the displacements of the points of a surface.

A file is a table if it has displacements: text columns, arrays (.npy, .npz, HDF5), or a surface with a vector at its
points, preferably one called displacement. A structured grid (Plot3D, CGNS, VTK) is a table only if every block has a
node array called ``displacement``, ``disp`` or ``deformation``. Otherwise its coordinates are the deformed positions of
the same nodes, whatever solution (``U``, ...) it contains.
"""

from __future__ import annotations

import importlib
from pathlib import Path
from types import ModuleType

import numpy as np

from meshdeform_core.boundary.tables import SurfaceData
from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Grid, OwnPlanes
from meshdeform_core.parallel import WholeGridNeeded, alone

from ..files import read_head, replacing
from ..grids import FORMATS, read_grid
from .table import VECTOR_NAMES, DisplacementTable, checked_surface, grid_triangles, pick_vector

# meshio's formats that can hold a displacement at points, by suffix; others are recognised by a magic number.
_MESHIO_FORMATS = {
    ".avs": "avsucd", ".dat": "tecplot", ".med": "med", ".msh": "gmsh", ".ply": "ply", ".tec": "tecplot",
    ".xdmf": "xdmf", ".xmf": "xdmf",
}  # fmt: skip
_TEXT_SUFFIXES = (".csv", ".txt", ".dat", ".tsv")


def read_displacement(path: str | Path) -> SurfaceData | Grid:
    """Read a displacement table, or a grid that holds the deformed position of the same nodes.

    Files are recognised by content where possible; text files by suffix: ``.csv``, ``.txt``, ``.dat`` and ``.tsv`` are
    columns of numbers, the suffixes of Plot3D are grids, others are read by meshio.

    Raises FormatError when the file is damaged or has no displacement (with what was found), numbers are not finite, or
    a point has two displacements (with both lines).
    """
    path = Path(path)
    table = _table_or_grid(path, read_head(path))
    return table if isinstance(table, Grid) else checked_surface(table, path)


def write_displacement(path: str | Path, data: SurfaceData) -> None:
    """Write a table as text (``.csv``, exact) or ``.npz`` (with triangles), replacing ``path`` as a whole.

    Raises FormatError for another suffix, or when the file cannot be written.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in (".csv", ".npz"):
        raise FormatError(f"cannot write {path}: displacement tables can be written as .csv or .npz")
    with replacing(path) as partial:
        if suffix == ".npz":
            np.savez(partial, points=data.points, displacement=data.displacement, triangles=data.triangles)
        else:
            columns = np.hstack([data.points, data.displacement])
            np.savetxt(partial, columns, fmt="%.17g", delimiter=",", header="x,y,z,dx,dy,dz", comments="")


def _table_or_grid(path: Path, head: bytes) -> DisplacementTable | Grid:
    suffix, words = path.suffix.lower(), head.lower()
    if head.startswith(b"\x93NUMPY"):
        return _module("arrays").read_npy(path)
    if head.startswith(b"PK\x03\x04"):
        return _module("arrays").read_npz(path)
    if head.startswith(b"\x89HDF\r\n\x1a\n"):
        entries = _module("arrays").hdf5_entries(path)
        if "ENS_MAA" in entries:
            return _module("meshio").read(path, "med")
        return _read_structured(path) if "CGNSLibraryVersion" in entries else _module("arrays").read_hdf5(path)
    if head.startswith(b"# vtk DataFile") or b"<VTKFile" in head:
        from ..vtk.legacy import dataset_kind
        from ..vtk.xml_tags import file_kind

        if head.startswith(b"# vtk DataFile"):
            kind = dataset_kind(path)
            if kind == "UNSTRUCTURED_GRID":
                return _module("meshio").read(path, "vtk")
            return _module("vtk").read_vtk_legacy(path) if kind == "POLYDATA" else _read_structured(path)
        kind = file_kind(path)
        if kind in ("PPolyData", "PUnstructuredGrid"):
            raise FormatError(f"{path} is the index of a parallel data set; expected its pieces merged into one file")
        return _module("vtk").read_vtk_xml(path) if kind in ("PolyData", "UnstructuredGrid") else _read_structured(path)
    if suffix in _TEXT_SUFFIXES and not (b"variables" in words and b"zone" in words):
        # With both words it is Tecplot's.
        return _module("text").read(path)
    if b"ADF Database Version" in head[:64] or suffix in FORMATS["plot3d"].suffixes:
        return _read_structured(path)
    if suffix == ".frd":
        return _module("frd").read(path)
    if suffix not in _MESHIO_FORMATS:
        known = " ".join(sorted({*_MESHIO_FORMATS, ".frd"}))
        called = f"with suffix {suffix}" if suffix else "without suffix"
        raise FormatError(
            f"{path}: a file {called} is not a displacement table; expected text "
            f"({' '.join(_TEXT_SUFFIXES)}), .npz, .npy, HDF5, VTK, {known}, or a grid"
        )
    return _module("meshio").read(path, _MESHIO_FORMATS[suffix])


def _module(name: str) -> ModuleType:
    """A reader, imported when first needed: importing h5py and meshio is slow."""
    return importlib.import_module(f"{__package__}.{name}")


def _read_structured(path: Path) -> DisplacementTable | Grid:
    try:
        grid = read_grid(path)
        if any(isinstance(field.values, OwnPlanes) for field in grid.fields):
            raise WholeGridNeeded("an array that may be a displacement")
    except WholeGridNeeded:
        # Every rank looks displacements up by itself.
        with alone():
            grid = read_grid(path)
    known = []
    for block in range(grid.n_blocks):
        fields = [field for field in grid.fields if field.block == block and field.location == "node"]
        values = pick_vector(VECTOR_NAMES, {f.name: f.values.reshape(-1, *f.values.shape[3:]) for f in fields})
        known += [] if values is None else [values]
    if len(known) < grid.n_blocks:
        return grid
    numbers = np.arange(grid.n_nodes)
    triangles = [
        grid_triangles(numbers[low:high].reshape(shape))
        for low, high, shape in zip(grid.offsets, grid.offsets[1:], grid.shapes, strict=False)
    ]
    return DisplacementTable(grid.points, np.concatenate(known), np.concatenate(triangles), grid.node_label)
