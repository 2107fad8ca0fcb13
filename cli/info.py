"""``meshdeform info``: what is in a grid file."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from .options import GridInput, grid_options, json_option

if TYPE_CHECKING:
    from meshdeform_core.grid import Connection, Patch


@click.command("info")
@grid_options
@json_option
def command(source: GridInput, as_json: bool) -> int:
    """Show what GRID holds: format variant, blocks, patches, interfaces, handedness, collapsed edges.

    \b
    Examples:
      meshdeform info wing.cgns
      meshdeform info airfoil.p3dfmt --boundary-file airfoil.nmf
      meshdeform info grid.vts --json
    """
    facts = gather(source)
    click.echo(json.dumps(facts, indent=2) if as_json else _text(facts))
    return 0


def gather(source: GridInput) -> dict[str, Any]:
    """Everything ``info`` prints, as one dictionary; node indices are 1-based."""
    from meshdeform_core.grid.connectivity import check_connections
    from meshdeform_core.grid.interfaces import find_interfaces
    from meshdeform_core.grid.topology import find_topology

    grid = source.read()
    topology = find_topology(grid)
    sides = [f"{name}.{side}" for name in grid.names for side in ("imin", "imax", "jmin", "jmax", "kmin", "kmax")]
    external = np.bincount(topology.quads.block_side[topology.external], minlength=len(sides))
    low, high = grid.points.min(axis=0), grid.points.max(axis=0)
    return {
        "file": str(source.path),
        "format": grid.format.label if grid.format else None,
        "dimension": grid.dimension,
        "nodes": grid.n_nodes,
        "unique_nodes": grid.n_nodes - len(topology.face_nodes) + topology.n_unique,
        "cells": grid.n_cells,
        "bounding_box": [low.tolist(), high.tolist()],
        "shortest_face_edge": float(topology.edge.min()),
        "blocks": [
            {"name": n, "nodes": list(s), "handedness": "right" if h > 0 else "left"}
            for n, s, h in zip(grid.names, grid.shapes, topology.handedness, strict=True)
        ],
        "patches": [_patch(patch, sides) for patch in grid.patches],
        "interfaces": [_interface(each, grid.names) for each in find_interfaces(grid, topology)],
        "declared_connections": len(grid.connections),
        "external_faces": {sides[s]: int(external[s]) for s in np.flatnonzero(external)},
        "collapsed": _collapsed(topology, sides),
        "fields": sorted({f"{f.name} ({f.location})" for f in grid.fields}),
        "notes": [*grid.notes, *check_connections(grid, topology)],
    }


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


def _collapsed(topology: Any, sides: list[str]) -> list[dict[str, Any]]:
    """Block faces with quads that lost an edge (triangles) or their area (lines, points)."""
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


def _text(facts: dict[str, Any]) -> str:
    box = "  ".join(f"{a:.6g}..{b:.6g}" for a, b in zip(*facts["bounding_box"], strict=True))
    lines = [
        f"{facts['file']}: {facts['format']}",
        f"{facts['dimension']}-D, {len(facts['blocks'])} blocks, {facts['nodes']:,} nodes "
        f"({facts['unique_nodes']:,} unique), {facts['cells']:,} cells",
        f"extent {box}, shortest edge on a block face {facts['shortest_face_edge']:.3g}",
        "",
        "blocks",
    ]
    width = max(len(b["name"]) for b in facts["blocks"])
    for block in facts["blocks"]:
        size = " x ".join(str(n) for n in block["nodes"])
        lines.append(f"  {block['name']:{width}s}  {size:18s} {block['handedness']}-handed")
    lines += ["", f"patches ({len(facts['patches'])})"]
    for patch in facts["patches"]:
        where = ", ".join(f"{w['face']}[{_window(w)}]" for w in patch["windows"])
        kind = ", ".join(word for word in (patch["family"], patch["type"]) if word)
        lines.append(f"  {patch['name']}  ({kind or 'no type'})  {where}")
    lines += [
        "",
        f"interfaces ({len(facts['interfaces'])} found, {facts['declared_connections']} declared in the file)",
    ]
    for face in facts["interfaces"]:
        lines.append(f"  {face['name']}  {face['first']}..{face['last']}  transform {face['transform']}")
    lines += ["", "faces on the outside (quads)"]
    lines += [f"  {face}: {count:,}" for face, count in facts["external_faces"].items()]
    for entry in facts["collapsed"]:
        lines.append(f"collapsed  {entry['face']}: {entry['quads']:,} quads with {entry['what']}")
    if facts["fields"]:
        lines.append(f"fields     {', '.join(facts['fields'])}")
    lines += [f"note       {note}" for note in facts["notes"]]
    return "\n".join(lines)


def _window(window: dict[str, Any]) -> str:
    return ",".join(f"{a}:{b}" for a, b in zip(window["first"], window["last"], strict=True))
