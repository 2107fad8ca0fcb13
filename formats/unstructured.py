"""Unstructured hexahedra (2-D: quads) for other tools, written through meshio; write-only.

=========  ======================================================================================
``.vtu``   cells with their block number, and the fields that all blocks have
``.msh``   Gmsh 2.2: cells and boundary faces in physical groups named after blocks and families
``.med``   cells and boundary faces in groups named after blocks and families
``.su2``   cells, and a marker for each family (written here: meshio gives markers numbers, not names)
``.inp``   Abaqus: cells, and a node set for each family
=========  ======================================================================================

Coincident nodes are merged. Cells of left-handed blocks are reordered so that all volumes are positive; collapsed
hexahedra remain hexahedra. Families and periodic pairs are those of :mod:`meshdeform_formats.markers`.
Points are numbered in the order of the blocks, k running fastest: first those on block faces, each where it comes
first, then those inside blocks.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import meshio
import numpy as np
from numpy.typing import NDArray

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Field, FileFormat, FloatArray, Grid, IntArray
from meshdeform_core.grid.topology import Topology, find_topology, separated

from .files import checked_options, replacing
from .markers import find_markers, point_numbers
from .text import text_rows
from .vtk.dataset import storable_type

_OPTIONS = {".msh": {"encoding": ("binary", "ascii")}, ".vtu": {"boundary": ("false", "true")}}
# Corners of a right-handed cell, starting at the lowest indices, in the order of VTK, Gmsh, SU2 and Abaqus.
_QUAD: tuple[tuple[int, ...], ...] = ((0, 0), (1, 0), (1, 1), (0, 1))
_HEXAHEDRON: tuple[tuple[int, ...], ...] = (*((i, j, 0) for i, j in _QUAD), *((i, j, 1) for i, j in _QUAD))


def variant(grid: Grid, path: Path, options: Mapping[str, Any]) -> FileFormat:
    """How to write ``grid``.

    ``.msh`` takes ``encoding`` (``binary`` or ``ascii``), ``.vtu`` ``boundary`` (``false`` or ``true``: the outside
    faces too, with a field ``family``).
    """
    suffix = Path(path).suffix.lower()
    known = _OPTIONS.get(suffix, {})
    chosen = {key: values[0] for key, values in known.items()} | checked_options(f"cannot write {path}", options, known)
    return FileFormat("meshio", options={"kind": suffix[1:], **chosen})


def write(grid: Grid, path: Path, variant: FileFormat) -> None:
    """Write ``grid`` in the variant given by :func:`variant`, replacing ``path`` as a whole."""
    mesh = _unstructured(grid, separated(grid, find_topology(grid)))
    options, kind = variant.options, variant.options["kind"]
    with replacing(Path(path)) as partial:
        if kind == "msh":
            _write_msh(grid, mesh, partial, options)
        elif kind == "su2":
            points, cells = mesh.points, mesh.cells
            if grid.dimension == 2:
                extent = np.ptp(points, axis=0)
                normal = int(np.argmin(extent))
                if extent[normal] > 1e-9 * extent.max():
                    raise FormatError(
                        f"a 2-D SU2 grid must be plane; this one extends over {extent.tolist()} along x, y, z"
                    )
                # Counter-clockwise in the two remaining coordinates: in the x-z plane the normal y points backwards.
                points, cells = np.delete(points, normal, axis=1), cells[:, ::-1] if normal == 1 else cells
            with partial.open("wb") as stream:
                stream.write(f"NDIME= {grid.dimension}\nNELEM= {len(cells)}\n".encode())
                _write_elements(stream, cells)
                stream.write(f"NPOIN= {len(points)}\n".encode())
                _write_rows(stream, points, "%.17g")
                stream.write(f"NMARK= {len(mesh.names)}\n".encode())
                for number, name in enumerate(mesh.names):
                    faces = mesh.faces[mesh.patch == number]
                    stream.write(f"MARKER_TAG= {_word(name)}\nMARKER_ELEMS= {len(faces)}\n".encode())
                    _write_elements(stream, faces)
        elif kind == "med":
            # Families of cells have negative numbers in MED.
            tags = [-(mesh.block + 1 + len(mesh.names)), -(mesh.patch + 1)]
            med = meshio.Mesh(mesh.points, _cells_and_faces(mesh), cell_data={"cell_tags": tags})
            med.cell_tags = {-(1 + number): [name] for number, name in enumerate([*mesh.names, *grid.names])}
            # In memory, as HDF5 cannot close a file on a full disk; meshio's writer takes what h5py takes.
            content = io.BytesIO()
            meshio.med.write(content, med)
            partial.write_bytes(content.getbuffer())
        elif kind == "inp":
            sets = {_word(name): np.unique(mesh.faces[mesh.patch == number]) for number, name in enumerate(mesh.names)}
            inside = [(mesh.kinds[0], mesh.cells)]
            meshio.Mesh(mesh.points, inside, point_sets=sets).write(partial, file_format="abaqus")
        else:
            _of_variant(grid, mesh, options).write(partial, file_format=kind)


def as_mesh(grid: Grid) -> meshio.Mesh:
    """The cells of a grid as an unstructured mesh: coincident nodes merged, with the fields that all blocks have."""
    return _with_fields(grid, _unstructured(grid, separated(grid, find_topology(grid))))


@dataclass(frozen=True)
class _Unstructured:
    """Cells and outside faces of a grid.

    Attributes
    ----------
    points : (n, 3) unique nodes; ``nodes`` (n,) the block node each was taken from
    cells : (m, 8) or, in 2-D, (m, 4) node numbers, positively oriented; ``block`` (m,) the block of each
    faces : (q, 4) or (q, 2) node numbers; ``patch`` (q,) the index in ``names`` of each
    """

    points: FloatArray
    nodes: IntArray
    cells: IntArray
    block: IntArray
    faces: IntArray
    patch: IntArray
    names: tuple[str, ...]

    @property
    def kinds(self) -> tuple[str, str]:
        """meshio's names of the cells and the faces."""
        return ("hexahedron", "quad") if self.cells.shape[1] == 8 else ("quad", "line")


