"""CGNS: structured zones in HDF5 (read and written) and in ADF (read).

A grid from a CGNS file is written as a copy of that file in which only the coordinates change; other grids are written
as new files. Coordinates keep their precision unless ``precision=float32|float64`` changes it. A file with both
precisions counts as float32, because that limits how accurately its nodes coincide.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import FileFormat, Grid, Planes, Shape
from meshdeform_core.parallel import ONE_PROCESS, Ranks

from ..files import checked_options
from ..planes import ranges_of, read_planes
from .boundary import zone_connections, zone_patches
from .tree import is_adf
from .zone import Notes, Zone, base_and_zones, naming, opened_cgns

# The options of files whose zones have both precisions.
_MIXED = {"precision": "mixed"}


def linked_files(path: Path) -> Iterator[Path]:
    """The files that the links of a CGNS file lead to; links are not followed, so that circular links end."""
    if not is_adf(path):
        from .hdf5 import external_targets

        yield from external_targets(path)
        return
    from .adf import read_adf

    waiting = [read_adf(path)]
    while waiting:
        for child in waiting.pop().children:
            if child.link is None:
                waiting.append(child)
            elif child.link.file and not child.dangling:
                yield child.target.file


def read(path: Path, ranks: Ranks = ONE_PROCESS) -> Grid:
    """Read the structured zones of a CGNS file as blocks, in file order, with their names.

    Patches are named after the BC_t, families after FamilyName. Coordinates are in the file's length unit, given in
    ``Grid.notes`` if the file declares it; z is zero if the file has only x and y.
    """
    notes = Notes()
    with naming(path), opened_cgns(path) as root:
        base, zones = base_and_zones(root, notes)
        places = [zone.places() for zone in zones]
        if not all(places):
            ranks.require_one(f"coordinates in {path} are compressed or stored in pieces")
        nodes = base.node.labelled("Family_t")
        families = {node.name: condition.text() for node in nodes for condition in node.labelled("FamilyBC_t")[:1]}
        patches = [p for block, zone in enumerate(zones) for p in zone_patches(zone, block, families, notes)]
        names, kind = [zone.name for zone in zones], _format(path, zones)
        rest = {"patches": tuple(patches), "path": path}
        grid = Grid.allocate([zone.shape for zone in zones], names, ranks, format=kind, **rest)
        # Zones that are compressed or stored in pieces are read as a whole, others in ranges of planes.
        parts = []
        for block, (shape, known) in enumerate(zip(grid.shapes, places, strict=True)):
            parts += ranges_of([(block, shape)]) if known else [Planes(block, 0, shape[2])]

        def put(part: Planes) -> None:
            if known := places[part.block]:
                read_planes(grid, part, known)
            else:
                zones[part.block].read(grid.in_planes(part.block))

        grid.fill_planes(put, parts, threads=None if all(places) else 1)
        connections, overset = zone_connections(base, zones, grid, notes)
    return dataclasses.replace(grid, connections=tuple(connections), overset=overset, notes=notes.lines())


def layout(path: Path) -> tuple[tuple[Shape, ...], FileFormat]:
    """Nodes of the zones of a file, without their coordinates; errors as for :func:`read`."""
    with naming(path), opened_cgns(path) as root:
        zones = base_and_zones(root)[1]
        return tuple(zone.shape for zone in zones), _format(path, zones)


def solutions(path: Path) -> list[str]:
    """Names of the flow solutions in the zones of a file, each once."""
    with naming(path), opened_cgns(path) as root:
        children = (child for zone in base_and_zones(root)[1] for child in zone.node.target.children)
        found = (child.name for child in children if child.target.label == "FlowSolution_t")
        return list(dict.fromkeys(found))


def variant(grid: Grid, path: Path, options: Mapping[str, Any]) -> FileFormat:
    """How ``grid`` will be written to ``path``: HDF5, in the precision of ``options`` or else of the grid's file."""
    chosen = checked_options(f"cannot write {path}", options, {"precision": ("float32", "float64")})
    if path.suffix.lower() == ".adf":
        raise FormatError(f"cannot write {path}: ADF can only be read; use the suffix .cgns, which is written as HDF5")
    mixed = not chosen and grid.format is not None and grid.format.options.items() >= _MIXED.items()
    options = {"container": "HDF5"} | (_MIXED if mixed else {})
    return FileFormat("cgns", chosen.get("precision", grid.precision), options)


def write(grid: Grid, path: Path, variant: FileFormat) -> None:
    """Write ``grid``, replacing ``path`` as a whole or leaving it unchanged; on all ranks."""
    # Imported here because reading ADF needs no HDF5.
    from .output import write_copy, write_new

    if grid.path is not None and grid.format is not None and grid.format.name == "cgns":
        write_copy(grid, path, None if "precision" in variant.options else variant.precision)
    else:
        write_new(grid, path, variant.precision)


def _format(path: Path, zones: Sequence[Zone]) -> FileFormat:
    sizes = {array.target.dtype.itemsize for zone in zones for array in zone.coordinates if array.target.dtype}
    options = {"container": "ADF" if is_adf(path) else "HDF5"} | (_MIXED if len(sizes) > 1 else {})
    return FileFormat("cgns", "float32" if 4 in sizes else "float64", options)
