"""What ``meshdeform info`` finds out about a grid, as a dictionary and as text."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from meshdeform_core.grid import Grid
from meshdeform_core.grid.connections import check_connections, find_interfaces
from meshdeform_core.grid.faces import (
    Face,
    Outside,
    Role,
    Surface,
    clustered_interfaces,
    declared_role,
    find_outside,
    thin_direction,
)
from meshdeform_core.grid.openings import coincident_blocks, describe_openings, find_openings
from meshdeform_core.grid.topology import Topology, find_topology
from meshdeform_core.numerics.arrays import extent
from meshdeform_core.wording import counted, listed, vector

Facts = dict[str, Any]

_MAX_LISTED = 24
"""Largest number of blocks, interfaces or unnamed faces that are listed one by one."""


def gather(grid: Grid, file: str) -> Facts:
    """Everything ``info`` prints, as one dictionary; node indices are 1-based."""
    topology = find_topology(grid)
    outside = find_outside(grid, topology)
    thin = thin_direction(grid)
    sides = [f"{name}.{side}" for name in grid.names for side in ("imin", "imax", "jmin", "jmax", "kmin", "kmax")]
    external = np.bincount(topology.quads.block_side[topology.external], minlength=len(sides))
    corners = [corner.tolist() for corner in extent(grid.points)]
    return {
        "file": file,
        "format": grid.format.label if grid.format else None,
        "dimension": grid.dimension,
        "nodes": grid.n_nodes,
        "unique_nodes": grid.n_nodes - len(topology.face_nodes) + topology.n_unique,
        "cells": grid.n_cells,
        "bounding_box": corners,
        "shortest_face_edge": float(topology.edge.min()),
        "thin_direction": None if thin is None else thin.tolist(),
        "blocks": [
            {
                "name": name,
                "nodes": list(shape),
                "handedness": "right" if hand > 0 else "left",
                "bbox": [corner.tolist() for corner in extent(grid.block(b))],
            }
            for b, (name, shape, hand) in enumerate(zip(grid.names, grid.shapes, topology.handedness, strict=True))
        ],
        **_outside_facts(grid, outside, sides),
        "interfaces": [
            {
                "blocks": [grid.names[face.block], grid.names[face.donor_block]],
                "name": face.name,
                "first": _from_one(face.begin),
                "last": _from_one(face.end),
                "donor_first": _from_one(face.donor_begin),
                "donor_last": _from_one(face.donor_end),
                "transform": list(face.transform),
            }
            for face in find_interfaces(grid, topology)
        ],
        "declared_connections": len(grid.connections),
        "external_faces": {sides[s]: int(external[s]) for s in np.flatnonzero(external)},
        "collapsed": _collapsed(topology, sides),
        "fields": sorted({f"{f.name} ({f.location})" for f in grid.fields}),
        "notes": [
            *grid.notes,
            *check_connections(grid, topology),
            *coincident_blocks(grid, topology),
            *describe_openings(grid, find_openings(grid, topology)),
            *_remarks(grid, topology, outside),
        ],
    }


def _from_one(index: Sequence[int]) -> list[int]:
    return [n + 1 for n in index]


def _outside_facts(grid: Grid, outside: Outside, sides: list[str]) -> Facts:
    """Boundaries by name, all pieces of faces, and the patches of the file."""

    def common(part: Surface | Face, role: Role, declared: bool) -> Facts:
        height = {"min": part.first_height, "median": part.median_height}
        known = {"role": role.value, "declared": declared, "quads": len(part.quads), "area": part.area}
        return known | {"bbox": part.box.tolist(), "first_cell_height": height}

    surfaces = [
        {"name": surface.name, "named": surface.named, "patches": list(surface.patches)}
        | {"faces": [face.label(grid) for face in surface.faces]}
        | common(surface, surface.role, surface.declared)
        for surface in outside.surfaces
    ]
    faces = [
        {
            "block": grid.names[face.window.block],
            "side": face.window.side.label,
            "range": face.window.ranges,
            "patch": face.patch.name if face.patch else None,
            "family": (face.patch.family or None) if face.patch else None,
            "outside": face.outside,
            "stretching": face.stretching,
            "normal": None if face.plane is None else face.plane.normal.tolist(),
            **common(face, role, declared_role(face) is role),
        }
        for face, role in zip(outside.faces, outside.roles, strict=True)
    ]
    patches = [
        {
            "name": patch.name,
            "family": patch.family,
            "type": patch.bc_type,
            "windows": [
                {"face": sides[6 * w.block + w.side], "first": _from_one(w.low), "last": _from_one(w.high)}
                for w in patch.windows
            ],
        }
        for patch in grid.patches
    ]
    return {"surfaces": surfaces, "faces": faces, "patches": patches}


def _collapsed(topology: Topology, sides: list[str]) -> list[Facts]:
    """Block faces with quads that have a collapsed edge (triangles) or no area (lines, points)."""
    corners = np.sort(topology.quads.corners, axis=1)
    distinct = 1 + np.count_nonzero(np.diff(corners, axis=1), axis=1)
    flat = topology.partner == -2
    found = []
    for what, mask in (("no area", flat), ("a collapsed edge", (distinct == corners.shape[1] - 1) & ~flat)):
        count = np.bincount(topology.quads.block_side[mask], minlength=len(sides))
        found += [{"face": sides[s], "what": what, "quads": int(count[s])} for s in np.flatnonzero(count)]
    return found


def _remarks(grid: Grid, topology: Topology, outside: Outside) -> list[str]:
    """Where a plate may be in a grid without walls, which follows from its shape but not from the file."""
    if outside.of_role(Role.WALL) or not (names := [f.label(grid) for f in clustered_interfaces(topology, outside)]):
        return []
    return [
        f"no wall was found, but cells cluster from both sides towards {listed(names)}: a wake, or in part a thin "
        f'plate, whose nodes the case can name: [grid] plates = ["{names[0]}[1:9,*]"]'
    ]


def as_text(facts: Facts, verbose: bool = False) -> str:
    """The facts as lines; ``verbose``: every patch and face."""
    normal, layer = facts["thin_direction"], ""
    if normal is not None and facts["dimension"] == 3:
        along = [name for name, c in zip("xyz", normal, strict=True) if abs(c) > 1 - 1e-6]
        layer = f", one cell thick along {along[0] if along else vector(normal)}"
    blocks, found = facts["blocks"], facts["interfaces"]
    sizes = [" x ".join(map(str, b["nodes"])) for b in blocks]
    width, wide = max(len(b["name"]) for b in blocks), max(map(len, sizes))
    rows = [
        f"  {b['name']:{width}s}  {size:{wide}s}  {b['handedness']}-handed  {_box(b['bbox'])}"
        for b, size in zip(blocks, sizes, strict=True)
    ]
    pairs = [f"  {f['name']}  {_node(f['first'])}..{_node(f['last'])}  transform {f['transform']}" for f in found]
    patches = []
    for patch in facts["patches"] if verbose else ():
        places = []
        for window in patch["windows"]:
            ranges = ",".join(f"{a}:{b}" for a, b in zip(window["first"], window["last"], strict=True))
            places.append(f"{window['face']}[{ranges}]")
        kind = ", ".join(word for word in (patch["family"], patch["type"]) if word)
        patches.append(f"  {patch['name']}  ({kind or 'no type'})  {', '.join(places)}")
    return "\n".join([
        f"{facts['file']}: {facts['format']}",
        f"{facts['dimension']}-D{layer}, {counted(len(blocks), 'block')}, {facts['nodes']:,} nodes "
        f"({facts['unique_nodes']:,} unique), {counted(facts['cells'], 'cell')}",
        f"extent {_box(facts['bounding_box'])}, shortest edge on a block face {facts['shortest_face_edge']:.3g}",
        "", "blocks", *_first(verbose, rows),
        "", *_surface_lines(facts["surfaces"], verbose),
        *(["", f"patches ({len(patches)})", *patches] if patches else []),
        "", f"interfaces ({len(found)} found, {facts['declared_connections']} declared in the file)",
        *_first(verbose, pairs),
        *(f"collapsed  {each['face']}: {each['quads']:,} quads with {each['what']}" for each in facts["collapsed"]),
        *([f"fields     {', '.join(facts['fields'])}"] if facts["fields"] else []),
        *(f"note       {note}" for note in facts["notes"]),
    ])  # fmt: skip


def _first(verbose: bool, lines: list[str]) -> list[str]:
    """All lines, or the first ones and how many more there are."""
    if verbose or len(lines) <= _MAX_LISTED:
        return lines
    return [*lines[: _MAX_LISTED - 1], f"  ... and {len(lines) - _MAX_LISTED + 1} more (-v shows all)"]


def _surface_lines(surfaces: list[Facts], verbose: bool) -> list[str]:
    """A table of the boundaries, walls first."""
    if not surfaces:
        return ["boundaries (none: every face is shared)"]
    order = ("wall", "symmetry", "end", "far", "unknown")
    rows = [("", "role", "quads", "area", "first cell (min, median)", "extent")]
    for s in sorted(surfaces, key=lambda s: order.index(s["role"]) if s["role"] in order else len(order)):
        title, height = s["name"], s["first_cell_height"]
        if s["named"] and any(name != title for name in s["patches"]):
            title += f" ({counted(len(s['patches']), 'patch', 'patches')})"
        elif s["named"]:
            title += f" ({counted(len(s['faces']), 'face')})"
        mark = "" if s["declared"] or s["role"] == "unknown" else "?"
        heights = f"{height['min']:.3g}, {height['median']:.3g}"
        rows.append((title, f"{s['role']}{mark}", f"{s['quads']:,}", f"{s['area']:.4g}", heights, _box(s["bbox"])))
    a, b, c, d, e, _ = (max(map(len, column)) for column in zip(*rows, strict=True))
    table = [f"  {r[0]:{a}s}  {r[1]:{b}s}  {r[2]:>{c}s}  {r[3]:>{d}s}  {r[4]:{e}s}  {r[5]}".rstrip() for r in rows]
    return ["boundaries ('?': guessed from the shape of the grid)", *_first(verbose, table)]


def _node(node: list[int]) -> str:
    return f"({', '.join(map(str, node))})"


def _box(box: list[list[float]]) -> str:
    """The ranges of coordinates; values within round-off of the others count as 0."""
    tiny = 1e-9 * max(abs(v) for end in box for v in end)
    ends = [[0.0 if abs(v) < tiny else v for v in end] for end in box]
    ranges = (f"{a:.5g}" if b - a <= tiny else f"{a:.5g}..{b:.5g}" for a, b in zip(*ends, strict=True))
    return "  ".join(f"{name} {text}" for name, text in zip("xyz", ranges, strict=True))
