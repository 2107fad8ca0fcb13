"""Motions given as tables over time: rigid bodies with six degrees of freedom, and structural modes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from ...errors import MotionError
from ...grid import FloatArray, Grid
from ..tables.matching import BoundaryNodes, Matching, SurfaceData
from ..tables.transfer import transfer
from .expression import Expression
from .motion import Imposed, PreparedStep, Step, at_time, turned


@dataclass(frozen=True)
class History:
    """Values (n, m) at ascending times (n,), linear between them."""

    times: FloatArray
    values: FloatArray
    label: str

    def at(self, time: float) -> FloatArray:
        """The values (m,) at a time.

        Raises
        ------
        MotionError
            Before the first time and after the last one.
        """
        self.require(time)
        return np.array([np.interp(time, self.times, column) for column in self.values.T])

    def require(self, time: float) -> None:
        """Refuse a time that the table does not cover; up to half a millionth of a step beyond its ends is
        round-off."""
        first, last = float(self.times[0]), float(self.times[-1])
        slack = 1e-6 * (float(np.diff(self.times).min()) if len(self.times) > 1 else max(abs(first), 1.0))
        if not first - slack <= time <= last + slack:
            raise MotionError(f"{self.label} has times from {first:g} to {last:g}; t = {time:g} is not among them")


@dataclass(frozen=True)
class RigidHistory(Step, PreparedStep):
    """A rigid body: rotation about a point that is fixed in the body, then translation, both from a table.

    Attributes
    ----------
    translation : columns x, y, z (grid length unit)
    rotation : quaternions x, y, z, w, or three angles in degrees
    order : axes of the angles, as in scipy: ``"ZYX"`` about the body's own axes, ``"xyz"`` about fixed ones; empty for
        quaternions, between which the rotation is uniform
    center : the point about which it turns, undeformed
    """

    translation: History
    rotation: History | None
    order: str
    center: tuple[float, float, float]

    @property
    def names(self) -> frozenset[str]:
        return frozenset({"t"})

    def require(self, time: float, constants: Mapping[str, float]) -> None:
        for table in (self.translation, self.rotation):
            if table is not None:
                table.require(time)

    def increment(self, current: FloatArray, values: Mapping[str, Any], fraction: float) -> FloatArray:
        time = float(values["t"])
        shift = fraction * self.translation.at(time)
        if self.rotation is None:
            return np.broadcast_to(shift, current.shape)
        arm = current - np.array(self.center)
        return np.asarray(shift + turned(arm, self._turn(self.rotation, time, fraction)))

    def _turn(self, rotation: History, time: float, fraction: float) -> FloatArray:
        """The rotation vector (3,) of a fraction of the rotation at a time."""
        if self.order:
            return np.asarray(
                scipy.spatial.transform.Rotation.from_euler(
                    self.order, fraction * rotation.at(time), degrees=True
                ).as_rotvec()
            )
        rotation.require(time)
        turns = scipy.spatial.transform.Rotation.from_quat(rotation.values)
        within = np.clip(time, rotation.times[0], rotation.times[-1])
        found = scipy.spatial.transform.Slerp(rotation.times, turns)(within) if len(rotation.times) > 1 else turns[0]
        return np.asarray(fraction * found.as_rotvec())


@dataclass(frozen=True)
class Modes(Step):
    """The sum of shapes, each times its amplitude: a history, or formulas of t and constants."""

    shapes: tuple[SurfaceData | Grid, ...]
    amplitudes: History | tuple[Expression, ...]
    matching: Matching

    @property
    def names(self) -> frozenset[str]:
        if isinstance(self.amplitudes, History):
            return frozenset({"t"})
        return frozenset().union(*(part.names for part in self.amplitudes))

    def require(self, time: float, constants: Mapping[str, float]) -> None:
        self.factors(time, constants)

    def factors(self, time: float, constants: Mapping[str, float]) -> FloatArray:
        """The amplitudes (m,) at a time."""
        if isinstance(self.amplitudes, History):
            return self.amplitudes.at(time)
        return np.array([at_time(part, time, constants, "amplitude") for part in self.amplitudes])

    def prepare(self, nodes: BoundaryNodes) -> ImposedModes:
        matches = [transfer(shape, self.matching, nodes) for shape in self.shapes]
        return ImposedModes(matches[0], self, np.stack([match.displacement for match in matches]))


@dataclass(frozen=True)
class ImposedModes(Imposed):
    """Shapes (m, n, 3) that have been transferred to the nodes; ``match`` is the transfer of the first one."""

    modes: Modes
    shapes: FloatArray

    def increment(self, current: FloatArray, values: Mapping[str, Any], fraction: float) -> FloatArray:
        factors = self.modes.factors(float(values["t"]), values)
        return np.asarray(fraction * np.tensordot(factors, self.shapes, axes=1))
