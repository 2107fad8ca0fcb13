"""A template of a case file: every boundary of a grid with its position and likely role, and a motion to fill in."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from meshdeform_core.boundary.fitting import fit_table
from meshdeform_core.boundary.tables import AUTOMATIC, BoundaryNodes, Matching, SurfaceData, by_place, transfer
from meshdeform_core.errors import CaseError
from meshdeform_core.grid import FloatArray, Grid
from meshdeform_core.grid.faces import Role
from meshdeform_core.grid.planes import FLATNESS
from meshdeform_core.grid.surfaces import Outside, Surface, thin_direction
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
    """Find the wall that the table ``path`` fits; ``name`` is the file's name as the case file will have it.

    Raises CaseError, FormatError or MotionError when the file is not a table of points, or its points lie on no wall.
    """
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
    entries = list(_template_entries(grid, outside, table))
    lines = [
        f"# A case for {source}: {'fill in the motion' if table is None else 'check the boundaries'}, then",
        f"#   meshdeform deform {source} -c CASE.toml --dry-run",
        "# Roles with a question mark are guessed from the shape of the grid: check them.",
        "",
    ]
    if boundary_file is not None:
        lines += ["[grid]", f"boundary_file = {_text(boundary_file)}", ""]
    if not any(kind == "moving" for _, kind, _ in entries):
        lines += ['# No wall was found. The boundary that moves has kind = "moving" and a motion, for example:',
                  '#   kind = "moving"', "#   motion = [ { translate = [0.0, 0.0, 0.0] } ]", ""]  # fmt: skip
    for entry in entries:
        lines += [*_entry_lines(grid, outside, entry, table), ""]
    return "\n".join([*lines, _METHOD])


_Entry = tuple[str, str, Sequence[Surface]]
"""One ``[[boundary]]``: its name, kind, and surfaces, which are selected by family or patch, or face by face."""


def _template_entries(grid: Grid, outside: Outside, table: FittedTable | None) -> Iterator[_Entry]:
    moving = outside.bodies or outside.of_role(Role.WALL)
    if table is not None:
        moving = tuple(surface for surface in outside.surfaces if surface.name in table.surfaces)
    groups: dict[tuple[str, str], list[Surface]] = {}
    for surface in sorted(outside.surfaces, key=lambda s: list(Role).index(s.role)):
        if surface in moving:
            kind = "moving"
        elif any(face.patch is not None and face.patch.bc_type == "cyclic" for face in surface.faces):
            kind = "periodic"
        elif surface.role is Role.SYMMETRY and _in_one_plane(grid, surface):
            kind = "symmetry"
        else:
            kind = "slip" if surface.role in (Role.END, Role.SYMMETRY) else "fixed"
        name = surface.name if surface.named else surface.role.value
        if kind == "periodic":
            # Both sides of a periodic pair belong to one entry.
            name = kind
        groups.setdefault((name, kind), []).append(surface)
    kinds = dict[str, str]()
    # Of several entries of one name, all but the first say their kind.
    names = distinct(name if kinds.setdefault(name, kind) == kind else f"{name}-{kind}" for name, kind in groups)
    yield from ((name, kind, surfaces) for name, ((_, kind), surfaces) in zip(names, groups.items(), strict=True))


def _in_one_plane(grid: Grid, surface: Surface) -> bool:
    """Whether all faces lie in one plane, and the grid is more than one cell thick there."""
    planes = [face.plane for face in surface.faces]
    first = planes[0]
    size = float(np.ptp(grid.points, axis=0).max())
    if first is None or any(grid.cell_shapes[f.window.block][f.window.side.axis] == 1 for f in surface.faces):
        return False
    return all(
        plane is not None
        and abs(plane.normal @ first.normal) > 1 - FLATNESS
        and abs((plane.point - first.point) @ first.normal) <= FLATNESS * size
        for plane in planes
    )


def _motion(grid: Grid, outside: Outside, surfaces: Sequence[Surface]) -> Iterator[str]:
    """A motion to fill in, with examples of a size that suits the wall.

    The examples keep the wall in the plane of a plane or extruded grid, or on its symmetry plane: rotations about the
    normal, and bending that begins at the plane.
    """
    boxes = np.array([surface.box for surface in surfaces])
    low, high = boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)
    # The normal of a plane grid or of the end planes of an extruded one.
    ends = [face for face, role in zip(outside.faces, outside.roles, strict=True) if role is Role.END and face.plane]
    normal, place = (ends[0].plane.normal if ends and ends[0].plane else thin_direction(grid)), None
    if normal is None:
        normal, place = _symmetry(outside, np.array([low, high]))
    axis = 2 if normal is None else int(np.argmax(np.abs(normal)))
    if place is not None:
        name = "xyz"[axis]
        yield f"# The wall ends at the symmetry plane {name} = {place:.4g}; a motion along {name} leaves it."
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
    yield from text.replace("DISPLACE", json.dumps(parts)).splitlines()


def _symmetry(outside: Outside, box: FloatArray) -> tuple[FloatArray | None, float | None]:
    """Normal and coordinate of the only symmetry plane, if a wall within ``box`` ends at it."""
    planes = [face.plane for face, role in zip(outside.faces, outside.roles, strict=True)
              if role is Role.SYMMETRY and face.plane]  # fmt: skip
    axes = {int(np.argmax(np.abs(plane.normal))) for plane in planes}
    if len(axes) != 1:
        return None, None
    axis = axes.pop()
    place, size = float(planes[0].point[axis]), float((box[1] - box[0]).max())
    if np.abs(box[:, axis] - place).min() > FLATNESS * size:
        return None, None
    return planes[0].normal, place if abs(place) > FLATNESS * size else 0.0


def _entry_lines(grid: Grid, outside: Outside, entry: _Entry, table: FittedTable | None) -> Iterator[str]:
    name, kind, surfaces = entry
    first = surfaces[0]
    mark = "" if first.declared or first.role is Role.UNKNOWN else "?"
    yield "[[boundary]]"
    yield f"name = {_text(name)}   # role: {first.role.value}{mark}"
    if first.named:
        yield from (f"# {_place_of_surface(surface)}" for surface in surfaces)
        yield f"select = [{', '.join(_text(_pattern(surface.name)) for surface in surfaces)}]"
    else:
        yield "select = ["
        for surface in surfaces:
            # Brackets in the name of the block become `?`, those of its face stay.
            block = grid.names[surface.faces[0].window.block]
            pattern = _pattern(block) + surface.name.removeprefix(block)
            yield f"    {_text(pattern)},   # {_place_of_surface(surface)}"
        yield "]"
    yield f'kind = "{kind}"'
    if kind == "moving" and table is None:
        yield from _motion(grid, outside, surfaces)
    elif kind == "moving" and table is not None:
        match = f'match = "{table.match}", tolerance = {table.tolerance:g}'
        yield f"motion = [ {{ file = {_text(table.file)}, {match} }} ]"


def _pattern(name: str) -> str:
    """A pattern that matches a name; characters that would be wildcards match any character."""
    return re.sub(r"[\[\]]", "?", name)


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
