"""Choice of the format: by content when reading, by suffix when writing; block sizes; coordinates must be plausible."""

from __future__ import annotations

import dataclasses
import importlib
import os
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from meshdeform_core.errors import FormatError, GridError, MeshDeformError, suggestion
from meshdeform_core.grid import FileFormat, FloatArray, Grid, IntArray, Shape
from meshdeform_core.grid.parts import BlockSizes
from meshdeform_core.numerics.arrays import extent
from meshdeform_core.parallel import ONE_PROCESS, Ranks
from meshdeform_core.wording import listed, vector

from .files import LARGEST, read_head


@dataclass(frozen=True)
class Format:
    """One row of the format table.

    The module defines ``variant(grid, path, options) -> FileFormat``, which decides how to write, by default in
    ``grid.precision``; ``write(grid, path, variant) -> None``, which replaces ``path`` as a whole or leaves it
    unchanged; and, unless it is only written like :mod:`.unstructured`, ``read(path, ranks) -> Grid`` and
    ``layout(path)``, which returns shapes and ``FileFormat`` if the header determines them, otherwise ``None``.
    ``FileFormat``, ``Patch``, ``Window`` and ``Connection`` are in :mod:`meshdeform_core.grid.parts`; a block has the
    coordinates ``grid.block(n)`` (ni, nj, nk, 3).

    ``together``: all ranks call ``write`` and share the work; ``patches``, ``fields``: files hold them;
    ``connections``: how files join blocks, ``declared`` one to one (found from the coordinates if the grid declares
    none), ``merged`` where coincident nodes are one, or not at all.
    """

    module: str
    suffixes: tuple[str, ...]
    title: str
    together: bool = False
    patches: bool = True
    connections: str = "merged"
    fields: bool = False

    def load(self) -> ModuleType:
        return importlib.import_module(f"{__package__}.{self.module}")


FORMATS: dict[str, Format] = {
    "plot3d": Format(
        "plot3d", (".xyz", ".x", ".g", ".p3d", ".p2d", ".fmt", ".p2dfmt", ".p3dfmt", ".p3dbin", ".p2dbin", ".grd",
                   ".bin"), "Plot3D, all variants", together=True, patches=False, connections="",
    ),
    "cgns": Format("cgns", (".cgns", ".hdf", ".hdf5", ".adf"), "CGNS, HDF5 and ADF (ADF read-only)", together=True,
                   connections="declared", fields=True),
    "vtk": Format("vtk", (".vtk", ".vts", ".vtm"), "VTK legacy, .vts, .vtm structured grids", together=True,
                  patches=False, connections="", fields=True),
    "openfoam": Format("openfoam.format", (".foam",), "OpenFOAM: blockMeshDict (read), polyMesh (written)"),
    "meshio": Format("unstructured", (".vtu", ".su2", ".msh", ".inp", ".med"), "unstructured, write-only"),
}  # fmt: skip

_HDF5 = b"\x89HDF\r\n\x1a\n"
# First bytes of files in other formats, which are refused by name instead of being tried as Plot3D.
_FOREIGN: tuple[tuple[bytes, str], ...] = (
    (b"$MeshFormat", "a Gmsh mesh (unstructured)"), (b"NDIME", "an SU2 mesh (unstructured)"),
    (b"#!TDV", "a Tecplot binary file"), (b"CDF\x01", "a netCDF file"), (b"CDF\x02", "a netCDF file"),
    (b"solid ", "an STL surface"), (b"ISO-10303", "a STEP geometry"), (b"\x93NUMPY", "a numpy array"),
    (b"\x89PNG", "a PNG picture"), (b"%PDF", "a PDF document"), (b"\x1f\x8b", "a gzip archive; unpack it first"),
    (b"BZh", "a bzip2 archive; unpack it first"), (b"PK\x03\x04", "a zip or npz archive; unpack it first"),
)  # fmt: skip


def read_grid(path: str | Path, options: Mapping[str, Any] | None = None, ranks: Ranks = ONE_PROCESS) -> Grid:
    """Read a block-structured grid; the format is recognised by the file's content, never by its name.

    ``options`` (of a Plot3D variant) resolve what the content of the file leaves ambiguous. Of several ``ranks``, which
    all call this, each reads its part.

    Raises FormatError when the file is missing, truncated, ambiguous or not a block-structured grid. Raises GridError
    when it contains non-finite coordinates. Raises WholeGridNeeded when the file cannot be read in parts.
    """
    path = Path(path)
    if os.path.islink(path) and not os.path.exists(path):
        raise FormatError(f"{path} is a broken link")
    try:
        path.stat()
    except FileNotFoundError as error:
        raise FormatError(f"{path} does not exist") from error
    except (OSError, ValueError):
        # Other errors of the path are reported when the file is opened.
        pass
    name = format_at(path)
    if options and name != "plot3d":
        raise FormatError(f"{path} is a {name} file, which declares its variant; omit {', '.join(options)}")
    try:
        grid: Grid = FORMATS[name].load().read(path, ranks, **(options or {}))
    except GridError as error:
        raise error if str(path) in str(error) else GridError(f"{path}: {error}") from error
    require_plausible(grid, path)
    return grid


