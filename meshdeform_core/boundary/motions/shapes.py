"""Motions by shapes: free-form deformation, given shapes times factors, and new shapes of airfoils, on which nodes keep
their relative arc length between leading and trailing edge."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from ...errors import MotionError
from ...grid import FloatArray, IntArray
from ...wording import vector
from ..tables import BoundaryNodes, Transfer
from .expression import Expression
from .motion import Step, at_time

_SAME = 1e-9
"""Points of a section closer than this fraction of the chord are one point."""
_CORNER = 60.0
"""Smallest angle (degrees) by which the outline turns at a trailing edge."""
_BASE = 0.1
"""A blunt trailing edge is shorter than this fraction of the chord."""
_NOSE = 0.01, 0.08
"""Inscribed circles that touch the outline at this distance from its end, in chords, tell where the mean line ends."""
_TOLD = 0.05
"""Turns of a new outline by fewer degrees may come from the digits of its file."""
_ROWS_AT_ONCE = 20_000
_GAUSS = np.polynomial.legendre.leggauss(8)


@dataclass(frozen=True)
class ControlMove:
    """A displacement of some control points: three formulas of t and constants, in the unit of the grid.

    ``points`` (m, 3) are indices from 0.
    """

    points: IntArray
    vector: tuple[Expression, Expression, Expression]


@dataclass(frozen=True)
class Lattice(Step):
    """Free-form deformation: a box of control points, products of Bernstein polynomials along its three edges.

    Nodes on and inside the box move, others do not. The box refers to positions after the motion's preceding steps.
    ``origin`` (3,) is a corner, ``edges`` (3, 3) has a row for each of the three edges from there, along which there
    are ``counts`` control points, at least 2.

    Source: T. W. Sederberg, S. R. Parry, "Free-form deformation of solid geometric models", SIGGRAPH 1986.
    """

    origin: FloatArray
    edges: FloatArray
    counts: tuple[int, int, int]
    moves: tuple[ControlMove, ...]

    @property
    def formulas(self) -> Sequence[Expression]:
        return [part for move in self.moves for part in move.vector]

    def require(self, time: float, constants: Mapping[str, float]) -> None:
        self._controls(time, constants)

    def _controls(self, time: float, constants: Mapping[str, float]) -> FloatArray:
        """Displacements (counts, 3) of the control points."""
        found = np.zeros((*self.counts, 3))
        for move in self.moves:
            i, j, k = move.points.T
            found[i, j, k] += [at_time(part, time, constants, "displacement of control points") for part in move.vector]
        return found

    def increment(self, current: FloatArray, values: Mapping[str, Any], fraction: float) -> FloatArray:
        place = (current - self.origin) @ np.linalg.inv(self.edges)
        inside = np.flatnonzero(((place >= 0) & (place <= 1)).all(axis=1))
        if inside.size == 0:
            low, high = current.min(axis=0), current.max(axis=0)
            raise MotionError(
                f"no node of the boundary is in the box at {vector(self.origin)} with edges "
                f"{', '.join(map(vector, self.edges))}; the nodes extend from {vector(low)} to {vector(high)}"
            )
        control = self._controls(float(values["t"]), values)
        displacement = np.zeros_like(current)
        for begin in range(0, len(inside), _ROWS_AT_ONCE):
            rows = inside[begin : begin + _ROWS_AT_ONCE]
            basis = []
            for count, along in zip(self.counts, place[rows].T, strict=True):
                power, x = np.arange(count), along[:, None]
                basis.append(scipy.special.comb(count - 1, power) * x**power * (1.0 - x) ** (count - 1 - power))
            displacement[rows] = np.einsum("ni,nj,nk,ijkd->nd", *basis, control, optimize=True)
        return fraction * displacement


@dataclass(frozen=True)
class Weighted(Step):
    """Displacements (m, n, 3) of the nodes, each times its factor (m,) at the variables' values."""

    shapes: FloatArray
    factors: Callable[[Mapping[str, Any]], FloatArray]
    match: Transfer | None = None
    notes: tuple[str, ...] = ()

    def increment(self, current: FloatArray, values: Mapping[str, Any], fraction: float) -> FloatArray:
        return np.asarray(fraction * np.tensordot(self.factors(values), self.shapes, axes=1))


