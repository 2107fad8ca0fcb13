"""The block faces of a grid: pieces of them, with the position, size and first-cell heights of each, and their roles.

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

from ..numerics.arrays import batches, extent, medians, runs, spans, spread
from ..numerics.geometry.coincidence import connected_rows
from ..numerics.geometry.vectors import doubled_areas, unit
from ..parallel import empty
from .blocks import FloatArray, Grid, IntArray
from .parts import Patch, Side, Window
from .planes import FLATNESS, Plane, plane_normal, planes_of
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


class RoleGuess:
    """Data on all faces of a grid needed to guess their roles."""

    def __init__(self, grid: Grid, topology: Topology, faces: Sequence[Face]):
        self.grid, self.topology, self.faces = grid, topology, faces
        self.normal, self.points = plane_normal(grid), grid.points[topology.first]
        low, high = extent(grid.points)
        self.extent, self.size = high - low, float((high - low).max())
        # The largest x . normal of all nodes, by the normal.
        self.reach: dict[tuple[float, ...], float] = {}
        self.ends = _end_sides(grid, topology, faces)
        self.outward = [self._bounding(face) for face in faces]
        # (n_quads,) whether a quad belongs to a surface inside the grid, closed but for the bounding planes.
        inner, body = np.zeros((2, len(self.topology.partner)), dtype=bool)
        for face, outward in zip(self.faces, self.outward, strict=True):
            if face.outside and outward is None:
                inner[face.quads] = True
        quads = np.flatnonzero(inner)
        if quads.size:
            part = connected_rows(self.topology.quads.corners[quads], self.topology.n_unique)
            order = np.argsort(part, kind="stable")
            for lo, hi in zip(*runs(part[order]), strict=True):
                mine = quads[order[lo:hi]]
                body[mine] = self._is_body(mine)
        self.body = body
        self.has_bodies = bool(self.body.any())

    def roles(self) -> list[Role]:
        """The likely role of every face."""
        roles = [self._first_role(face) for face in self.faces]
        near = np.zeros(self.topology.n_unique, dtype=bool)
        for face, role in zip(self.faces, roles, strict=True):
            if role is Role.WALL:
                near[self.topology.quads.corners[face.quads]] = True
        touched = [bool(near[self.topology.quads.corners[face.quads]].any()) for face in self.faces]
        # Walls that extend across the whole grid are those of a channel, whose ends are not symmetry planes.
        outwards = [out for out, touch, role in zip(self.outward, touched, roles, strict=True)
                    if out is not None and touch and role is None]  # fmt: skip
        borders = np.unique(np.reshape(outwards, (-1, 3)), axis=0)
        return [
            role or self._rest(face, out, touch, borders)
            for face, role, out, touch in zip(self.faces, roles, self.outward, touched, strict=True)
        ]

    def _first_role(self, face: Face) -> Role | None:
        """The role that follows from a face alone, without its neighbours."""
        declared = declared_role(face)
        if not face.outside:
            # Two coincident faces that the file declares as walls are a thin plate.
            return Role.WALL if declared is Role.WALL else Role.INTERFACE
        if (face.window.block, face.window.side) in self.ends and declared in (None, Role.FAR):
            return Role.END
        if declared is not None and not (declared is Role.FAR and clusters(face) and face.stretching > _VISCOUS):
            return declared
        return Role.WALL if clusters(face) or self.body[face.quads[0]] else None

    def _rest(self, face: Face, outward: FloatArray | None, touched: bool, borders: FloatArray) -> Role:
        """The role of a face without clustered cells: planes at walls may be symmetry planes, large cells far field."""
        if outward is not None and touched and face.stretching > _COARSENED**2:
            channel = bool((borders @ outward < -0.99).any())
            # OpenFOAM declares inlets and outlets patches; a symmetry plane has a type of its own there.
            opening = face.patch is not None and face.patch.bc_type == "patch"
            return Role.UNKNOWN if channel or opening else Role.SYMMETRY
        # The outer boundary of a grid around a body.
        if face.stretching < _COARSENED or (self.has_bodies and outward is not None and not touched):
            return Role.FAR
        # A step: a plane face that touches a wall, where the grid extends beyond the plane.
        step = face.plane is not None and outward is None and touched
        return Role.WALL if step else Role.UNKNOWN

    def _bounding(self, face: Face) -> FloatArray | None:
        """Outward normal of a plane face with the whole grid on one side of it, else ``None``."""
        if face.plane is None or not face.outside:
            return None
        outward = self._outward(face.quads)[1].sum(axis=0)
        normal = face.plane.normal * (1.0 if outward @ face.plane.normal >= 0 else -1.0)
        # The faces of one plane differ in their normals by round-off only.
        key = tuple(round(part, 9) for part in normal.tolist())
        if key not in self.reach:
            self.reach[key] = float((self.points @ normal).max())
        return normal if self.reach[key] <= float(face.plane.point @ normal) + 10 * FLATNESS * self.size else None

    def _outward(self, quads: IntArray) -> tuple[FloatArray, FloatArray]:
        return outward_areas(self.grid, self.topology, quads, self.normal)

    def _is_body(self, quads: IntArray) -> bool:
        """Whether quads enclose a body: in each bounding plane, smaller than the grid in at least one direction."""
        corners, outward = self._outward(quads)
        area, center = np.linalg.norm(outward, axis=1), corners.mean(axis=1)
        if area.sum() == 0.0:
            return False
        arm = center - np.average(center, axis=0, weights=area)
        flux, own = np.einsum("ni,ni->", arm, outward), np.ptp(corners.reshape(-1, 3), axis=0)
        varying = self.extent > FLATNESS * self.size
        # A surface that extends across the whole grid in two directions is a floor or a ceiling, not a body.
        across = int((own[varying] > 0.999 * self.extent[varying]).sum())
        encloses = flux < -_ENCLOSED * float(area @ np.linalg.norm(arm, axis=1))
        return bool(encloses and across <= int(varying.sum()) - 2)


def _end_sides(grid: Grid, topology: Topology, faces: Sequence[Face]) -> set[tuple[int, Side]]:
    """Block sides on the end planes of an extruded 3-D grid, in the direction with the fewest cells.

    Faces towards which cells cluster are not end planes. A grid extruded by equally many cells in several directions,
    such as a cube, has none.
    """
    if grid.dimension == 2:
        return set()
    clustered = {(f.window.block, f.window.side) for f in faces if f.outside and clusters(f)}
    choices = []
    for direction in np.eye(3):
        axes = list[int]()
        for block in range(grid.n_blocks):
            axis = _extruded_axis(grid, block, direction)
            if axis is None:
                break
            axes.append(axis)
        if len(axes) < grid.n_blocks:
            continue
        sides = {(b, Side(2 * axis + far)) for b, axis in enumerate(axes) for far in (0, 1)}
        outside = {key for key in sides if topology.external[topology.quads.of_side(*key)].all()}
        cells = max(grid.cell_shapes[b][axis] for b, axis in enumerate(axes))
        if outside and not outside & clustered:
            choices.append((cells, outside))
    choices.sort(key=lambda choice: choice[0])
    if not choices or (len(choices) > 1 and choices[0][0] == choices[1][0]):
        return set()
    return choices[0][1]


def _extruded_axis(grid: Grid, block: int, direction: FloatArray) -> int | None:
    """Index axis along which all layers of a block are the first one, shifted along ``direction``."""
    for axis in range(3):
        first, last = (grid.nodes.at(side_nodes(grid, block, Side(2 * axis + far))) for far in (0, 1))
        shift = (last - first).reshape(-1, 3)
        length = np.abs(shift @ direction).max()
        if length == 0.0 or np.abs(shift - shift[0]).max() > FLATNESS * length:
            continue
        across = np.abs(shift[0] - direction * (shift[0] @ direction)).max()
        flat = np.ptp((first @ direction).ravel())
        if across <= FLATNESS * length and flat <= FLATNESS * max(length, 1.0):
            return axis
    return None
