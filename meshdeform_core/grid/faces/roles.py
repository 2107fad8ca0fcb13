"""The likely roles of the faces of a grid: walls, symmetry planes, far field, end planes.

Declarations in the file take precedence. Otherwise the coordinates decide: grid lines cluster towards walls, a body
surrounded by the grid is a wall, cells grow towards the far field, the end planes of an extruded grid are congruent.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum

import numpy as np

from ...numerics.arrays import BoolArray, runs
from ...numerics.geometry.coincidence import connected_rows
from ..blocks import FloatArray, Grid, IntArray
from ..extent import Bounds
from ..parts import Patch, Side
from ..planes import FLATNESS
from ..topology import Topology, side_nodes
from .pieces import Face, QuadGeometry


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


def guess_roles(grid: Grid, topology: Topology, geometry: QuadGeometry, faces: Sequence[Face]) -> list[Role]:
    """The likely role of every face."""
    return _Guess(grid, topology, geometry, faces).roles()


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


class _Guess:
    """Data on all faces needed to guess their roles."""

    def __init__(self, grid: Grid, topology: Topology, geometry: QuadGeometry, faces: Sequence[Face]):
        self.grid, self.topology, self.geometry, self.faces = grid, topology, geometry, faces
        self.bounds = Bounds(grid)
        low, high = self.bounds.low.min(axis=0), self.bounds.high.max(axis=0)
        self.extent, self.size = high - low, float((high - low).max())
        self.ends = _end_sides(grid, topology, faces)
        self.outward = [self._bounding(face) for face in faces]
        self.body = self._bodies()
        self.has_bodies = bool(self.body.any())

    def roles(self) -> list[Role]:
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
        outward = self.geometry.outward(face.quads).sum(axis=0)
        normal = face.plane.normal * (1.0 if outward @ face.plane.normal >= 0 else -1.0)
        level = float(face.plane.point @ normal) + 10 * FLATNESS * self.size
        return normal if self.bounds.within(normal, level) else None

    def _bodies(self) -> BoolArray:
        """(n_quads,) whether a quad belongs to a surface inside the grid, closed but for the bounding planes."""
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
                body[mine] = self._encloses(mine) and self._closed(mine)
        return body

    def _encloses(self, quads: IntArray) -> bool:
        area = self.geometry.area[quads]
        if area.sum() == 0.0:
            return False
        center = self.geometry.center(quads)
        arm = center - np.average(center, axis=0, weights=area)
        flux = np.einsum("ni,ni->", arm, self.geometry.outward(quads))
        return bool(flux < -_ENCLOSED * float(area @ np.linalg.norm(arm, axis=1)))

    def _closed(self, quads: IntArray) -> bool:
        """Whether quads form a body: in each bounding plane, smaller than the grid in at least one direction."""
        corners = self.topology.first[self.topology.quads.corners[quads]]
        own = np.ptp(self.grid.points[corners].reshape(-1, 3), axis=0)
        varying = self.extent > FLATNESS * self.size
        # A surface that extends across the whole grid in two directions is a floor or a ceiling, not a body.
        return int((own[varying] > 0.999 * self.extent[varying]).sum()) <= int(varying.sum()) - 2


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
        axes = _extruded_axes(grid, direction)
        if axes is None:
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


def _extruded_axes(grid: Grid, direction: FloatArray) -> list[int] | None:
    """The axis of every block along which it is extruded, ``None`` if one of them is not."""
    axes = []
    for block in range(grid.n_blocks):
        axis = _extruded_axis(grid, block, direction)
        if axis is None:
            return None
        axes.append(axis)
    return axes


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