# Number of nodes sampled, and the fraction of them that may have denormal coordinates.
_SAMPLE = 10_000
_MOST_DENORMAL = 0.01
# A node off the line through two others by less than this fraction of their distance lies on it.
_ON_LINE = 1e-13


def require_plausible(grid: Grid, path: Path) -> None:
    """Refuse coordinates that are not finite, implausibly large, or all at one point or on one line."""
    bad: list[IntArray] = []

    def judge(rows: slice) -> None:
        good = np.abs(grid.points[rows]) <= LARGEST
        # numpy is slow on axes of length 3, and this is hardly ever needed.
        if not good.all():
            bad.append(rows.start + np.flatnonzero(~good.all(axis=1)))

    grid.nodes.each(judge)
    found = [rows for own in grid.nodes.gather(bad) for rows in own]
    if found:
        count, first = sum(map(len, found)), min(int(rows[0]) for rows in found)
        point = grid.points[first]
        what = f"beyond {LARGEST:g}" if np.isfinite(point).all() else "not finite numbers"
        raise GridError(
            f"{path} has {count} nodes whose coordinates are {what}; the first is "
            f"{grid.node_label(first)} = {vector(point)}"
        )
    sample = grid.sample(_SAMPLE)
    size = np.abs(sample)
    share = float(((size > 0) & (size < np.finfo(np.float64).tiny)).mean())
    if share > _MOST_DENORMAL:
        raise GridError(
            f"{path}: {share:.0%} of the coordinates are smaller than any normal number ({size[size > 0].min():g}); "
            "they are bits of something else, or in the other byte order"
        )
    if not _on_one_line(sample):
        return
    # A sample is not enough, as it may happen to lie on a grid line.
    grid.nodes.require_whole("a sample of its nodes lies on one line")
    if _on_one_line(grid.points):
        first, (low, high) = grid.points[0], extent(grid.points)
        what = "on one line" if (low < high).any() else f"at one point, {vector(first)}"
        raise GridError(f"{path}: all {grid.n_nodes} nodes lie {what}; a grid needs at least a surface")


def _on_one_line(points: FloatArray) -> bool:
    """Whether all points ``(n, 3)`` lie on the line through the first one and the one farthest from it."""
    offsets = points - points[0]
    lengths = np.linalg.norm(offsets, axis=1)
    farthest = offsets[int(np.argmax(lengths))]
    length = float(lengths.max())
    if length == 0:
        return True
    return bool(np.linalg.norm(np.cross(offsets / length, farthest / length), axis=1).max() < _ON_LINE)


@dataclass(frozen=True)
class Layout(BlockSizes):
    """Blocks ``(ni, nj, nk)`` in nodes and the variant of a grid file."""

    path: Path
    shapes: tuple[Shape, ...]
    format: FileFormat


def layout_of(path: Path, options: Mapping[str, Any] | None = None) -> Layout | None:
    """The blocks of a grid file without its coordinates; ``None`` if they are known only after reading the whole file,
    because of its format or an ambiguous variant.

    ``options`` as for :func:`read_grid`, which reports files that cannot be read.
    """
    module = FORMATS[format_at(path)].load()
    found = module.layout(path, **(options or {})) if hasattr(module, "layout") else None
    return None if found is None else Layout(path, *found)


def read_grid_with_boundaries(
    path: Path, boundary_file: Path | None, options: Mapping[str, Any] | None = None, ranks: Ranks = ONE_PROCESS
) -> Grid:
    """Read a grid; a neutral map file replaces the boundary information of the grid file."""
    grid = read_grid(path, options, ranks)
    if boundary_file is None:
        return grid
    from .neutral_map import read_neutral_map

    return read_neutral_map(boundary_file, grid)


