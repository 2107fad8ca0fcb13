"""Edges of the blocks of a blockMeshDict: how they are divided, and curves on which their nodes lie, as in blockMesh.

Arcs are uniform in angle; lines through points and splines in the length of the polygon through the points.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from meshdeform_core.grid import FloatArray, IntArray

_END = 1e-15
"""OpenFOAM's SMALL: parameters closer to an end of the curve are that end."""

Curve = Callable[[FloatArray], FloatArray]
"""Positions (n, 3) for parameters (n,) from 0 to 1."""


@dataclass(frozen=True)
class Section:
    """Part of an edge: its share of the length and of the cells, and the ratio of its last to its first cell."""

    length: float = 1.0
    cells: float = 1.0
    ratio: float = 1.0


Grading = tuple[Section, ...]


def divide(cells: int, grading: Sequence[Section]) -> FloatArray:
    """Parameters (cells + 1,) of the nodes from 0 to 1, as blockMesh places them.

    An edge with fewer cells than sections is divided uniformly. The section with the largest share of cells absorbs
    the rounding.
    """
    if cells < len(grading):
        return np.linspace(0.0, 1.0, cells + 1)
    lengths = np.array([part.length for part in grading])
    found = [np.zeros(1)]
    for part, length, count in zip(grading, lengths / lengths.sum(), section_cells(cells, grading), strict=True):
        steps = np.arange(1, count + 1)
        if count < 2 or abs(part.ratio - 1.0) < 1e-12:
            own = steps / max(count, 1)
        else:
            growth = part.ratio ** (1.0 / (count - 1))
            own = (1.0 - growth**steps) / (1.0 - growth**count)
        found.append(found[-1][-1] + length * own)
    nodes = np.concatenate(found)
    nodes[-1] = 1.0
    return nodes


def section_cells(cells: int, grading: Sequence[Section]) -> IntArray:
    """Cells of each section of an edge that has at least as many cells as sections."""
    shares = np.array([part.cells for part in grading])
    shares = shares / shares.sum()
    counts = np.floor(shares * cells + 0.5).astype(np.int64)
    counts[np.argmax(shares)] += cells - counts.sum()
    return np.asarray(counts)


@dataclass(frozen=True)
class Arc:
    """Circular arc, or a helix if it also advances along its axis.

    Attributes
    ----------
    first, last : end points (3,)
    center, axis : of the circle; the axis is a unit vector
    angle : radians about the axis from first to last
    """

    first: FloatArray
    last: FloatArray
    center: FloatArray
    axis: FloatArray
    angle: float

    def __call__(self, parameter: FloatArray) -> FloatArray:
        arm = self.first - self.center
        along = (arm @ self.axis) * self.axis
        out = arm - along
        angle = parameter[:, None] * self.angle
        advance = ((self.last - self.first) @ self.axis) * parameter[:, None]
        found = self.center + along + advance * self.axis + np.cos(angle) * out
        return _with_ends(found + np.sin(angle) * np.cross(self.axis, out), parameter, self.first, self.last)


def arc_through(first: FloatArray, middle: FloatArray, last: FloatArray) -> Arc | None:
    """The arc through three points; ``None`` if they lie on one line."""
    a, b = middle - first, last - first
    across = float((a @ a) * (b @ b) - (a @ b) ** 2)
    if across <= 1e-20 * float((a @ a) * (b @ b)):
        return None
    center = first + 0.5 * a + 0.5 * ((b @ b) - (a @ b)) / across * np.cross(np.cross(a, b), a)
    r1, r2, r3 = first - center, middle - center, last - center
    angle = _angle(r1, r3)
    axis = np.cross(r1, r3)
    if np.cross(r1, r2) @ axis < 0:
        angle, axis = 2 * np.pi - angle, -axis
    elif np.linalg.norm(axis) < 1e-3 * np.linalg.norm(r1) * np.linalg.norm(r3):
        axis = np.cross(r1, r2)
    return Arc(first, last, center, axis / np.linalg.norm(axis), angle)


