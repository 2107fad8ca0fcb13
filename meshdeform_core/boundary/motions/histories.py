"""Motions given as tables over time: rigid bodies with six degrees of freedom, structural modes, and beams."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import scipy

from ...errors import MotionError
from ...grid import FloatArray, Grid
from ...numerics.arrays import lengths
from ...numerics.rotation import nearest_branch
from ...wording import vector
from ..tables import BoundaryNodes, Matching, SurfaceData, transfer
from .expression import Expression
from .motion import History, Step, at_time, turned
from .shapes import Weighted

_LARGEST_TURN = 170.0
"""Degrees between neighbouring stations: at 180 the shorter way is not the one meant."""
_CLOSEST = 1e-9
"""Least distance of stations along the line, relative to its length."""


@dataclass(frozen=True)
class RigidHistory(Step):
    """A rigid body: rotation about ``center``, a point of the undeformed body, then ``translation`` (grid length unit),
    both from a table.

    ``rotation`` are quaternions x, y, z, w, between which the body turns uniformly, or three angles in degrees about
    the axes of ``order``, as in scipy: ``"ZYX"`` are the body's own, ``"xyz"`` fixed ones, empty for quaternions.
    """

    translation: History
    rotation: History | None
    order: str
    center: tuple[float, float, float]

    @property
    def histories(self) -> Sequence[History]:
        return [table for table in (self.translation, self.rotation) if table is not None]

    def increment(self, current: FloatArray, values: Mapping[str, Any], fraction: float) -> FloatArray:
        time = float(values["t"])
        shift = fraction * self.translation.at(time)
        if self.rotation is None:
            return np.broadcast_to(shift, current.shape)
        arm = current - np.array(self.center)
        if self.order:
            angles = fraction * self.rotation.at(time)
            turn = scipy.spatial.transform.Rotation.from_euler(self.order, angles, degrees=True).as_rotvec()
        else:
            self.rotation.require(time)
            times, turns = self.rotation.times, scipy.spatial.transform.Rotation.from_quat(self.rotation.values)
            within = np.clip(time, times[0], times[-1])
            found = scipy.spatial.transform.Slerp(times, turns)(within) if len(times) > 1 else turns[0]
            turn = fraction * found.as_rotvec()
        return np.asarray(shift + turned(arm, turn))


@dataclass(frozen=True)
class Modes(Step):
    """The sum of shapes, each times its amplitude: a history, or formulas of t and constants."""

    shapes: tuple[SurfaceData | Grid, ...]
    amplitudes: History | tuple[Expression, ...]
    matching: Matching

    @property
    def formulas(self) -> Sequence[Expression]:
        return () if isinstance(self.amplitudes, History) else self.amplitudes

    @property
    def histories(self) -> Sequence[History]:
        return [self.amplitudes] if isinstance(self.amplitudes, History) else []

    def require(self, time: float, constants: Mapping[str, float]) -> None:
        self._factors({**constants, "t": time})

    def _factors(self, values: Mapping[str, Any]) -> FloatArray:
        """The amplitudes (m,) at a time."""
        time = float(values["t"])
        if isinstance(self.amplitudes, History):
            return self.amplitudes.at(time)
        return np.array([at_time(part, time, values, "amplitude") for part in self.amplitudes])

    def prepare(self, nodes: BoundaryNodes) -> Step:
        matches = [transfer(shape, self.matching, nodes) for shape in self.shapes]
        return Weighted(np.stack([match.displacement for match in matches]), self._factors, matches[0])


@dataclass(frozen=True)
class Beam(Step):
    """A beam whose sections move rigidly.

    A node X belongs to the section at s, its distance from the first station X_0 along the straight line to the last
    one. With the undeformed axis P(s) it moves to::

        x = X_0 + u_0 + R_0 (P(s) - X_0 + d(s) + exp(w(s)) (X - P(s)))

    u_0 and R_0 are displacement and rotation of the first station; d and w, displacement and rotation vector of the
    others as seen from it, so that a rigid motion of the whole beam is reproduced. P, d and w are cubic Hermite splines
    through the stations, with the slopes of parabolas through three: errors of the third order in their distance. Nodes
    beyond an end move with its section. Between times u_0, d and w are linear, and R_0 turns uniformly.

    ``stations`` (n, 3) are undeformed, ``shape`` is d and w (radians), (t, 6 n), ``first`` the motion of the first one.
    """

    stations: FloatArray
    shape: History
    first: RigidHistory
    notes: tuple[str, ...] = ()

    @classmethod
    def of(cls, stations: FloatArray, displacement: History, turns: FloatArray) -> Beam:
        """The beam from displacements (t, 3 n) and rotation vectors (t, n, 3) in radians. Raises MotionError naming the
        stations, when there are fewer than two, they do not follow each other along the line, or the way from one
        rotation to the next is not clear."""
        times, label = displacement.times, displacement.label
        place = _along(stations, stations)
        if len(stations) < 2:
            raise MotionError(f"{label} has one station; expected at least two, along a line")
        if not place[-1] > 0:
            raise MotionError(f"{label}: its first and last stations lie at one point; expected stations along a line")
        back = np.flatnonzero(np.diff(place) <= _CLOSEST * place[-1])
        if back.size:
            one, two = stations[back[0] : back[0] + 2]
            raise MotionError(
                f"{label}: stations {back[0] + 1} and {back[0] + 2}, {vector(one)} and {vector(two)}, coincide or go "
                "back along the line from the first to the last; expected them in the order of the beam"
            )
        moved = displacement.values.reshape(len(times), -1, 3)
        frames = scipy.spatial.transform.Rotation.from_rotvec(turns[:, 0])
        seen = np.zeros((len(times), len(stations), 6))
        arms = stations - stations[0]
        for n in range(1, len(stations)):
            seen[:, n, :3] = frames.inv().apply(arms[n] + moved[:, n] - moved[:, 0]) - arms[n]
            # Rotation vectors are up to half a turn: of those of the same rotation, the nearest to the station before.
            turn = (frames.inv() * scipy.spatial.transform.Rotation.from_rotvec(turns[:, n])).as_rotvec()
            before = seen[:, n - 1, 3:]
            # A whole number of turns has no axis but that of the station before.
            turn[(lengths(turn) < 1e-9) & (lengths(before) > np.pi)] = 0.0
            seen[:, n, 3:] = nearest_branch(turn, before)
        angles = np.degrees(np.linalg.norm(np.diff(seen[..., 3:], axis=1), axis=2))
        if angles.max() > _LARGEST_TURN:
            level, n = map(int, np.unravel_index(int(angles.argmax()), angles.shape))
            raise MotionError(
                f"{label}: stations {n + 1} and {n + 2} are turned by {angles[level, n]:.0f} degrees from each other "
                f"at t = {times[level]:g}; expected up to {_LARGEST_TURN:g}: give stations between"
            )
        x, y, z = stations[0]
        shift, rotation, shape = (
            replace(displacement, values=values)
            for values in (moved[:, 0], frames.as_quat(), seen.reshape(len(times), -1))
        )
        return cls(stations, shape, RigidHistory(shift, rotation, "", (x, y, z)))

    @property
    def histories(self) -> Sequence[History]:
        return [self.shape]

    def prepare(self, nodes: BoundaryNodes) -> Step:
        length = float(_along(self.stations[-1:], self.stations)[0])
        place = _along(nodes.points, self.stations)
        low, high = float(place.min()), float(place.max())
        beyond, beside = max(-low, high - length), min(high, length) - max(low, 0.0)
        if beyond <= 0.01 * length and beside >= 0.5 * length:
            return self
        note = (
            f"{self.shape.label} has stations from 0 to {length:g} along the beam, the nodes lie from {low:.4g} to "
            f"{high:.4g}; those beyond an end move with its section: check the length unit"
        )
        return replace(self, notes=(note,))

    def increment(self, current: FloatArray, values: Mapping[str, Any], fraction: float) -> FloatArray:
        seen = self.shape.at(float(values["t"])).reshape(-1, 6)
        place = _along(self.stations, self.stations)
        ends: Literal[1, 2] = 2 if len(place) > 2 else 1
        at_stations = np.hstack([self.stations, seen])
        slopes = np.gradient(at_stations, place, axis=0, edge_order=ends)
        spline = scipy.interpolate.CubicHermiteSpline(place, at_stations, slopes)
        axis, shift, turn = np.split(spline(np.clip(_along(current, self.stations), 0.0, place[-1])), 3, axis=1)
        bent = fraction * shift + turned(current - axis, fraction * turn)
        return np.asarray(bent + self.first.increment(current + bent, values, fraction))


def _along(points: FloatArray, stations: FloatArray) -> FloatArray:
    """Distances (m,) of points (m, 3) from the first station, along the straight line from it to the last."""
    line = stations[-1] - stations[0]
    size = float(np.linalg.norm(line))
    return np.asarray((points - stations[0]) @ (line / size if size > 0 else line))
