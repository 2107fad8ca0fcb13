"""The block faces of a grid: pieces of them, with the position, size and first-cell heights of each, and their roles;
outer surfaces, which they form: one per family, per patch without family, and per unnamed face.

A piece is a rectangle of face quads of one kind on one block side: part of a patch, part of an interface, or an unnamed
outside face. Roles are walls, symmetry planes, far field, end planes. Declarations in the file take precedence.
Otherwise the coordinates decide: grid lines cluster towards walls, a body surrounded by the grid is a wall, cells grow
towards the far field, the end planes of an extruded grid are congruent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from ..numerics.arrays import BoolArray, batches, extent, medians, runs, spans, spread
from ..numerics.geometry.coincidence import connected_rows
from ..numerics.geometry.vectors import doubled_areas, unit
from ..parallel import empty
from .blocks import FloatArray, Grid, IntArray
from .parts import Patch, Side, Window
from .planes import FLATNESS, Plane, plane_normal, plane_of, planes_of
from .topology import Topology, quads_of_patches, side_nodes
from .windows import Rectangles, rectangles

_SAMPLED_LINES = 12
_TOGETHER = 100_000
"""Nodes of pieces processed at a time, which bounds the memory."""
_QUADS = 1 << 14
"""Quads processed at a time: half a kilobyte of intermediate values for each."""


@dataclass(frozen=True)
class Face:
    """A piece of one block side.

    Attributes
    ----------
    window : its nodes
    quads : (n,) its face quads
    patch : the patch that it belongs to, if any
    outside : whether no other block shares it
    box : (2, 3) lowest and highest coordinates
    area : in 2-D the length
    first_height, median_height : smallest and median height of the first cells (grid length unit)
    stretching : ratio of mean to first spacing of the grid lines that begin here: large at walls, small at far fields
    finest : ratio of smallest to first spacing of these lines: 1 where the first cell is the smallest
    plane : the plane (in 2-D the line) that contains it, ``None`` if it is curved
    """

    window: Window
    quads: IntArray = field(repr=False)
    patch: Patch | None
    outside: bool
    box: FloatArray
    area: float
    first_height: float
    median_height: float
    stretching: float
    finest: float
    plane: Plane | None

    def label(self, grid: Grid) -> str:
        """See :meth:`.Grid.window_label`."""
        return grid.window_label(self.window)


def outward_areas(
    grid: Grid, topology: Topology, quads: IntArray | slice, normal: FloatArray | None
) -> tuple[FloatArray, FloatArray]:
    """Corners (n, 4, 3) and area vectors (n, 3), out of the block, of face quads; of cell edges (n, 2, 3) and their
    lengths in a plane grid with the unit ``normal``."""
    corners = grid.points[topology.first[topology.quads.corners[quads]]]
    if normal is None:
        return corners, 0.5 * doubled_areas(corners)
    # The outside lies to the right of the corner order, looking against the plane's normal.
    return corners, np.cross(corners[:, 1] - corners[:, 0], normal)


def quad_sizes(grid: Grid, topology: Topology) -> tuple[FloatArray, FloatArray]:
    """Area (n_quads,) of all face quads, in 2-D the length, and the distance of the next layer of nodes along the
    inward normal."""
    count, normal = len(topology.partner), plane_normal(grid)
    area, height = empty((count,)), empty((count,))
    for lo in range(0, count, _QUADS):
        some = slice(lo, min(lo + _QUADS, count))
        _, outward = outward_areas(grid, topology, some, normal)
        side, u, v = topology.quads.places(np.arange(some.start, some.stop))
        nodes = grid.sides.corners(side, u, v)
        # Mean of the first edges into the block.
        arm = (grid.points[nodes + grid.sides.inward[side, None]] - grid.points[nodes]).mean(axis=1)
        area[some] = np.linalg.norm(outward, axis=1)
        height[some] = -np.einsum("ni,ni->n", unit(outward), arm)
    return area, height


def find_faces(grid: Grid, topology: Topology) -> list[Face]:
    """All block sides divided into pieces: patches, interfaces and unnamed outside faces; without collapsed quads."""
    # The pieces; their label is twice the number of the patch (from 1), plus one where blocks share the quads.
    label = np.zeros(len(topology.partner), dtype=np.int64)
    quads, patch = quads_of_patches(topology.quads, grid.patches)
    label[quads] = 2 * (patch + 1)
    shared = topology.partner >= 0
    label[shared] += 1
    label[~(shared | topology.external)] = -1
    pieces = rectangles(grid, topology.quads, label)
    if len(pieces) == 0:
        return []
    owner, shared = np.divmod(pieces.label, 2)
    run = np.repeat(np.arange(len(pieces)), pieces.sizes)
    area, height = (values[pieces.quads] for values in quad_sizes(grid, topology))
    # Lowest and highest coordinates of the nodes of every piece.
    boxes = np.empty((len(pieces), 2, 3))
    for lo, hi in batches(pieces.sizes, _TOGETHER):
        start = pieces.start[lo : hi + 1]
        corners = grid.points[grid.sides.corners(*topology.quads.places(pieces.quads[start[0] : start[-1]]))]
        boxes[lo:hi, 0] = np.minimum.reduceat(corners.min(axis=1), start[:-1] - start[0], axis=0)
        boxes[lo:hi, 1] = np.maximum.reduceat(corners.max(axis=1), start[:-1] - start[0], axis=0)
    bounds = list(zip(pieces.start[:-1].tolist(), pieces.start[1:].tolist(), strict=True))
    rows = zip(
        pieces.windows(),
        [pieces.quads[lo:hi] for lo, hi in bounds],
        [grid.patches[number - 1] if number else None for number in owner.tolist()],
        (shared == 0).tolist(),
        boxes,
        [float(area[lo:hi].sum()) for lo, hi in bounds],
        np.minimum.reduceat(height, pieces.start[:-1]).tolist(),
        medians(height, run, len(pieces), np.nan).tolist(),
        *(ratio.tolist() for ratio in _spacing(grid, pieces)),
        _planes_of_pieces(grid, pieces),
        strict=True,
    )
    return [Face(*row) for row in rows]


def _spacing(grid: Grid, pieces: Rectangles) -> tuple[FloatArray, FloatArray]:
    """Ratios of mean and smallest to first spacing: medians over some of the grid lines that begin in each piece."""
    sizes = pieces.high - pieces.low + 1
    picks = [spread(sizes[:, axis], _SAMPLED_LINES, pieces.low[:, axis])[1] for axis in (0, 1)]
    taken = np.minimum(sizes, _SAMPLED_LINES)
    first = np.cumsum(taken, axis=0) - taken
    run, place = spans(taken.prod(axis=1))
    a, b = np.divmod(place, taken[run, 1])
    side = pieces.side[run]
    start = grid.sides.at(side, picks[0][first[run, 0] + a], picks[1][first[run, 1] + b])
    mean, least = np.full(len(run), np.nan), np.full(len(run), np.nan)
    for depth in np.unique(grid.sides.depth[side]).tolist():
        alike = np.flatnonzero(grid.sides.depth[side] == depth)
        for lo, hi in batches(np.full(len(alike), depth), _TOGETHER):
            some = alike[lo:hi]
            lines = grid.points[start[some] + np.arange(depth)[:, None] * grid.sides.inward[side[some]]]
            spacing = np.linalg.norm(np.diff(lines, axis=0), axis=-1)
            sound = spacing[0] > 0
            spacing, some = spacing[:, sound], some[sound]
            mean[some], least[some] = spacing.mean(axis=0) / spacing[0], spacing.min(axis=0) / spacing[0]
    sound = ~np.isnan(mean)
    found = (medians(ratio[sound], run[sound], len(pieces), 1.0) for ratio in (mean, least))
    return next(found), next(found)


def _planes_of_pieces(grid: Grid, pieces: Rectangles) -> list[Plane | None]:
    """The plane (in 2-D the line) that contains each piece, if there is one."""
    flat, sizes = plane_normal(grid), pieces.high - pieces.low + 1
    numbers = sizes.prod(axis=1)
    planes: list[Plane | None] = [None] * len(pieces)
    for count in np.unique(numbers).tolist():
        alike = np.flatnonzero(numbers == count)
        for lo, hi in batches(np.full(len(alike), count), _TOGETHER):
            some = alike[lo:hi, None]
            a, b = np.divmod(np.arange(count), sizes[some, 1])
            nodes = grid.sides.at(pieces.side[some], pieces.low[some, 0] + a, pieces.low[some, 1] + b)
            for number, plane in zip(alike[lo:hi].tolist(), planes_of(grid.points[nodes], flat), strict=True):
                planes[number] = plane
    return planes


class Role(Enum):
    """Likely role of a face; the values appear in ``meshdeform info --json``."""

    WALL = "wall"
    SYMMETRY = "symmetry"
    FAR = "far"
    END = "end"
    INTERFACE = "interface"
    UNKNOWN = "unknown"


# The order matters: a solver's "symmetry wall" is a symmetry plane.
_WORDS: tuple[tuple[Role, tuple[str, ...]], ...] = (
    (Role.SYMMETRY, ("symm",)),
    (Role.WALL, ("wall", "solid", "viscous", "noslip", "no_slip", "tangency")),
    (Role.FAR, ("far", "inflow", "outflow", "inlet", "outlet", "extrap", "freestream", "riem", "pressure", "tunnel",
                "characteristic")),
)  # fmt: skip

# OpenFOAM's patch types for the end planes of a plane or axisymmetric grid.
_END_TYPES = ("empty", "wedge")

_CLUSTERED = 2.0
"""Ratio of mean to first spacing above which a face counts as a wall."""
_VISCOUS = 50.0
"""Ratio above which a face is no far field, whatever it is called: converters call all faces so."""
_FIRST_IS_FINEST = 0.3
"""Smallest ratio of the finest to the first spacing at a wall: cells must not be much finer elsewhere."""
_COARSENED = 0.75
"""Ratio of mean to first spacing below which cells grow towards a face."""
_ENCLOSED = 0.02
"""Least flux of (x - center) through the surface of a body, relative to area times radius."""
_MOST = 0.6
"""Walls longer than this fraction of the grid in two directions are floors or side walls, not bodies."""


def declared_role(face: Face) -> Role | None:
    """The role that the file declares for a face: by its type, else by its family or name."""
    return role_of_patch(face.patch) if face.patch is not None else None


def role_of_patch(patch: Patch) -> Role | None:
    """The role that a patch declares: by its type, else by its family or name."""
    if patch.bc_type in _END_TYPES:
        return Role.END
    for text in (patch.bc_type, patch.family, patch.name):
        for role, words in _WORDS:
            if any(word in text.lower() for word in words):
                return role
    return None


def clusters(face: Face) -> bool:
    """Whether grid lines cluster towards a face."""
    return face.stretching >= _CLUSTERED and face.finest >= _FIRST_IS_FINEST


def guess_roles(grid: Grid, topology: Topology, faces: Sequence[Face]) -> list[Role]:
    """The likely role of every face."""
    corners, ends = topology.quads.corners, _end_sides(grid, topology, faces)
    outward = _outward_normals(grid, topology, faces)
    body = _bodies(grid, topology, [face for face, out in zip(faces, outward, strict=True) if out is None])
    # Roles that follow from a face alone, without its neighbours.
    first = list[Role | None]()
    for face in faces:
        declared, near_wall = declared_role(face), clusters(face)
        if not face.outside:
            # Two coincident faces that the file declares as walls are a thin plate.
            first.append(Role.WALL if declared is Role.WALL else Role.INTERFACE)
        elif (face.window.block, face.window.side) in ends and declared in (None, Role.FAR):
            first.append(Role.END)
        elif declared is not None and not (declared is Role.FAR and near_wall and face.stretching > _VISCOUS):
            first.append(declared)
        else:
            first.append(Role.WALL if near_wall or body[face.quads[0]] else None)
    near = np.zeros(topology.n_unique, dtype=bool)
    for face, role in zip(faces, first, strict=True):
        if role is Role.WALL:
            near[corners[face.quads]] = True
    touched = [bool(near[corners[face.quads]].any()) for face in faces]
    # Walls that extend across the whole grid are those of a channel, whose ends are not symmetry planes.
    outwards = [out for out, touch, role in zip(outward, touched, first, strict=True)
                if out is not None and touch and role is None]  # fmt: skip
    borders, has_bodies, found = np.unique(np.reshape(outwards, (-1, 3)), axis=0), bool(body.any()), list[Role]()
    for face, role, out, touch in zip(faces, first, outward, touched, strict=True):
        if role is not None:
            found.append(role)
        elif out is not None and touch and face.stretching > _COARSENED**2:
            channel = bool((borders @ out < -0.99).any())
            # OpenFOAM declares inlets and outlets patches; a symmetry plane has a type of its own there.
            opening = face.patch is not None and face.patch.bc_type == "patch"
            found.append(Role.UNKNOWN if channel or opening else Role.SYMMETRY)
        elif face.stretching < _COARSENED or (has_bodies and out is not None and not touch):
            # The outer boundary of a grid around a body.
            found.append(Role.FAR)
        else:
            # A step: a plane face that touches a wall, where the grid extends beyond the plane.
            step = face.plane is not None and out is None and touch
            found.append(Role.WALL if step else Role.UNKNOWN)
    return found


def _outward_normals(grid: Grid, topology: Topology, faces: Sequence[Face]) -> list[FloatArray | None]:
    """Outward normals (3,) of plane outside faces with the whole grid on one side of them; ``None`` for others."""
    flat, points, (low, high) = plane_normal(grid), grid.points[topology.first], extent(grid.points)
    found, reach = list[FloatArray | None](), dict[tuple[float, ...], float]()
    for face in faces:
        found.append(None)
        if face.plane is not None and face.outside:
            outward = outward_areas(grid, topology, face.quads, flat)[1].sum(axis=0)  # some may be folded or flat
            normal = face.plane.normal * (1.0 if outward @ face.plane.normal >= 0 else -1.0)
            # The faces of one plane differ in their normals by round-off only.
            key = tuple(round(part, 9) for part in normal.tolist())
            if key not in reach:
                reach[key] = float((points @ normal).max())
            if reach[key] <= float(face.plane.point @ normal) + 10 * FLATNESS * float((high - low).max()):
                found[-1] = normal
    return found


def _bodies(grid: Grid, topology: Topology, faces: Sequence[Face]) -> BoolArray:
    """(n_quads,) whether a quad of the outside ``faces`` belongs to a surface inside the grid that encloses a body, but
    for the bounding planes: one that is smaller than the grid in at least one direction."""
    body = np.zeros(len(topology.partner), dtype=bool)
    (low, high), normal = extent(grid.points), plane_normal(grid)
    varying = high - low > FLATNESS * (high - low).max()
    quads = np.sort(np.concatenate([np.empty(0, dtype=np.int64), *(face.quads for face in faces if face.outside)]))
    if not quads.size:
        return body
    part = connected_rows(topology.quads.corners[quads], topology.n_unique)
    order = np.argsort(part, kind="stable")
    for first, last in zip(*runs(part[order]), strict=True):
        mine = quads[order[first:last]]
        corners, outward = outward_areas(grid, topology, mine, normal)
        area, center = np.linalg.norm(outward, axis=1), corners.mean(axis=1)
        if area.sum() > 0.0:
            arm = center - np.average(center, axis=0, weights=area)
            flux, own = np.einsum("ni,ni->", arm, outward), np.ptp(corners.reshape(-1, 3), axis=0)
            # A surface that extends across the whole grid in two directions is a floor or a ceiling, not a body.
            across = int((own[varying] > 0.999 * (high - low)[varying]).sum())
            encloses = flux < -_ENCLOSED * float(area @ np.linalg.norm(arm, axis=1))
            body[mine] = encloses and across <= int(varying.sum()) - 2
    return body


def _end_sides(grid: Grid, topology: Topology, faces: Sequence[Face]) -> set[tuple[int, Side]]:
    """Block sides on the end planes of an extruded 3-D grid, in the direction with the fewest cells.

    Faces towards which cells cluster are not end planes. A grid extruded by equally many cells in several directions,
    such as a cube, has none.
    """
    if grid.dimension == 2:
        return set()
    # By direction, the index axis along which all layers of a block are the first one, shifted in this direction.
    extruded = list[dict[int, int]]()
    for block in range(grid.n_blocks):
        extruded.append({})
        for axis in (2, 1, 0):
            first, last = (
                grid.nodes.at(side_nodes(grid, block, Side(2 * axis + far))).reshape(-1, 3) for far in (0, 1)
            )
            shift, along = last - first, int(np.argmax(np.abs(last[0] - first[0])))
            length, width = float(np.abs(shift[:, along]).max()), np.ptp(first, axis=0)
            off = max(np.abs(shift - shift[0]).max(), np.abs(np.delete(shift[0], along)).max())
            if length > 0.0 and off <= FLATNESS * length and width[along] <= FLATNESS * max(length, width.max()):
                extruded[block][along] = axis
        if not extruded[block]:
            return set()
    clustered = {(f.window.block, f.window.side) for f in faces if f.outside and clusters(f)}
    choices = list[tuple[int, set[tuple[int, Side]]]]()
    for along in range(3):
        axes = [found[along] for found in extruded if along in found]
        sides = {(b, Side(2 * axis + far)) for b, axis in enumerate(axes) for far in (0, 1)}
        outside = {key for key in sides if topology.external[topology.quads.of_side(*key)].all()}
        if len(axes) == grid.n_blocks and outside and not outside & clustered:
            choices.append((max(grid.cell_shapes[b][axis] for b, axis in enumerate(axes)), outside))
    fewest = min((cells for cells, _ in choices), default=0)
    best = [outside for cells, outside in choices if cells == fewest]
    return best[0] if len(best) == 1 else set()


@dataclass(frozen=True)
class Surface:
    """The faces of one family or patch, or a single unnamed face.

    Attributes
    ----------
    name : of the family or patch; the label of the face if the file has no name for it
    named : whether the file has a name for it
    role : of the faces with the largest total area
    declared : whether the file declares the role; otherwise it is a guess
    faces : its pieces
    """

    name: str
    named: bool
    role: Role
    declared: bool
    faces: tuple[Face, ...]

    @property
    def quads(self) -> IntArray:
        """Face quads (n,) of the surface."""
        return np.concatenate([face.quads for face in self.faces])

    @property
    def area(self) -> float:
        return sum(face.area for face in self.faces)

    @property
    def box(self) -> FloatArray:
        """Lowest and highest coordinates (2, 3)."""
        low, high = (np.array([face.box[end] for face in self.faces]) for end in (0, 1))
        return np.stack([low.min(axis=0), high.max(axis=0)])

    @property
    def first_height(self) -> float:
        """Smallest height of its first cells (grid length unit)."""
        return min(face.first_height for face in self.faces)

    @property
    def median_height(self) -> float:
        """Median height of its first cells; pieces are weighted by their number of cells."""
        heights = np.repeat([face.median_height for face in self.faces], [len(face.quads) for face in self.faces])
        return float(np.median(heights))

    @property
    def patches(self) -> tuple[str, ...]:
        """Names of its patches in the file."""
        return tuple(dict.fromkeys(face.patch.name for face in self.faces if face.patch))


@dataclass(frozen=True)
class Outside:
    """All faces of a grid with their roles, its surfaces, and its ``extent`` (3,)."""

    faces: tuple[Face, ...]
    roles: tuple[Role, ...]
    surfaces: tuple[Surface, ...]
    extent: FloatArray

    def of_role(self, *roles: Role) -> tuple[Surface, ...]:
        return tuple(surface for surface in self.surfaces if surface.role in roles)

    @property
    def bodies(self) -> tuple[Surface, ...]:
        """Walls of bodies in the grid, not the floor, ceiling and side walls of a channel or box.

        The latter extend over most of the grid in two directions, alone or together with other walls in the same plane.
        """
        found, walls = [], self.of_role(Role.WALL)
        levels = [_level(wall, self.extent) or (number,) for number, wall in enumerate(walls)]
        for wall, level in zip(walls, levels, strict=True):
            box = np.array([other.box for other, its in zip(walls, levels, strict=True) if its == level])
            size = box[:, 1].max(axis=0) - box[:, 0].min(axis=0)
            if int((size > _MOST * self.extent).sum()) < 2:
                found.append(wall)
        return tuple(found)


def _level(surface: Surface, extent: FloatArray) -> tuple[int, float] | None:
    """Axis and coordinate of a surface that lies in a plane normal to a coordinate axis, else ``None``."""
    thin = np.flatnonzero(np.ptp(surface.box, axis=0) <= 1e-6 * extent)
    return (int(thin[0]), round(float(surface.box[0, thin[0]] / extent.max()), 6)) if len(thin) == 1 else None


def find_outside(grid: Grid, topology: Topology) -> Outside:
    """Faces, roles and surfaces of a grid; thin plates declared in the file count as outside."""
    faces = find_faces(grid, topology)
    roles = guess_roles(grid, topology, faces)
    groups: dict[tuple[str, bool], list[int]] = {}
    for number, (face, role) in enumerate(zip(faces, roles, strict=True)):
        if role is not Role.INTERFACE:
            name = (face.patch.family or face.patch.name) if face.patch else ""
            groups.setdefault((name or face.label(grid), bool(name)), []).append(number)
    surfaces = []
    for (name, named), members in groups.items():
        weight: dict[Role, float] = {}
        for n in members:
            weight[roles[n]] = weight.get(roles[n], 0.0) + faces[n].area
        role = max(weight, key=lambda each: weight[each])
        declared = any(declared_role(faces[n]) is role for n in members)
        surfaces.append(Surface(name, named, role, declared, tuple(faces[n] for n in members)))
    low, high = extent(grid.points)
    return Outside(tuple(faces), tuple(roles), tuple(surfaces), high - low)


def clustered_interfaces(topology: Topology, outside: Outside) -> list[Face]:
    """Faces between blocks towards which cells cluster from both sides: wakes and thin plates."""
    shared = [
        face
        for face, role in zip(outside.faces, outside.roles, strict=True)
        if role is Role.INTERFACE and clusters(face)
    ]
    fine = np.zeros(len(topology.partner), dtype=bool)
    for face in shared:
        fine[face.quads] = True
    return [face for face in shared if fine[topology.partner[face.quads]].all()]


def thin_direction(grid: Grid) -> FloatArray | None:
    """Unit normal of the plane of a 2-D grid, or of one layer of cells between two parallel planes; else ``None``."""
    if grid.dimension == 2:
        return plane_normal(grid)
    first: FloatArray | None = None
    for block, shape in enumerate(grid.shapes):
        if 2 not in shape:
            return None
        layer = plane_of(grid.points[side_nodes(grid, block, Side(2 * shape.index(2))).ravel()], None)
        if layer is None or (first is not None and abs(float(layer.normal @ first)) <= 1 - 1e-6):
            return None
        first = layer.normal if first is None else first
    return first