@dataclass(frozen=True)
class Airfoil(Step):
    """A wall becomes the airfoil through given points, section by section.

    ``outline`` (n, 2) goes from the trailing edge over the upper side to the leading edge and back over the lower side;
    ``axes`` are the coordinates (0, 1, 2) along the chord and upwards; if it is ``fitted``, it is scaled, turned and
    shifted so that leading and trailing edge stay where they are. ``label`` is the name of the file.
    """

    outline: FloatArray
    axes: tuple[int, int]
    fitted: bool
    label: str

    def prepare(self, nodes: BoundaryNodes) -> Step:
        """Find the outline of the nodes and the position of each on the new one. Raises MotionError when the nodes are
        not the surface of an airfoil, or the trailing edges differ in kind."""
        places = nodes.points[:, list(self.axes)]
        # Distinct points of the projection, and that of every node.
        rounded = np.round(places / (_SAME * float(np.ptp(places, axis=0).max())))
        _, first, of_node = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
        points, of_node = places[first], of_node.reshape(-1)
        loop = _loop(points, of_node[nodes.faces], self.label)
        start, count, sharp = _trailing_edge(points[loop], self.label)
        loop = np.roll(loop, -start)
        ring = points[loop]
        old = Outline(np.concatenate([ring[:count], ring[: int(sharp)]]), "the wall")
        target = Outline(self.outline, self.label)
        notes: tuple[str, ...] = ()
        if self.fitted:
            p, q = (np.array([line.leading, line.trailing]) @ [1.0, 1j] for line in (old, target))
            factor = (p[1] - p[0]) / (q[1] - q[0])
            placed = p[0] + factor * (self.outline @ [1.0, 1j] - q[0])
            target = Outline(np.stack([placed.real, placed.imag], axis=1), self.label)
            if abs(turn := float(np.degrees(np.angle(factor)))) > _TOLD:
                notes = (f"{self.label} is turned by {turn:.3g} degrees, so that leading and trailing edge stay in "
                         f'place; with fit = "none" it is where the file has it',)  # fmt: skip
        if target.blunt == sharp:
            kinds = ("sharp", "blunt") if sharp else ("blunt", "sharp")
            raise MotionError(
                f"{self.label} has a {kinds[1]} trailing edge, that of the wall at {vector(old.trailing)} is "
                f"{kinds[0]}; expected the same"
            )
        found = np.empty_like(points)
        found[loop[:count]] = target.at(old.parts[:count])
        length = np.cumsum(np.linalg.norm(np.diff(np.concatenate([ring[count - 1 :], ring[:1]]), axis=0), axis=1))
        lower, upper = target.points[-1], target.points[0]
        found[loop[count:]] = lower + (length[:-1] / length[-1])[:, None] * (upper - lower)
        displacement = np.zeros_like(nodes.points)
        displacement[:, list(self.axes)] = (found - points)[of_node]
        return Weighted(displacement[None], lambda values: np.ones(1), notes=notes)