def complete_for_export(grid: Grid, path: Path, options: Mapping[str, Any] | None = None) -> Grid:
    """The grid, ready to be written to ``path`` in a variant: with interfaces found from the coordinates if the format
    holds connections and the grid declares none, and with notes of what it cannot hold: fields, IBLANK and solutions,
    but for fields computed for the file itself (``--field``), and patches that no neutral map file beside it holds."""
    name, source = format_of(path), grid.format.name if grid.format else ""
    blocks = Counter((field.location, field.name, field.values.shape[3:]) for field in grid.fields)
    lost = []
    for field in grid.fields:
        kept, kind = FORMATS[name].fields or (name == "plot3d" and field.blanks), (field.location, field.name)
        if path.suffix.lower() == ".vtu":
            kept = kind[0] in ("node", "cell") and blocks[*kind, field.values.shape[3:]] == grid.n_blocks
        if not kept:
            lost.append(field.name.upper() if field.blanks else field.name)
    names = list(dict.fromkeys(lost))
    if source == "cgns" != name and grid.path is not None:
        from .cgns.format import solutions

        names += solutions(grid.path)
    if names:
        note = f"{path.suffix} files cannot hold these data of the grid, which are not written: {listed(names)}"
        grid = dataclasses.replace(grid, notes=(*grid.notes, note))
    if path.suffix.lower() == ".vtu" and grid.patches and str((options or {}).get("boundary")).lower() != "true":
        lack = f"{path.suffix} files cannot hold the {len(grid.patches)} patches of the grid; add the outside faces"
        grid = dataclasses.replace(grid, notes=(*grid.notes, f"{lack} with their families by --variant boundary=true"))
    if FORMATS[name].connections != "declared" or grid.connections or source == name:
        return grid
    from meshdeform_core.grid.connections import find_interfaces
    from meshdeform_core.grid.topology import find_topology

    return dataclasses.replace(grid, connections=find_interfaces(grid, find_topology(grid)))


def write_grid(grid: Grid, path: str | Path, options: Mapping[str, Any] | None = None) -> FileFormat:
    """Write ``grid``, replacing ``path`` as a whole or leaving it unchanged; returns the variant that was written.

    The suffix selects the format. If it is that of the grid's own file, its variant is kept, except for ``options``
    (of a variant, see ``meshdeform convert --help``). All ranks call it together for a grid in parts.
    """
    path = Path(path)
    variant = variant_of(grid, path, options)
    entry = FORMATS[format_of(path)]
    if not entry.together:
        grid.nodes.require_whole(f"{path} is written as a whole")
    entry.load().write(grid, path, variant)
    return variant


def require_earlier_grid(path: Path, grid: Grid) -> None:
    """Refuse to replace a file that is not an earlier version of ``grid``: one with the same blocks.

    Formats that are only written cannot be checked.
    """
    if not path.exists() or not hasattr(FORMATS[format_of(path)].load(), "read"):
        return
    try:
        same = (layout_of(path) or read_grid(path)).shapes == grid.shapes
    except MeshDeformError:
        same = False
    if not same:
        raise FormatError(
            f"{path} exists and is not a grid of an earlier run; it would be replaced if cells become invalid; "
            f"rename it, choose another output, or use --force"
        )


def variant_of(grid: Grid, path: Path, options: Mapping[str, Any] | None = None) -> FileFormat:
    """The variant in which :func:`write_grid` would write ``grid``."""
    variant: FileFormat = FORMATS[format_of(path)].load().variant(grid, path, dict(options or {}))
    return variant


def format_of(path: Path) -> str:
    """Name of the format given by the suffix of an output."""
    suffix = path.suffix.lower()
    for name, entry in FORMATS.items():
        if suffix in entry.suffixes:
            return name
    known = "; ".join(f"{name}: {' '.join(entry.suffixes)}" for name, entry in FORMATS.items())
    hint = suggestion(suffix, (each for entry in FORMATS.values() for each in entry.suffixes))
    raise FormatError(f"cannot tell the format of {path} from its suffix {suffix!r}; known are {known}{hint}")


def format_at(path: Path) -> str:
    """Name of the format of what is at a path."""
    if path.suffix.lower() == ".foam" or os.path.isdir(path):
        from .openfoam.case import is_case

        if not is_case(path):
            raise FormatError(f"{path} is a folder; expected a grid file, or an OpenFOAM case")
        return "openfoam"
    head = read_head(path)
    if head.startswith(_HDF5) or b"ADF Database Version" in head[:64]:
        return "cgns"
    if head.startswith(b"# vtk DataFile") or b"<VTKFile" in head:
        return "vtk"
    text = head.lstrip()
    # Other formats have neither comments nor these words.
    if text.startswith((b"FoamFile", b"/*", b"//", b"convertToMeters", b"scale", b"vertices")):
        return "openfoam"
    for magic, title in _FOREIGN:
        if text.startswith(magic):
            raise FormatError(f"{path} is {title}, not a block-structured grid (Plot3D, CGNS, VTK or blockMeshDict)")
    # HDF5 may begin behind a user block of any content: 512 bytes, or twice that, and so on.
    with path.open("rb") as stream:
        starts = (512 << n for n in range((path.stat().st_size >> 9).bit_length()))
        behind = any(stream.seek(at) and stream.read(len(_HDF5)) == _HDF5 for at in starts)
    return "cgns" if behind else "plot3d"
