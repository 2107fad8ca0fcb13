"""VTK structured grids: legacy .vtk, XML .vts, and multi-block sets .vtm of .vts files.

All node and cell arrays are kept as fields, with their types, roles and component names; so are field data and extents
that do not begin at 0. Text arrays and lookup tables are dropped, with a note in :attr:`Grid.notes`. VTK files cannot
hold patches and connections. IBLANK of Plot3D is the node array ``iblank``.
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
from .xml_arrays import lz4_block
from .xml_arrays import read as read_xml
from .xml_tags import file_kind
from .xml_write import begin_block as begin_xml_block
from .xml_write import plain

_KINDS = {".vtk": "legacy", ".vts": "vts", ".vtm": "vtm"}

_PRECISIONS = ("float32", "float64")
_LEGACY_OPTIONS: dict[str, tuple[str, ...]] = {"encoding": ("ascii", "binary"), "precision": _PRECISIONS}
_XML_OPTIONS = {
    "encoding": ("ascii", "binary", "appended", "appended-base64"),
    "compression": ("none", "zlib", "lz4", "lzma"),
    "byte_order": ("little", "big"),
    "header_type": ("UInt32", "UInt64"),
    "precision": _PRECISIONS,
}
_OPTIONS: dict[str, dict[str, tuple[str, ...]]] = {"legacy": _LEGACY_OPTIONS, "vts": _XML_OPTIONS, "vtm": _XML_OPTIONS}

_XML_DEFAULTS = {"encoding": "appended", "compression": "none", "byte_order": "little", "header_type": "UInt64"}
_DEFAULTS = {"legacy": {"encoding": "binary"}, "vts": _XML_DEFAULTS, "vtm": _XML_DEFAULTS}


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
    """How to write ``grid`` to ``path``: in its own variant if it is from a file of this kind, else compressed binary.

    ``options``: ``encoding`` is ``ascii``, ``binary`` or, in XML files, ``appended`` (raw) or ``appended-base64``;
    ``precision`` is ``float32`` or ``float64``; XML files have ``compression`` (``none``, ``zlib``, ``lz4``, ``lzma``),
    ``byte_order`` (``little``, ``big``) and ``header_type`` (``UInt32``, ``UInt64``).

    Raises FormatError for unknown options, several blocks in a file for one, or a .vtm whose folder cannot be replaced.
    """
    path = Path(path)
    kind = _KINDS[path.suffix.lower()]
    if kind != "vtm" and grid.n_blocks > 1:
        raise FormatError(f"cannot write {path}: it holds one block, the grid has {grid.n_blocks}; write a .vtm")
    if kind == "vtm":
        require_replaceable(path)
    own = grid.format if isinstance(grid.format, VtkFormat) else VtkFormat("vtk")
    chosen = checked_options(path, options, _OPTIONS[kind])
    switches = {**_DEFAULTS[kind], **(own.options if own.options.get("kind") == kind else {}), "kind": kind, **chosen}
    precision = switches.pop("precision", grid.precision)
    if switches["encoding"] == "ascii" and kind != "legacy":
        if chosen.get("compression", "none") != "none":
            raise FormatError(f"cannot write {path}: ascii is never compressed; choose encoding = appended or binary")
        switches["compression"] = "none"
    if switches.get("compression") == "lz4":
        lz4_block(f"cannot write {path}")
    if not (switches["encoding"] == "binary" if kind == "legacy" else plain(switches)):
        grid.nodes.require_whole(f"{path} is written as text or compressed")
    return VtkFormat("vtk", precision, {"kind": kind, **switches}, own.title, own.origins, own.field_data)


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