def _unstructured(grid: Grid, topology: Topology) -> _Unstructured:
    number, nodes = point_numbers(grid, topology)
    cells, ends = [], (slice(-1), slice(1, None))
    for block, handedness in enumerate(topology.handedness):
        own = grid.block(block, number)
        corners = _HEXAHEDRON if handedness > 0 else _HEXAHEDRON[4:] + _HEXAHEDRON[:4]
        if 1 in own.shape:
            flat = own.shape.index(1)
            own = own.squeeze(axis=flat)
            # The indices (i, j) and (j, k) are in cyclic order, (i, k) are not.
            corners = _QUAD if (handedness > 0) != (flat == 1) else _QUAD[::-1]
        cells.append(np.stack([own[tuple(ends[c] for c in corner)].ravel() for corner in corners], axis=1))
    markers = [marker for marker in find_markers(grid, topology) if len(marker.quads)]
    return _Unstructured(
        points=grid.points[nodes],
        nodes=nodes,
        cells=np.concatenate(cells),
        block=np.repeat(np.arange(grid.n_blocks), [len(c) for c in cells]),
        faces=topology.quads.corners[np.concatenate([marker.quads for marker in markers] or [np.empty(0, np.int64)])],
        patch=np.repeat(np.arange(len(markers)), [len(marker.quads) for marker in markers]),
        names=tuple(marker.name for marker in markers),
    )


def _of_variant(grid: Grid, mesh: _Unstructured, options: Mapping[str, Any]) -> meshio.Mesh:
    """The cells and, if wanted, the outside faces: ``family`` numbers them from 1, ``family NAME`` marks each."""
    found = _with_fields(grid, mesh)
    if options["boundary"] == "false":
        return found
    inside, outside = len(mesh.cells), len(mesh.faces)
    data = {}
    for name, (values,) in found.cell_data.items():
        # Faces have no values: NaN, or -1.
        missing = np.full((outside, *values.shape[1:]), np.nan if values.dtype.kind == "f" else -1)
        data[name] = [values, missing.astype(values.dtype)]
    data["family"] = [np.zeros(inside, np.int32), (mesh.patch + 1).astype(np.int32)]
    for number, name in enumerate(mesh.names):
        data[f"family {name}"] = [np.zeros(inside, np.int32), (mesh.patch == number).astype(np.int32)]
    return meshio.Mesh(mesh.points, _cells_and_faces(mesh), found.point_data, data)


def _with_fields(grid: Grid, mesh: _Unstructured) -> meshio.Mesh:
    """Cells only, with the fields that exist on all blocks."""
    point_data: dict[str, NDArray[Any]] = {}
    cell_data: dict[str, NDArray[Any]] = {"block": mesh.block}
    groups: dict[tuple[str, str], list[Field]] = {}
    for field in sorted(grid.fields, key=lambda field: field.block):
        groups.setdefault((field.location, field.name), []).append(field)
    for (location, name), fields in groups.items():
        if len(fields) == grid.n_blocks and len({f.values.shape[3:] for f in fields}) == 1:
            values = np.concatenate([f.values.reshape(-1, *f.values.shape[3:]) for f in fields])
            values = values.astype(storable_type(values, f"{location} field {name!r}"), copy=False)
            if location == "node":
                point_data[name] = values[mesh.nodes]
            else:
                cell_data[name] = values
    cells = [(mesh.kinds[0], mesh.cells)]
    return meshio.Mesh(mesh.points, cells, point_data, {name: [values] for name, values in cell_data.items()})


def _write_msh(grid: Grid, mesh: _Unstructured, path: Path, options: Mapping[str, Any]) -> None:
    tags = [mesh.block + 1 + len(mesh.names), mesh.patch + 1]
    dimension = grid.dimension
    groups = {name: np.array([len(mesh.names) + 1 + b, dimension]) for b, name in enumerate(grid.names)}
    groups |= {name: np.array([1 + p, dimension - 1]) for p, name in enumerate(mesh.names)}
    data = {"gmsh:physical": tags, "gmsh:geometrical": tags}
    gmsh = meshio.Mesh(mesh.points, _cells_and_faces(mesh), cell_data=data, field_data=groups)
    gmsh.write(path, file_format="gmsh22", binary=options["encoding"] == "binary")


def _cells_and_faces(mesh: _Unstructured) -> list[tuple[str, IntArray]]:
    cells, faces = mesh.kinds
    return [(cells, mesh.cells), (faces, mesh.faces)]


def _word(name: str) -> str:
    """A name without blanks, which the text formats do not allow."""
    return "_".join(name.split())


def _write_elements(stream: BinaryIO, corners: IntArray) -> None:
    vtk_type = {2: 3, 4: 9, 8: 12}[corners.shape[1]]
    _write_rows(stream, np.insert(corners, 0, vtk_type, axis=1), "%d")


def _write_rows(stream: BinaryIO, rows: NDArray[Any], number: str) -> None:
    line = " ".join([number] * rows.shape[1]) + "\n"
    stream.writelines(text_rows(rows, line))
