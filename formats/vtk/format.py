"""VTK structured grids: legacy .vtk, XML .vts, and multi-block sets .vtm of .vts files.

All node and cell arrays are kept as fields, but no attributes like ``Scalars``, no names of components, and no data of
the whole set, such as its time. Text arrays and lookup tables are dropped, with a note in :attr:`Grid.notes`. VTK files
cannot hold patches and connections. IBLANK of Plot3D is the node array ``iblank``.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import FileFormat, Grid
from meshdeform_core.parallel import ONE_PROCESS, Ranks

from ..files import checked_options, read_head, replacing_by_all
from .dataset import assemble, write_blocks
from .legacy import begin_block as begin_legacy
from .legacy import read as read_legacy
from .multiblock import read as read_set
from .multiblock import require_replaceable
from .multiblock import write as write_set
from .xml_arrays import begin_block as begin_xml
from .xml_arrays import read as read_xml
from .xml_tags import read_tags

_KINDS = {".vtk": "legacy", ".vts": "vts", ".vtm": "vtm"}


def read(path: Path, ranks: Ranks = ONE_PROCESS) -> Grid:
    """Read a VTK file; its kind is recognised by content."""
    if read_head(path).startswith(b"# vtk DataFile"):
        return assemble(path, "legacy", ranks, [read_legacy(path, ranks)])
    file = read_tags(path)
    if file.kind == "vtkMultiBlockDataSet":
        return assemble(path, "vtm", ranks, *read_set(path, ranks))
    return assemble(path, "vts", ranks, [read_xml(file, ranks)])


def variant(grid: Grid, path: Path, options: Mapping[str, Any]) -> FileFormat:
    """How to write ``grid`` to ``path``: as text if it is from a text of this kind, else binary.

    ``options``: ``encoding`` is ``ascii`` or ``binary``, in XML files ``ascii`` or ``appended`` (raw); ``precision`` is
    ``float32`` or ``float64``.
    """
    kind = _KINDS[path.suffix.lower()]
    if kind != "vtm" and grid.n_blocks > 1:
        raise FormatError(f"cannot write {path}: it holds one block, the grid has {grid.n_blocks}; write a .vtm")
    if kind == "vtm":
        require_replaceable(path)
    encodings = ("binary" if kind == "legacy" else "appended", "ascii")
    known = {"encoding": encodings, "precision": ("float32", "float64")}
    chosen = checked_options(f"cannot write {path}", options, known)
    inherited = grid.format.options if grid.format is not None and grid.format.options.get("kind") == kind else {}
    encoding = chosen.get("encoding", inherited.get("encoding"))
    encoding = encoding if encoding in encodings else encodings[0]
    if encoding == "ascii":
        grid.nodes.require_whole(f"{path} is written as text")
    return FileFormat("vtk", chosen.get("precision", grid.precision), {"kind": kind, "encoding": encoding})


def write(grid: Grid, path: Path, variant: FileFormat) -> None:
    """Write ``grid`` in the given variant, replacing ``path`` (and, for .vtm, the folder of its pieces) as a whole."""
    kind = variant.options["kind"]
    if kind == "vtm":
        write_set(grid, path, variant)
        return
    begin = begin_legacy if kind == "legacy" else begin_xml
    with replacing_by_all(path, grid.points) as partial:
        write_blocks(grid, [partial], variant, begin)
