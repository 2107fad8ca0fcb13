"""The subject of a picture: a grid with its walls, the plane that represents it, its worst cell."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from meshdeform_core.errors import CaseError
from meshdeform_core.grid import FloatArray, IntArray, Shape
from meshdeform_core.grid.faces import Face, Role, Surface, thin_direction
from meshdeform_core.grid.planes import Plane
from meshdeform_core.numerics.arrays import extent
from meshdeform_core.numerics.geometry.vectors import doubled_areas
from meshdeform_core.quality.fields import CELL_MEASURES, CellFields, Cells

_ROUND_OFF = 1e-9
_ALONG = 1 - 1e-6
OF_CORNERS = ("f_skew", "scaled_jacobian", "jacobian")
"""Measures of corners: zero at collapsed edges, whatever the shape of the cell."""


@dataclass(frozen=True)
class Subject(CellFields):
    """A grid to draw; cells that are invalid are marked, with a reference only those that became invalid."""

    def shown(self, metric: str, block: int, cells: Cells) -> FloatArray:
        """:meth:`values` for the colours of a box of cells: NaN where a collapsed edge makes a measure of corners zero,
        which says nothing of the cell."""
        values = self.values(metric, block, cells)
        if metric not in OF_CORNERS:
            return values
        return np.where(np.abs(self.measure(block, cells).scaled) <= _ROUND_OFF, np.nan, values)

    @cached_property
    def thin(self) -> FloatArray | None:
        """Normal of the plane of a 2-D grid, or of a grid that is one cell thick."""
        return thin_direction(self.grid)

    @cached_property
    def size(self) -> float:
        """Largest extent of the grid."""
        low, high = extent(self.grid.points)
        return float((high - low).max())

    def level(self, plane: Plane) -> float:
        """x . normal of the points x of a plane, moved slightly into the cells if it lies along their faces.

        Raises CaseError when the plane misses the grid.
        """
        level, tiny, (low, high) = float(plane.point @ plane.normal), 1e-9 * self.size, self._reach(plane.normal)
        if not low - tiny <= level <= high + tiny:
            axis = "xyz"[int(np.argmax(np.abs(plane.normal)))]
            raise CaseError(
                f"no part of the grid lies at {axis} = {level:g}; it spans {axis} = {low:.6g} to {high:.6g}"
            )
        return level - tiny if high - level <= 2 * tiny else level + tiny

    def _reach(self, normal: FloatArray) -> tuple[float, float]:
        """Smallest and largest x . ``normal`` of all nodes x."""
        rows = self.grid.nodes.own @ normal
        ends = self.grid.nodes.gather((rows.min(), rows.max()) if rows.size else (np.inf, -np.inf))
        return float(min(low for low, _ in ends)), float(max(high for _, high in ends))

    @property
    def wall_surfaces(self) -> tuple[Surface, ...]:
        """All walls."""
        return self.outside.of_role(Role.WALL)

    def corners(self, surfaces: Iterable[Surface]) -> FloatArray:
        """The corners (n, m, 3) of the face quads of surfaces; in 2-D the ends (n, 2, 3) of edges."""
        nodes = self.topology.quads.corners[quads_of_surfaces(surfaces)]
        return np.asarray(self.grid.points[self.topology.first[nodes]])

    def outward(self, surface: Surface) -> FloatArray:
        """Mean unit normal of a surface, out of the grid; zero for a closed one."""
        total = doubled_areas(self.corners([surface])).sum(axis=0)
        length = float(np.linalg.norm(total))
        return np.asarray(total / length) if length > 0 else np.zeros(3)

    @cached_property
    def end_plane(self) -> tuple[IntArray, FloatArray] | None:
        """Face quads and normal of one of the two end planes of an extruded grid, which represents the whole grid.

        They are declared or found as ends, or lie across the direction in which the grid is one cell thick, or are two
        symmetry planes between which all walls stand upright.
        """
        ends = self._faces_of(Role.END)
        if not ends and self.thin is not None:
            ends = _faces_across([face for face in self.outside.faces if face.outside], self.thin)
        mirrors = {
            tuple(np.abs(face.plane.normal).round(9)): face.plane
            for face in self._faces_of(Role.SYMMETRY)
            if face.plane
        }
        for plane in () if ends else mirrors.values():
            same, (low, high) = _faces_across(self._faces_of(Role.SYMMETRY), plane.normal), self._reach(plane.normal)
            heights = np.array([face.plane.point @ plane.normal for face in same if face.plane])
            near = 1e-6 * self.size
            upright = [
                np.ptp(wall.box, axis=0) @ np.abs(plane.normal) >= 0.99 * (high - low)
                for wall in self._faces_of(Role.WALL)
            ]
            if heights.min() <= low + near < high - near <= heights.max() and upright and all(upright):
                ends = same
        if not ends or ends[0].plane is None:
            return None
        normal = ends[0].plane.normal
        height = [float(face.plane.point @ normal) if face.plane is not None else np.inf for face in ends]
        lowest = min(height) + 1e-6 * self.size
        return np.concatenate([face.quads for face, h in zip(ends, height, strict=True) if h <= lowest]), normal

    def _faces_of(self, wanted: Role) -> list[Face]:
        return [face for face, role in zip(self.outside.faces, self.outside.roles, strict=True) if role is wanted]

    def middle_plane(self) -> Plane:
        """A plane through the middle of the bodies, parallel to a symmetry plane or else across their longest extent;
        without bodies through the middle of the grid, across its shortest extent."""
        low, high = self.box_of(self.outside.bodies) if self.outside.bodies else extent(self.grid.points)
        mirrors = self.outside.of_role(Role.SYMMETRY)
        if not self.outside.bodies:
            axis = int(np.argmin(high - low))
        elif mirrors:
            axis = int(np.argmax(np.abs(self.outward(mirrors[0]))))
        else:
            axis = int(np.argmax(high - low))
        return Plane(0.5 * (low + high), np.eye(3)[axis])

    @staticmethod
    def box_of(surfaces: Iterable[Surface]) -> FloatArray:
        """Lowest and highest coordinates (2, 3) of surfaces."""
        boxes = np.array([surface.box for surface in surfaces])
        return np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])


def _faces_across(faces: Iterable[Face], normal: FloatArray) -> list[Face]:
    """Faces in planes across a direction."""
    return [face for face in faces if face.plane is not None and abs(face.plane.normal @ normal) > _ALONG]


def quads_of_surfaces(surfaces: Iterable[Surface]) -> IntArray:
    """The face quads (n,) of surfaces."""
    return np.concatenate([np.empty(0, dtype=np.int64), *(surface.quads for surface in surfaces)])


def worst_cell(subject: Subject, metric: str) -> tuple[int, Shape]:
    """Block and cell (0-based) where a metric is worst; among invalid cells the one with the worst corner.

    Worst is what the row of the measure in ``CELL_MEASURES`` says.
    """
    # Badness (smallest is worst), block and place among the cells that this rank holds.
    best, worst = (np.inf, 0, (0, 0, 0)), CELL_MEASURES[metric].worst
    with subject.ready(metric):
        for block in range(subject.grid.n_blocks):
            cells = subject.own(block, subject.whole(block))
            if cells[0].start == cells[0].stop:
                continue
            values, bad = subject.shown(metric, block, cells), subject.bad(block, cells)
            rank = -values if worst == "large" else values
            if worst == "far":
                rank = -np.abs(np.log(np.maximum(values, 1e-300)))
            rank = np.where(np.isfinite(values), rank, np.inf)
            if bad.any():
                # Invalid cells rank below all valid ones, by the size of their negative corner Jacobian.
                scaled = subject.measure(block, cells).scaled
                rank = np.where(bad, -1e300 * (1.0 - 0.5 * scaled) / 1.5, rank)
            i, j, k = (int(n) for n in np.unravel_index(np.argmin(rank), rank.shape))
            best = min(best, (float(rank[i, j, k]), block, (cells[0].start + i, j, k)), key=lambda each: each[0])
    _, block, cell = min(subject.grid.nodes.gather(best), key=lambda each: each[0])
    return block, cell