class Outline:
    """A cubic spline through the points (n, 2) of an airfoil, open at the trailing edge, with the length of the polygon
    up to each of them (n,), ``knots``, as parameter.

    ``lengths`` (n,) are the arc lengths of the points, ``half`` is that of the leading edge ``leading`` (2,), where the
    mean line through the centres of inscribed circles ends.
    """

    def __init__(self, points: FloatArray, label: str):
        """No two successive points may coincide."""
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        if len(points) < 5 or steps.min() <= _SAME * np.ptp(points, axis=0).max():
            at = int(np.argmin(steps)) if len(points) > 1 else 0
            raise MotionError(
                f"{label}: {len(points)} points of an airfoil, of which {at + 1} and {at + 2} may be the same; "
                "expected at least 5 different ones in order"
            )
        self.points, self.knots = points, np.concatenate([[0.0], np.cumsum(steps)])
        self.spline = scipy.interpolate.CubicSpline(self.knots, points)
        farthest = int(np.argmax(np.linalg.norm(points - 0.5 * (points[0] + points[-1]), axis=1)))
        if not 2 <= farthest <= len(points) - 3:
            raise MotionError(f"{label}: its leading edge is at an end of the list; the trailing edge must be")
        self.lengths = np.append(0.0, np.cumsum(_arc(self.spline, self.knots[:-1], self.knots[1:])))
        nose = _nose(self.spline, self.knots, farthest)
        before = int(np.searchsorted(self.knots, nose, side="right")) - 1
        self.half = self.lengths[before] + float(_arc(self.spline, self.knots[before, None], np.array([nose]))[0])
        self.leading = self.spline(nose)

    @property
    def trailing(self) -> FloatArray:
        """The middle of the trailing edge."""
        return np.asarray(0.5 * (self.points[0] + self.points[-1]))

    @property
    def blunt(self) -> bool:
        gap = float(np.linalg.norm(self.points[0] - self.points[-1]))
        return gap > _SAME * float(np.ptp(self.points, axis=0).max())

    @property
    def parts(self) -> FloatArray:
        """Relative arc length (n,) of every point: 0 to 1 from the trailing to the leading edge, 1 to 2 back."""
        second = 1.0 + (self.lengths - self.half) / (self.lengths[-1] - self.half)
        return np.where(self.lengths <= self.half, self.lengths / self.half, second)

    def at(self, parts: FloatArray) -> FloatArray:
        """Points (n, 2) of the spline at relative arc lengths ``parts``; given points are reproduced exactly."""
        half, whole = self.half, self.lengths[-1]
        length = np.where(parts <= 1.0, parts * half, half + (parts - 1.0) * (whole - half))
        segment = np.clip(np.searchsorted(self.lengths, length, side="right") - 1, 0, len(self.lengths) - 2)
        low, high = self.knots[segment], self.knots[segment + 1]
        share = (length - self.lengths[segment]) / (self.lengths[segment + 1] - self.lengths[segment])
        place = low + share * (high - low)
        for _ in range(30):
            speed = np.linalg.norm(self.spline(place, 1), axis=1)
            error = self.lengths[segment] + _arc(self.spline, low, place) - length
            place = np.clip(place - error / np.maximum(speed, 1e-300), low, high)
        return np.asarray(self.spline(place))


def _nose(spline: scipy.interpolate.CubicSpline, knots: FloatArray, farthest: int) -> float:
    """Parameter of the leading edge: the mean line, continued from inscribed circles behind it, meets the outline.

    The point farthest from the trailing edge is off the mean line of a cambered section, by .18 degrees for NACA 4412.
    """
    tip, trailing = spline(knots[farthest]), 0.5 * (spline(knots[0]) + spline(knots[-1]))
    chord = float(np.linalg.norm(trailing - tip))
    # Complex numbers: the real axis along the chord, in chords, from the farthest point.
    axis = complex(*(trailing - tip)) / chord
    low, high = max(knots[farthest] - 0.3 * chord, knots[0]), min(knots[farthest] + 0.3 * chord, knots[-1])
    place = np.linspace(low, high, 2001)
    outline = (spline(place) - tip) @ [1.0, 1j] / (axis * chord)
    tangent = spline(place, 1) @ [1.0, 1j] / axis
    inward = 1j * tangent / np.abs(tangent)
    some = np.flatnonzero((outline.real > _NOSE[0]) & (outline.real < _NOSE[1]))[::3]
    arm = outline - outline[some, None]
    height = (arm * inward[some, None].conjugate()).real
    apart = (height > 1e-9) & (np.abs(place - place[some, None]) > 2e-3 * chord)
    # The largest circles that touch the outline there and have no other point of it inside.
    radius = np.divide(np.abs(arm) ** 2, 2.0 * height, out=np.full(arm.shape, np.inf), where=apart).min(axis=1)
    line = (outline[some] + inward[some] * radius)[np.isfinite(radius)]
    if len(line) < 3:
        return float(knots[farthest])
    off = outline.imag - np.polyval(np.polyfit(line.real, line.imag, 2), outline.real)
    crossing = np.flatnonzero((off[:-1] * off[1:] <= 0) & (np.abs(place[1:] - knots[farthest]) < 0.05 * chord))
    if not len(crossing):
        return float(knots[farthest])
    at = crossing + off[crossing] / np.where(off[crossing] == off[crossing + 1], 1.0, off[crossing] - off[crossing + 1])
    found = np.interp(at, np.arange(len(place)), place)
    return float(found[np.argmin(np.abs(found - knots[farthest]))])


