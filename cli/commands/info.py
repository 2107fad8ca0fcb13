"""``meshdeform info``: contents of a grid file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from meshdeform_core.wording import listed
from meshdeform_formats.text import json_text

from ..info_text import as_text
from ..options import PATH, GridInput, force_option, grid_options, json_option, memory_option
from ..outputs import check_output
from ..room import limit_of, make_room, temporary_folder

if TYPE_CHECKING:
    from meshdeform_core.grid import Connection, Grid, Patch
    from meshdeform_core.grid.faces.pieces import Face
    from meshdeform_core.grid.faces.roles import Role
    from meshdeform_core.grid.faces.surfaces import Outside, Surface
    from meshdeform_core.grid.topology import Topology


# Memory in units of the coordinates: these, and buffers of reading.
_ARRAYS = 1.5


@click.command("info")
@grid_options
@click.option("-v", "--verbose", is_flag=True, help="List every patch and face on its own line.")
@click.option("--picture", type=PATH, help="Draw the boundaries by name (.png .svg .pdf).")
@memory_option
@force_option
@json_option
def command(
    source: GridInput, verbose: bool, picture: Path | None, max_memory: str | None, force: bool, as_json: bool
) -> int:
    """Show the contents of GRID: blocks, walls and other boundaries, interfaces, anomalies.

    \b
    Examples:
      meshdeform info wing.cgns
      meshdeform info airfoil.p3dfmt --boundary-file airfoil.nmf
      meshdeform info grid.vts --json
      meshdeform info wing.cgns --picture wing.png

    The role of a boundary is the one that the file declares. Otherwise it is guessed from the shape of the grid (cells
    cluster towards walls and grow towards the far field) and marked with a question mark.
    """
    if picture is not None:
        _check_picture(picture, force, source)
    make_room(limit_of(max_memory), "describing", [source], temporary_folder(), _ARRAYS)
    grid = source.read()
    facts = gather(grid, str(source.path))
    if picture is not None:
        _draw(grid, picture, source.path.name)
    click.echo(json_text(facts) if as_json else as_text(facts, verbose))
    return 0


def _check_picture(path: Path, force: bool, source: GridInput) -> None:
    from meshdeform_formats.picture import check_picture_path

    check_picture_path(path)
    check_output(path, force, *source.files)


def _draw(grid: Grid, path: Path, title: str) -> None:
    from meshdeform_core.grid.topology import find_topology
    from meshdeform_formats.picture import Subject, boundaries, save_page

    save_page(boundaries(Subject(grid, find_topology(grid)), title), path)


def gather(grid: Grid, file: str) -> dict[str, Any]:
    """Everything ``info`` prints, as one dictionary; node indices are 1-based."""
    from meshdeform_core.grid.connectivity.declared import check_connections
    from meshdeform_core.grid.connectivity.interfaces import find_interfaces
    from meshdeform_core.grid.connectivity.openings import describe_group, find_openings, patched_groups
    from meshdeform_core.grid.connectivity.overset import coincident_blocks
    from meshdeform_core.grid.faces.surfaces import find_outside, thin_direction
    from meshdeform_core.grid.topology import find_topology
    from meshdeform_core.numerics.arrays import extent

    topology = find_topology(grid)
    outside = find_outside(grid, topology)
    thin = thin_direction(grid)
    sides = [f"{name}.{side}" for name in grid.names for side in ("imin", "imax", "jmin", "jmax", "kmin", "kmax")]
    external = np.bincount(topology.quads.block_side[topology.external], minlength=len(sides))
    low, high = extent(grid.points)
    return {
        "file": file,
        "format": grid.format.label if grid.format else None,
        "dimension": grid.dimension,
        "nodes": grid.n_nodes,
        "unique_nodes": grid.n_nodes - len(topology.face_nodes) + topology.n_unique,
        "cells": grid.n_cells,
        "bounding_box": [low.tolist(), high.tolist()],
        "shortest_face_edge": float(topology.edge.min()),
        "thin_direction": None if thin is None else thin.tolist(),
        "blocks": _blocks(grid, topology),
        "surfaces": [_surface(each, grid) for each in outside.surfaces],
        "faces": _faces(grid, outside),
        "patches": [_patch(patch, sides) for patch in grid.patches],
        "interfaces": [_interface(each, grid.names) for each in find_interfaces(grid, topology)],
        "declared_connections": len(grid.connections),
        "external_faces": {sides[s]: int(external[s]) for s in np.flatnonzero(external)},
        "collapsed": _collapsed(topology, sides),
        "fields": sorted({f"{f.name} ({f.location})" for f in grid.fields}),
        "notes": [
            *grid.notes,
            *check_connections(grid, topology),
            *coincident_blocks(grid, topology),
            *(describe_group(grid, group) for group in patched_groups(find_openings(grid, topology))),
            *_remarks(grid, topology, outside),
            *_units(outside),
        ],
    }


def _blocks(grid: Grid, topology: Topology) -> list[dict[str, Any]]:
    from meshdeform_core.numerics.arrays import extent

    return [
        {
            "name": name,
            "nodes": list(shape),
            "handedness": "right" if hand > 0 else "left",
            "bbox": [corner.tolist() for corner in extent(grid.block(b))],
        }
        for b, (name, shape, hand) in enumerate(zip(grid.names, grid.shapes, topology.handedness, strict=True))
    ]


def _surface(surface: Surface, grid: Grid) -> dict[str, Any]:
    return {
        "name": surface.name,
        "named": surface.named,
        "role": surface.role.value,
        "declared": surface.declared,
        "patches": list(surface.patches),
        "faces": [face.label(grid) for face in surface.faces],
        "quads": len(surface.quads),
        "area": surface.area,
        "bbox": surface.box.tolist(),
        "first_cell_height": {"min": surface.first_height, "median": surface.median_height},
    }


def _faces(grid: Grid, outside: Outside) -> list[dict[str, Any]]:
    return [_face(grid, face, role) for face, role in zip(outside.faces, outside.roles, strict=True)]


def _face(grid: Grid, face: Face, role: Role) -> dict[str, Any]:
    from meshdeform_core.grid.faces.roles import declared_role

    return {
        "block": grid.names[face.window.block],
        "side": face.window.side.label,
        "range": face.window.ranges,
        "patch": face.patch.name if face.patch else None,
        "family": (face.patch.family or None) if face.patch else None,
        "outside": face.outside,
        "quads": len(face.quads),
        "bbox": face.box.tolist(),
        "area": face.area,
        "first_cell_height": {"min": face.first_height, "median": face.median_height},
        "stretching": face.stretching,
        "normal": None if face.plane is None else face.plane.normal.tolist(),
        "role": role.value,
        "declared": declared_role(face) is role,
    }


def _remarks(grid: Grid, topology: Topology, outside: Outside) -> list[str]:
    """Remarks that follow from the shape of the grid but not from the file."""
    from meshdeform_core.grid.faces.roles import Role
    from meshdeform_core.grid.faces.surfaces import clustered_interfaces

    if outside.plates:
        from meshdeform_formats.case.template import plates_line

        return [
            f"{listed([plate.name for plate in outside.plates])}: likely a thin plate (a wall without thickness "
            f"between blocks): cells cluster from both sides, and it does not reach the far field; if it "
            f"is a wall, the case needs: [grid] {plates_line(outside.plates)}"
        ]
    if outside.of_role(Role.WALL):
        return []
    names = [face.label(grid) for face in clustered_interfaces(topology, outside)]
    if not names:
        return []
    return [
        f"no wall was found, but cells cluster from both sides towards {listed(names)}: a wake, or in part a thin "
        f'plate, whose nodes the case can name: [grid] plates = ["{names[0]}[1:9,*]"]'
    ]


# In metres: bodies are rarely larger, and first cells of boundary layers rarely thicker.
_LARGEST_BODY, _THICKEST_LAYER = 150.0, 0.02


def _units(outside: Outside) -> list[str]:
    """A remark if the unit looks like millimetres: large bodies with first cells too thick for layers in metres."""
    from meshdeform_core.grid.faces.roles import Role

    walls = outside.of_role(Role.WALL)
    if not walls:
        return []
    size = max(float(np.ptp(wall.box, axis=0).max()) for wall in walls)
    height = min(wall.median_height for wall in walls)
    if size < _LARGEST_BODY or height < _THICKEST_LAYER / 10:
        return []
    return [
        f"the walls extend over {size:.4g} and their first cells are {height:.3g} high: the length unit may "
        f"be millimetres or inches rather than metres; tables and motions must use the same unit"
    ]


def _patch(patch: Patch, sides: list[str]) -> dict[str, Any]:
    windows = [
        {"face": sides[6 * w.block + w.side], "first": [n + 1 for n in w.low], "last": [n + 1 for n in w.high]}
        for w in patch.windows
    ]
    return {"name": patch.name, "family": patch.family, "type": patch.bc_type, "windows": windows}


def _interface(face: Connection, names: Sequence[str]) -> dict[str, Any]:
    return {
        "blocks": [names[face.block], names[face.donor_block]],
        "name": face.name,
        "first": [n + 1 for n in face.begin],
        "last": [n + 1 for n in face.end],
        "donor_first": [n + 1 for n in face.donor_begin],
        "donor_last": [n + 1 for n in face.donor_end],
        "transform": list(face.transform),
    }


def _collapsed(topology: Topology, sides: list[str]) -> list[dict[str, Any]]:
    """Block faces with quads that have a collapsed edge (triangles) or no area (lines, points)."""
    corners = np.sort(topology.quads.corners, axis=1)
    distinct = 1 + np.count_nonzero(np.diff(corners, axis=1), axis=1)
    found = []
    for what, mask in (
        ("no area", topology.partner == -2),
        ("a collapsed edge", (distinct == corners.shape[1] - 1) & (topology.partner != -2)),
    ):
        count = np.bincount(topology.quads.block_side[mask], minlength=len(sides))
        found += [{"face": sides[s], "what": what, "quads": int(count[s])} for s in np.flatnonzero(count)]
    return found
