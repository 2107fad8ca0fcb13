"""A template of a case file: every boundary of a grid with its position and likely role, and a motion to fill in."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from meshdeform_core.boundary.fitting import fit_table
from meshdeform_core.boundary.tables import AUTOMATIC, BoundaryNodes, Matching, SurfaceData, by_place, transfer
from meshdeform_core.errors import CaseError
from meshdeform_core.grid import Grid
from meshdeform_core.grid.faces import Outside, Role, Surface, thin_direction
from meshdeform_core.grid.planes import FLATNESS
from meshdeform_core.grid.topology import Topology

from ..displacement import read_displacement
from ..text import distinct

_MOTION = """\
# Motions are applied in order; formulas use the undeformed x, y, z and the time t, for example
#   { rotate = { angle = 5.0, axis = AXIS, center = CENTER } }
#   { displace = DISPLACE }
#   { file = "displacement.csv", match = "nearest" }
motion = [
    { translate = [0.0, 0.0, 0.0] },   # fill in
]
"""
_METHOD = """\
[method]
name = "idw-tfi"   # or another of `meshdeform methods`
"""
_ROOM = 1.05
_SMALLEST = 1e-9
"""Smallest tolerance relative to the size of the wall, so that rounding in the table does not matter."""


@dataclass(frozen=True)
class FittedTable:
    """A table, the names of the surfaces that it moves, and a match and tolerance that cover all their nodes."""

    file: str
    surfaces: tuple[str, ...]
    match: str
    tolerance: float


def fitted_table(grid: Grid, topology: Topology, path: Path, name: str) -> FittedTable:
    """Find the wall that the table ``path`` fits; ``name`` is the file's name as the case file will have it."""
    data = read_displacement(path)
    if not isinstance(data, SurfaceData):
        raise CaseError(
            f"{path} is a grid with deformed positions, which needs no matching; expected a displacement table. Use it "
            f'in a case: motion = [{{ file = "{name}" }}]'
        )
    data = by_place(data, grid, topology)
    fit = fit_table(grid, topology, data, Matching(AUTOMATIC, partial=True))
    quads = np.concatenate([surface.quads for surface in fit.surfaces])
    nodes = BoundaryNodes.of_quads(grid, topology, quads)
    matched = transfer(data, fit.matching, nodes)
    size = float(np.linalg.norm(np.ptp(nodes.points, axis=0)))
    reach = max(_ROOM * float(matched.distance.max()), _SMALLEST * size)
    # Two significant digits, rounded up.
    unit = 10.0 ** (math.floor(math.log10(reach)) - 1)
    reach = float(f"{math.ceil(reach / unit) * unit:.3g}")
    return FittedTable(name, tuple(s.name for s in fit.surfaces), matched.how, reach)


def case_template(
    grid: Grid,
    outside: Outside,
    source: str,
    boundary_file: str | None = None,
    table: FittedTable | None = None,
) -> str:
    """The text of a case file for a grid.

    Walls of bodies are moving, floors and far fields fixed, symmetry planes symmetry, end planes slip.

    Parameters
    ----------
    source : the grid file, for the header
    boundary_file : neutral map file, relative to the case file
    table : displacement table; only the surfaces that it fits are moving
    """
    entries = _entries(grid, outside, table)
    lines = [
        f"# A case for {source}: {'fill in the motion' if table is None else 'check the boundaries'}, then",
        f"#   meshdeform deform {source} -c CASE.toml --dry-run",
        "# Roles with a question mark are guessed from the shape of the grid: check them.",
        "",
    ]
    if boundary_file is not None:
        lines += ["[grid]", f"boundary_file = {_text(boundary_file)}", ""]
    if "moving" not in (kind for _, kind in entries):
        lines += ['# No wall was found. The boundary that moves has kind = "moving" and a motion, for example:',
                  '#   kind = "moving"', "#   motion = [ { translate = [0.0, 0.0, 0.0] } ]", ""]  # fmt: skip
    names = distinct(name for name, _ in entries)
    for name, ((_, kind), surfaces) in zip(names, entries.items(), strict=True):
        first = surfaces[0]
        mark = "" if first.declared or first.role is Role.UNKNOWN else "?"
        lines += ["[[boundary]]", f"name = {_text(name)}   # role: {first.role.value}{mark}", "select = ["]
        for surface in surfaces:
            # Brackets in the names of patches and blocks, which patterns would interpret, match any character; those in
            # the ranges of faces stay.
            own = surface.name if surface.named else grid.names[surface.faces[0].window.block]
            pattern = re.sub(r"[\[\]]", "?", own) + surface.name.removeprefix(own)
            lines.append(f"    {_text(pattern)},   # {_place_of_surface(surface)}")
        lines += ["]", f'kind = "{kind}"']
        if kind == "moving" and table is None:
            lines += _motion(grid, outside, surfaces)
        elif kind == "moving" and table is not None:
            match = f'match = "{table.match}", tolerance = {table.tolerance:g}'
            lines.append(f"motion = [ {{ file = {_text(table.file)}, {match} }} ]")
        lines.append("")
    return "\n".join([*lines, _METHOD])


