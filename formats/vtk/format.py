"""VTK structured grids: legacy .vtk, XML .vts, and multi-block sets .vtm of .vts files.

All node and cell arrays are kept as fields, and so are field data, but no attributes like ``Scalars`` and no names of
components. Text arrays and lookup tables are dropped, with a note in :attr:`Grid.notes`. VTK files cannot hold patches
and connections. IBLANK of Plot3D is the node array ``iblank``.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Grid

from ..files import checked_options, replacing_by_all
from .dataset import VtkFormat, assemble, write_blocks
from .legacy import begin_block as begin_legacy_block
from .legacy import read as read_legacy
from .multiblock import read as read_multiblock
from .multiblock import require_replaceable
from .multiblock import write as write_multiblock
from .xml_arrays import read as read_xml
from .xml_tags import file_kind
from .xml_write import begin_block as begin_xml_block
from .xml_write import plain

_KINDS = {".vtk": "legacy", ".vts": "vts", ".vtm": "vtm"}

_PRECISIONS = ("float32", "float64")
_LEGACY_OPTIONS: dict[str, tuple[str, ...]] = {"encoding": ("binary", "ascii"), "precision": _PRECISIONS}
_XML_OPTIONS: dict[str, tuple[str, ...]] = {
    "encoding": ("appended", "ascii"),
    "compression": ("none", "zlib"),
    "precision": _PRECISIONS,
}
_OPTIONS: dict[str, dict[str, tuple[str, ...]]] = {"legacy": _LEGACY_OPTIONS, "vts": _XML_OPTIONS, "vtm": _XML_OPTIONS}


def read(path: Path) -> Grid:
    """Read a VTK file; its kind is recognised by content.

    Raises FormatError when the file is truncated or damaged, or contains anything but structured grids. Raises
    GridError when a block is a line or a point, or 2-D and 3-D blocks are mixed.
    """
    path = Path(path)
    with path.open("rb") as stream:
        legacy = stream.read(14) == b"# vtk DataFile"
    if legacy:
        return assemble(path, "legacy", [read_legacy(path)])
    kind = file_kind(path)
    if kind == "vtkMultiBlockDataSet":
        data_sets, names = read_multiblock(path)
        return assemble(path, "vtm", data_sets, names)
    return assemble(path, "vts", [read_xml(path)])


def variant(grid: Grid, path: Path, options: Mapping[str, Any]) -> VtkFormat:
    """How to write ``grid`` to ``path``: if it is from a file of this kind, as text or packed as that, else binary.

    ``options``: ``encoding`` is ``ascii`` or ``binary``, in XML files ``ascii`` or ``appended`` (raw); ``precision`` is
    ``float32`` or ``float64``; XML files have ``compression`` (``none`` or ``zlib``).

    Raises FormatError for unknown options, several blocks in a file for one, or a .vtm whose folder cannot be replaced.
    """
    path = Path(path)
    kind = _KINDS[path.suffix.lower()]
    if kind != "vtm" and grid.n_blocks > 1:
        raise FormatError(f"cannot write {path}: it holds one block, the grid has {grid.n_blocks}; write a .vtm")
    if kind == "vtm":
        require_replaceable(path)
    own = grid.format if isinstance(grid.format, VtkFormat) else VtkFormat("vtk")
    known, chosen = _OPTIONS[kind], checked_options(path, options, _OPTIONS[kind])
    inherited = own.options if own.options.get("kind") == kind else {}
    switches = {key: word if (word := inherited.get(key)) in words else words[0] for key, words in known.items()}
    switches |= {"precision": grid.precision, **chosen}
    precision = switches.pop("precision")
    if switches["encoding"] == "ascii" and kind != "legacy":
        if chosen.get("compression", "none") != "none":
            raise FormatError(f"cannot write {path}: ascii is never compressed; choose encoding = appended or binary")
        switches["compression"] = "none"
    if not (switches["encoding"] == "binary" if kind == "legacy" else plain(switches)):
        grid.nodes.require_whole(f"{path} is written as text or compressed")
    return VtkFormat("vtk", precision, {"kind": kind, **switches}, own.field_data)


def write(grid: Grid, path: Path, variant: VtkFormat) -> None:
    """Write ``grid`` in the given variant, replacing ``path`` (and, for .vtm, the folder of its pieces) as a whole.

    Raises FormatError when the file cannot be written, or a field cannot be stored in a VTK file.
    """
    path = Path(path)
    kind = variant.options["kind"]
    if kind == "vtm":
        write_multiblock(grid, path, variant)
        return
    begin = begin_legacy_block if kind == "legacy" else begin_xml_block
    with replacing_by_all(path, grid.points) as partial:
        write_blocks(grid, [partial], variant, begin)
