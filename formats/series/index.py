"""Index of a series for ParaView: files by time.

======================  ========================  ==============================================
levels                  index                     read by
======================  ========================  ==============================================
``.vts .vtm .vtu``      ``NAME.pvd``              ParaView's collection reader
``.vtk .cgns``          ``NAME.vtk.series`` ...   ParaView's file series readers (5.5 and later)
Plot3D                  ``NAME.series.p3d``       VTK's Plot3D meta file reader
======================  ========================  ==============================================
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

from meshdeform_core.grid import FileFormat

from ..files import replacing
from ..grids import FORMATS
from ..plot3d.variant import Variant

_COLLECTION = (".vts", ".vtm", ".vtu")
_SERIES = (".vtk", *FORMATS["cgns"].suffixes)


def index_path(folder: Path, stem: str, suffix: str) -> Path | None:
    """Path of the index of levels with this suffix; ``None`` for formats without one."""
    if suffix in _COLLECTION:
        return folder / f"{stem}.pvd"
    if suffix in _SERIES:
        return folder / f"{stem}{suffix}.series"
    if suffix in FORMATS["plot3d"].suffixes:
        return folder / f"{stem}.series.p3d"
    return None


def write_index(path: Path, levels: Sequence[tuple[float, str]], variant: FileFormat) -> None:
    """Write the index of levels, given as time and file name in the same folder, replacing it as a whole.

    ``variant`` is that of the levels: Plot3D files do not declare how to read them.
    """
    if path.suffix == ".pvd":
        text = _collection(levels)
    elif path.suffix == ".p3d":
        names = [{"time": time, "xyz": name} for time, name in levels]
        text = json.dumps({**_plot3d_switches(variant), "filenames": names}, indent=1)
    else:
        files = [{"name": name, "time": time} for time, name in levels]
        text = json.dumps({"file-series-version": "1.0", "files": files}, indent=1)
    with replacing(path) as partial:
        partial.write_text(text + "\n", encoding="utf-8")


def _collection(levels: Sequence[tuple[float, str]]) -> str:
    root = ElementTree.Element("VTKFile", type="Collection", version="0.1")
    collection = ElementTree.SubElement(root, "Collection")
    for time, name in levels:
        ElementTree.SubElement(collection, "DataSet", timestep=repr(time), group="", part="0", file=name)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True)


def _plot3d_switches(variant: FileFormat) -> dict[str, object]:
    plot3d = Variant.of(variant)
    return {
        "auto-detect-format": False,
        "format": "ascii" if plot3d.encoding == "ascii" else "binary",
        "byte-order": plot3d.byte_order or "little",
        "precision": 32 if plot3d.precision == "float32" else 64,
        "multi-grid": plot3d.multiblock,
        "language": "fortran" if plot3d.encoding == "fortran" else "C",
        "blanking": plot3d.iblank,
        "2D": plot3d.dimension == 2,
    }