def _arc(spline: scipy.interpolate.CubicSpline, low: FloatArray, high: FloatArray) -> FloatArray:
    """Arc lengths (n,) of pieces of a spline."""
    x, w = _GAUSS
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    speed = np.linalg.norm(spline(middle[:, None] + half[:, None] * x, 1), axis=2)
    return np.asarray(half * (speed @ w))


def _loop(points: FloatArray, faces: IntArray, label: str) -> IntArray:
    """The points in order around the section, from edges of the projected faces (m, corners)."""
    pairs = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    pairs = np.unique(np.sort(pairs[pairs[:, 0] != pairs[:, 1]], axis=1), axis=0)
    count = np.bincount(pairs.ravel(), minlength=len(points))
    if (count != 2).any():
        at = points[int(np.argmax(count != 2))].tolist()
        raise MotionError(
            f"{label}: the boundary is not a closed outline extruded along one axis; at {at} of its sections "
            f"{int(count[count != 2][0])} edges meet, expected 2"
        )
    ring = scipy.sparse.csr_matrix((np.ones(len(pairs)), pairs.T), shape=(len(points),) * 2)
    loop = scipy.sparse.csgraph.depth_first_order(ring, 0, directed=False, return_predecessors=False)
    if len(loop) < len(points):
        raise MotionError(f"{label}: the boundary has several outlines; expected one airfoil for each boundary entry")
    x, y = points[loop].T
    return loop if float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) > 0 else loop[::-1]


def _trailing_edge(ring: FloatArray, label: str) -> tuple[int, int, bool]:
    """Index at which the upper side of a counter-clockwise outline begins, number of points up to the lower corner, and
    whether both corners are one: a sharp trailing edge.
    """
    ahead = np.roll(ring, -1, axis=0) - ring
    behind = np.roll(ahead, 1, axis=0)
    cross = behind[:, 0] * ahead[:, 1] - behind[:, 1] * ahead[:, 0]
    corners = np.flatnonzero(np.degrees(np.abs(np.arctan2(cross, (behind * ahead).sum(axis=1)))) > _CORNER)
    if len(corners) == 1:
        return int(corners[0]), len(ring), True
    chord = float(np.ptp(ring, axis=0).max())
    if len(corners) == 2 and np.linalg.norm(ring[corners[1]] - ring[corners[0]]) < _BASE * chord:
        # The base is the shorter way from one corner to the other, and leads upwards.
        one, two = corners.tolist()
        forth = two - one
        lower, upper = (one, two) if forth < len(ring) - forth else (two, one)
        return upper, (lower - upper) % len(ring) + 1, False
    raise MotionError(
        f"{label}: the section of the wall has {len(corners)} corners, at {ring[corners].tolist()[:4]}; expected "
        "a sharp trailing edge, or two corners close to each other"
    )