def _entries(grid: Grid, outside: Outside, table: FittedTable | None) -> dict[tuple[str, str], list[Surface]]:
    """The surfaces of each ``[[boundary]]`` by its name, which says the kind if another one has it, and its kind."""
    moving = outside.bodies or outside.of_role(Role.WALL)
    if table is not None:
        moving = tuple(surface for surface in outside.surfaces if surface.name in table.surfaces)
    groups: dict[tuple[str, str], list[Surface]] = {}
    kinds = dict[str, str]()
    for surface in sorted(outside.surfaces, key=lambda s: list(Role).index(s.role)):
        name = surface.name if surface.named else surface.role.value
        if surface in moving:
            kind = "moving"
        elif any(face.patch is not None and face.patch.bc_type == "cyclic" for face in surface.faces):
            # Both sides of a periodic pair belong to one entry.
            name = kind = "periodic"
        elif surface.role is Role.SYMMETRY and _in_one_plane(grid, outside, surface):
            kind = "symmetry"
        else:
            kind = "slip" if surface.role in (Role.END, Role.SYMMETRY) else "fixed"
        name = name if kinds.setdefault(name, kind) == kind else f"{name}-{kind}"
        groups.setdefault((name, kind), []).append(surface)
    return groups


def _in_one_plane(grid: Grid, outside: Outside, surface: Surface) -> bool:
    """Whether all faces lie in one plane, and the grid is more than one cell thick there."""
    planes = [face.plane for face in surface.faces if face.plane is not None]
    thick = all(grid.cell_shapes[f.window.block][f.window.side.axis] > 1 for f in surface.faces)
    return thick and len(planes) == len(surface.faces) and all(
        abs(plane.normal @ planes[0].normal) > 1 - FLATNESS
        and abs((plane.point - planes[0].point) @ planes[0].normal) <= FLATNESS * outside.extent.max()
        for plane in planes
    )  # fmt: skip


def _motion(grid: Grid, outside: Outside, surfaces: Sequence[Surface]) -> list[str]:
    """A motion to fill in, with examples of a size that suits the wall.

    The examples keep the wall in the plane of a plane or extruded grid, or on its symmetry plane: rotations about the
    normal, and bending that begins at the plane.
    """
    boxes = np.array([surface.box for surface in surfaces])
    low, high = boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)
    planes = {role: [face.plane for face, own in zip(outside.faces, outside.roles, strict=True) if own is role and
                     face.plane] for role in (Role.END, Role.SYMMETRY)}  # fmt: skip
    # The normal of a plane grid or of the end planes of an extruded one, else of the only symmetry plane at which the
    # wall ends.
    normal, place = planes[Role.END][0].normal if planes[Role.END] else thin_direction(grid), None
    mirrors = {int(np.argmax(np.abs(plane.normal))): plane for plane in reversed(planes[Role.SYMMETRY])}
    if normal is None and len(mirrors) == 1:
        ((axis, plane),) = mirrors.items()
        near = FLATNESS * float((high - low).max())
        if min(abs(low[axis] - plane.point[axis]), abs(high[axis] - plane.point[axis])) <= near:
            normal, place = plane.normal, float(plane.point[axis]) if abs(plane.point[axis]) > near else 0.0
    axis = 2 if normal is None else int(np.argmax(np.abs(normal)))
    name, lines = "xyz"[axis], list[str]()
    if place is not None:
        lines = [f"# The wall ends at the symmetry plane {name} = {place:.4g}; a motion along {name} leaves it."]
    in_plane = sorted({0, 1, 2} - {axis}, key=lambda number: high[number] - low[number])
    # Bending by a twentieth of the wall's length, largest at its middle or away from the symmetry plane. It has all
    # digits of the ends, where it is zero: they may belong to faces that do not move.
    along = in_plane[1] if place is None else axis
    name, length = "xyz"[along], float(high[along] - low[along])
    begin = float(low[along]) if place is None else place
    part = name if begin == 0.0 else f"({name} {'-' if begin > 0 else '+'} {abs(begin)!r})"
    shape = f"sin(pi*{part}/{length!r})" if place is None else f"({part}/{length!r})**2"
    parts = ["0", "0", "0"]
    parts[in_plane[0]] = f"{length / 20:.2g}*{shape}"
    text = _MOTION.replace("AXIS", str([int(number == axis) for number in range(3)]))
    text = text.replace("CENTER", str([float(f"{x:.3g}") for x in (low + high) / 2]))
    return [*lines, *text.replace("DISPLACE", json.dumps(parts)).splitlines()]


def _place_of_surface(surface: Surface) -> str:
    # Values within round-off of the other coordinates count as 0.
    corners = np.where(np.abs(surface.box) < 1e-9 * np.abs(surface.box).max(), 0.0, surface.box)
    box = "  ".join(
        f"{name} {low:.5g}" if np.isclose(low, high) else f"{name} {low:.5g}..{high:.5g}"
        for name, low, high in zip("xyz", *corners.tolist(), strict=True)
    )
    return f"{box}, first cells {surface.first_height:.3g}, {len(surface.quads)} cell faces"


def _text(value: str) -> str:
    """A TOML string; JSON's escapes are TOML's."""
    return json.dumps(value, ensure_ascii=False)
