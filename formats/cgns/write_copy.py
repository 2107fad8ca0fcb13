"""Write a grid that came from a CGNS file: a copy of that file in which only the coordinates change.

The reader leaves existing fields in the file; fields of the grid are new ones and become flow solutions.
"""

from __future__ import annotations

import dataclasses
import os
import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path

import h5py
import numpy as np

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import FloatArray, Grid
from meshdeform_core.grid.planes import block_extents

from ..hdf5_output import hdf5_output
from ..planes import Stored, split
from .adf import is_adf
from .file import naming, opened_cgns
from .hdf5 import DATA, LINK, LINK_FILE, external_links, hdf5_errors, place_of
from .hdf5_write import characters, has_other_names, own_group, put_node, reserve_dataset, write_hdf5
from .tree import Node, data_type_of, unique_names
from .write_new import Places, fields_by_place, solution_nodes, write_completed
from .zone import Base, Zone, base_and_zones

Boxes = Callable[[], tuple[FloatArray, FloatArray]]
"""Returns the lowest and highest coordinates (n_blocks, 3) of blocks."""


def write_copy(grid: Grid, path: Path, precision: str | None) -> None:
    """Copy the CGNS file of ``grid`` to ``path`` with the grid's coordinates, in ``precision`` or that of each array.

    All other nodes, attributes, links and their order are kept; an ADF file becomes HDF5. With the coordinates, links
    to them become arrays of this file, relative names of linked files are adapted to a new folder, and bounding boxes
    stored with the coordinates are updated.
    """
    source = grid.path
    if source is None or not source.is_file():
        raise FormatError(f"cannot write {path}: {source}, whose other contents are to be copied, no longer exists")
    boxes = cache(lambda: block_extents(grid))
    if grid.nodes.divided:
        # The first rank alone cannot find them.
        boxes()
    write_completed(grid, path, lambda partial: _prepared_copy(grid, source, path, partial, precision, boxes))


def _prepared_copy(grid: Grid, source: Path, path: Path, partial: Path, precision: str | None, boxes: Boxes) -> Places:
    """Write everything but the values of nodes, cells and faces; returns the places of these."""
    with opened_cgns(source) as root:
        with naming(source):
            base, zones = _same_zones(root, grid, source, boxes)
        with hdf5_errors(path, "write"):
            if is_adf(source):
                write_hdf5(root, partial)
            else:
                shutil.copyfile(source, partial)
            with hdf5_output(partial, "r+") as file:
                _adapt_links(file, source.parent, path.parent)
                group = own_group(file, base.node)
                owns = [own_group(group, zone.node) for zone in zones]
                # Coordinate arrays: compressed ones are filled, of the others the places are noted.
                places = Places(partial)
                for block, (parent, zone) in enumerate(zip(owns, zones, strict=True)):
                    group = own_group(parent, zone.grid)
                    datasets = [
                        _writable_dataset(own_group(group, node), precision, zone.counts) for node in zone.coordinates
                    ]
                    starts = [place_of(each.id, each.dtype) for each in datasets]
                    found = [
                        Stored.within_rind(
                            partial, each.dtype, each.shape[::-1], start, zone.core, each.id.get_storage_size()
                        )
                        for start, each in zip(starts, datasets, strict=True)
                        if start is not None
                    ]
                    if len(found) == len(datasets):
                        places.coordinates[block] = found
                    else:
                        for dataset, values in zip(
                            datasets, split(grid.block(block), np.dtype(float), len(datasets)), strict=True
                        ):
                            dataset[zone.core[::-1]] = values.reshape(zone.counts[::-1]).astype(
                                dataset.dtype, copy=False
                            )
                    if zone.grid.target.dims == (len(datasets), 2):
                        # GridCoordinates_t may hold the lowest and highest coordinates (SIDS 7.1).
                        box = np.array([end[block] for end in boxes()])
                        group[DATA][...] = box[:, : len(datasets)]
                # Make room for fields as flow solutions. One with the same arrays, from an earlier run, is replaced.
                numbers = fields_by_place(grid)
                for block, (parent, zone) in enumerate(zip(owns, zones, strict=True)):
                    for solution in solution_nodes(grid, block, zone.counts, numbers, places):
                        arrays = {child.name for child in solution.children}
                        others = [
                            old.name
                            for old in zone.node.target.children
                            if old.target.label != solution.label
                            or {child.name for child in old.target.children} != arrays
                        ]
                        (name,) = unique_names([solution.name], solution.name, others)
                        put_node(parent, dataclasses.replace(solution, name=name))
    return places


def _same_zones(root: Node, grid: Grid, source: Path, boxes: Boxes) -> tuple[Base, list[Zone]]:
    """The zones of the source file, which must be those from which the grid was read."""
    base, zones = base_and_zones(root)
    if tuple(zone.name for zone in zones) != grid.names or tuple(zone.shape for zone in zones) != grid.shapes:
        raise FormatError(
            f"{source} has changed since the grid was read: its zones are now "
            f"{', '.join(f'{zone.name} {zone.shape}' for zone in zones[:4])}{' ...' if len(zones) > 4 else ''}; "
            f"read it again, or write to another format"
        )
    if base.dimension == 2 and any(end[:, 2].any() for end in boxes()):
        raise FormatError(
            f"{source} stores only x and y (physical dimension 2), but nodes have moved out of the plane z = 0"
        )
    return base, zones


def _writable_dataset(group: h5py.Group, precision: str | None, counts: tuple[int, ...]) -> h5py.Dataset:
    """The coordinate dataset, recreated if its precision changes or if it belongs to another node, too. Old values are
    copied only if some of them remain: rind values in addition to the nodes ``counts`` of the zone."""
    dataset = group[DATA]
    stored = dataset.dtype.newbyteorder("=")
    dtype = stored if precision is None else np.dtype(precision)
    if dtype == stored and not has_other_names(dataset):
        return dataset
    shape, chunks = dataset.shape, dataset.chunks
    kept = ("chunks", "compression", "compression_opts", "shuffle", "fletcher32")
    packing = {name: getattr(dataset, name) for name in kept}
    values = dataset[()].astype(dtype) if shape != counts[::-1] else None
    del group[DATA]
    group.attrs.modify("type", np.bytes_(data_type_of(dtype)))
    if values is None and chunks is None:
        reserve_dataset(group.id, DATA, shape, dtype)
        return group[DATA]
    return group.create_dataset(DATA, shape, dtype, data=values, **packing)


def _adapt_links(file: h5py.File, old: Path, new: Path) -> None:
    """Adapt external links with relative names from the folder ``old`` to the folder ``new``."""
    if old.resolve() == new.resolve():
        return
    for name in (raw.decode() for raw in external_links(file)):
        link = file.get(name, getlink=True)
        target = old / link.filename
        if os.path.isabs(link.filename) or not target.exists():
            continue
        filename = os.path.relpath(target.resolve(), new.resolve())
        parent, _, own_name = name.rpartition("/")
        group = file[parent or "/"]
        del group[own_name]
        group[own_name] = h5py.ExternalLink(filename, link.path)
        if own_name == LINK and LINK_FILE in group:
            del group[LINK_FILE]
            group[LINK_FILE] = characters(filename)