def arc_about(first: FloatArray, last: FloatArray, origin: FloatArray, stretch: float = 1.0) -> Arc | None:
    """The shorter arc about ``origin``, which is moved if the ends are not equally far from it.

    ``stretch`` times the mean radius is the radius. ``None`` if origin and ends lie on one line.
    """
    r1, r3, chord = first - origin, last - origin, last - first
    m1, m3 = float(np.linalg.norm(r1)), float(np.linalg.norm(r3))
    axis = np.cross(r1, r3)
    if np.linalg.norm(axis) <= 1e-10 * m1 * m3:
        return None
    axis = axis / np.linalg.norm(axis)
    if abs(m1 - m3) > _END * max(m1, m3) or stretch != 1.0:
        radius = 0.5 * (m1 + m3)
        if stretch != 1.0:
            radius = max(radius * stretch, 1.001 * 0.5 * float(np.linalg.norm(chord)))
        towards = np.cross(axis, chord)
        height = np.sqrt(max(radius**2 - 0.25 * float(chord @ chord), 0.0))
        origin = 0.5 * (first + last) + height * towards / np.linalg.norm(towards)
    return Arc(first, last, origin, axis, _angle(first - origin, last - origin))


def arc_by_angle(first: FloatArray, last: FloatArray, degrees: float, axis: FloatArray) -> Arc | None:
    """The arc of ``degrees`` about the direction ``axis``; ``None`` if the ends do not lie across it."""
    axis = axis / np.linalg.norm(axis)
    step = last - first
    chord = step - (step @ axis) * axis
    length = float(np.linalg.norm(chord))
    if length <= 1e-10 * float(np.linalg.norm(step)):
        return None
    angle = np.radians(degrees)
    outwards = np.cross(chord, axis) / length
    center = first + 0.5 * chord - outwards * (0.5 * length / np.tan(0.5 * angle))
    return Arc(first, last, center, axis, float(angle))


def straight(first: FloatArray, last: FloatArray) -> Curve:
    """The straight line between two points, which may be the same."""
    return lambda parameter: _with_ends(first + parameter[:, None] * (last - first), parameter, first, last)


_BASES = {
    "polyLine": np.array([[0, 1, 0, 0], [0, -1, 1, 0], [0, 0, 0, 0], [0, 0, 0, 0]], dtype=float),
    # Catmull-Rom, through all points, and the uniform B-spline, through the ends only.
    "spline": 0.5 * np.array([[0, 2, 0, 0], [-1, 0, 1, 0], [2, -5, 4, -1], [-1, 3, -3, 1]], dtype=float),
    "BSpline": np.array([[1, 4, 1, 0], [-3, 0, 3, 0], [3, -6, 3, 0], [-1, 3, -3, 1]], dtype=float) / 6.0,
}


@dataclass(frozen=True)
class Spline:
    """Piecewise polynomial by points (n, 3), of a kind of edge of a blockMeshDict: polyLine, spline or BSpline."""

    points: FloatArray
    kind: str

    def __call__(self, parameter: FloatArray) -> FloatArray:
        points = self.points
        lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        lengths /= lengths[-1]
        segment = np.clip(np.searchsorted(lengths, parameter, side="left") - 1, 0, len(points) - 2)
        width = lengths[segment + 1] - lengths[segment]
        local = (parameter - lengths[segment]) / np.where(width > 0, width, 1.0)
        padded = np.concatenate([2 * points[:1] - points[1:2], points, 2 * points[-1:] - points[-2:-1]])
        weights = (local[:, None] ** np.arange(4)) @ _BASES[self.kind]
        found = sum(weights[:, n, None] * padded[segment + n] for n in range(4))
        # blockMesh takes the points themselves at both ends of a segment, also where the B-spline misses them.
        found = np.where((local <= 0)[:, None], points[segment], found)
        found = np.where((local >= 1)[:, None], points[segment + 1], found)
        return _with_ends(found, parameter, points[0], points[-1])


def _with_ends(found: FloatArray, parameter: FloatArray, first: FloatArray, last: FloatArray) -> FloatArray:
    found[parameter < _END] = first
    found[parameter > 1 - _END] = last
    return found


def _angle(a: FloatArray, b: FloatArray) -> float:
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))
