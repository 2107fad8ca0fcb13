"""Prescribed motion of a boundary: rotate, translate, displace by formulas, or follow a table.

A motion is a sequence of steps applied in order to the undeformed positions. A ``fraction`` of every step can be
imposed, so that a large motion follows its own path: half of a rotation by 60 degrees is a rotation by 30 degrees, not
the midpoint of the chord.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...errors import MotionError
from ...grid import BoolArray, FloatArray, Grid
from ...wording import vector
from ..tables import BoundaryNodes, Matching, Positions, SurfaceData, Transfer, transfer
from .expression import Expression

VARIABLES = ("x", "y", "z", "t")
_ALIKE, _FEWEST = 0.1, 4
"""Displacements are positions if they differ from the coordinates by less than this part of the coordinates' spread, at
so many nodes at least."""
_SMALL_ANGLE = 0.2
"""Constant rotations by fewer degrees may be meant in radians (up to 11 degrees)."""
SMALLEST = 1e-30
"""Smaller displacements are set to zero, as their products with weights would be subnormal numbers."""
LARGEST = 1e30
"""Largest displacement, as for coordinates (``formats.files``): its square is finite."""


@dataclass(frozen=True)
class History:
    """Values (n, m) at ascending times (n,), linear between them; the same at all times unless ``timed``."""

    times: FloatArray
    values: FloatArray
    label: str
    timed: bool = True

    def at(self, time: float) -> FloatArray:
        """The values (m,) at a time. Raises MotionError before the first time and after the last one."""
        self.require(time)
        return np.array([np.interp(time, self.times, column) for column in self.values.T])

    def require(self, time: float) -> None:
        """Refuse a time that the table does not cover; up to half a millionth of a step beyond its ends is
        round-off."""
        first, last = float(self.times[0]), float(self.times[-1])
        slack = 1e-6 * (float(np.diff(self.times).min()) if len(self.times) > 1 else max(abs(first), 1.0))
        if self.timed and not first - slack <= time <= last + slack:
            raise MotionError(f"{self.label} has times from {first:g} to {last:g}; t = {time:g} is not among them")


class Step:
    """One entry of ``motion = [...]``, before and after it is bound to its nodes; many do not depend on them.

    ``notes`` of a bound one are for the report, ``match`` is that of a table.
    """

    notes: tuple[str, ...] = ()
    match: Transfer | None = None

    @property
    def formulas(self) -> Sequence[Expression]:
        """Formulas that it evaluates."""
        return ()

    @property
    def histories(self) -> Sequence[History]:
        """Tables over time that it follows."""
        return ()

    @property
    def names(self) -> frozenset[str]:
        """Variables and constants that it depends on."""
        timed = any(table.timed for table in self.histories)
        return frozenset({"t"} if timed else ()).union(*(formula.names for formula in self.formulas))

    def require(self, time: float, constants: Mapping[str, float]) -> None:
        """Refuse a time at which it is not defined."""
        for table in self.histories:
            table.require(time)

    def prepare(self, nodes: BoundaryNodes) -> Step:
        """Compute everything that depends only on the undeformed nodes."""
        return self

    def increment(self, current: FloatArray, values: Mapping[str, Any], fraction: float) -> FloatArray:
        """Displacement (n, 3) from the ``current`` positions; ``values`` are the variables at the undeformed nodes."""
        raise NotImplementedError


@dataclass(frozen=True)
class Rotate(Step):
    """Rotation by ``angle`` (degrees, right-handed) about ``axis`` through ``center``; all may be formulas."""

    angle: Expression
    axis: tuple[float, float, float]
    center: tuple[Expression, Expression, Expression]

    @property
    def formulas(self) -> Sequence[Expression]:
        return self.angle, *self.center

    def increment(self, current: FloatArray, values: Mapping[str, Any], fraction: float) -> FloatArray:
        arm = current - _vector(self.center, values, len(current))
        angle = np.deg2rad(fraction * np.broadcast_to(self.angle(values), len(current)))[:, None]
        # Scaled first, as squares of lengths above 1e154 overflow.
        axis = np.asarray(self.axis) / np.abs(self.axis).max()
        axis /= np.linalg.norm(axis)
        return turned(arm, angle * axis)


@dataclass(frozen=True)
class Displace(Step):
    """Displacement by three formulas of the undeformed x, y, z and t; a translation if they are constant."""

    vector: tuple[Expression, Expression, Expression]

    @property
    def formulas(self) -> Sequence[Expression]:
        return self.vector

    def increment(self, current: FloatArray, values: Mapping[str, Any], fraction: float) -> FloatArray:
        return fraction * _vector(self.vector, values, len(current))


Table = SurfaceData | Grid | Positions


@dataclass(frozen=True)
class Follow(Step):
    """Displacement from a table, from a grid that holds the deformed positions of the same nodes, or from positions by
    number.

    ``data`` is one of them, or a function that reads the one of ``times[n]``, which ascend: only one is in memory at a
    time.
    """

    data: Table | Callable[[int], Table]
    matching: Matching
    times: tuple[float, ...] = ()

    @property
    def names(self) -> frozenset[str]:
        return frozenset({"t"} if self.times else ())

    def table(self, number: int = 0) -> Table:
        """The table of ``times[number]``, or the only one."""
        return self.data(number) if callable(self.data) else self.data

    def require(self, time: float, constants: Mapping[str, float]) -> None:
        if self.times:
            level_at(self.times, time)

    def prepare(self, nodes: BoundaryNodes) -> Step:
        return Transferred(self, nodes)


class Transferred(Step):
    """A displacement transferred to the nodes, of several tables one at a time; ``match`` is that of the last one."""

    def __init__(self, follow: Follow, nodes: BoundaryNodes):
        self._follow, self._nodes, self._current = follow, nodes, 0
        self.match: Transfer = self._transfer(0)

    def increment(self, current: FloatArray, values: Mapping[str, Any], fraction: float) -> FloatArray:
        times = self._follow.times
        wanted = level_at(times, values["t"]) if times else 0
        if wanted != self._current:
            match = self._transfer(wanted)
            if (match.matched != self.match.matched).any():
                raise MotionError(
                    f"{match.label} matches {int(match.matched.sum())} boundary nodes, {self.match.label} others "
                    f"({int(self.match.matched.sum())}); expected all tables of a sequence to cover the same nodes"
                )
            self._current, self.match = wanted, match
        return fraction * self.match.displacement

    def _transfer(self, number: int) -> Transfer:
        return transfer(self._follow.table(number), self._follow.matching, self._nodes)


@dataclass(frozen=True)
class Motion:
    """Steps in the order in which they are applied, with the constants that their formulas may use."""

    steps: tuple[Step, ...]
    constants: Mapping[str, float]

    @property
    def names(self) -> frozenset[str]:
        """Variables and constants that the formulas use; ``t`` when the motion depends on time."""
        return frozenset().union(*(step.names for step in self.steps))

    @property
    def partial(self) -> bool:
        """Whether it is a table that moves only the nodes it matches."""
        return any(isinstance(step, Follow) and step.matching.partial for step in self.steps)

    def require(self, times: Iterable[float]) -> None:
        """Refuse times at which a step is not defined, before anything is computed. Raises MotionError naming the table
        and the time."""
        for time in times:
            for step in self.steps:
                step.require(time, self.constants)

    def matched_by(self, matching: Matching) -> Motion:
        """The motion with another matching of its tables."""
        steps = tuple(replace(step, matching=matching) if isinstance(step, Follow) else step for step in self.steps)
        return replace(self, steps=steps)

    def prepare(self, nodes: BoundaryNodes) -> PreparedMotion:
        """Bind the motion to its nodes; tables are matched here, once."""
        return PreparedMotion(tuple(step.prepare(nodes) for step in self.steps), self.constants, nodes)


GIVEN = Motion((), {})
"""The motion of boundaries whose displacement the caller passes as arrays, step by step."""


@dataclass(frozen=True)
class PreparedMotion:
    """A motion bound to its nodes."""

    steps: tuple[Step, ...]
    constants: Mapping[str, float]
    nodes: BoundaryNodes

    @property
    def matches(self) -> tuple[Transfer, ...]:
        """The matches of all tables, for the report."""
        return tuple(step.match for step in self.steps if step.match is not None)

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes of all steps, for the report."""
        return tuple(note for step in self.steps for note in step.notes)

    @property
    def moved(self) -> BoolArray:
        """Nodes (n,) bool that the motion moves: all, unless its tables match only some of them."""
        moved = np.ones(len(self.nodes.numbers), dtype=bool)
        for match in self.matches:
            moved &= match.matched
        return moved

    def displacement(self, time: float = 0.0, fraction: float = 1.0) -> FloatArray:
        """Displacement (n, 3) of the nodes for ``fraction`` of the motion at ``time``. Raises MotionError when a
        displacement is not finite, or larger than any length."""
        points = self.nodes.points
        x, y, z = points.T
        values = {**self.constants, "x": x, "y": y, "z": z, "t": time}
        total = np.zeros_like(points)
        for index, step in enumerate(self.steps):
            total = total + step.increment(points + total, values, fraction)
            bad: BoolArray = np.asarray(~(np.abs(total) <= LARGEST).all(axis=1))
            if bad.any():
                worst = int(np.argmax(bad))
                raise MotionError(
                    f"motion step {index + 1} gives the displacement {vector(total[worst])} at node "
                    f"{self.nodes.label(worst)} = {vector(points[worst])}, "
                    f"t = {time:g} ({int(bad.sum())} of {len(bad)} nodes); expected finite numbers up to "
                    f"{LARGEST:g}: check the formulas"
                )
        return np.where(np.abs(total) < SMALLEST, 0.0, total)


def level_at(times: Sequence[float], time: float) -> int:
    """Number of the file of a sequence with these ``times`` at one of them. Raises MotionError when there is none."""
    nearest = int(np.argmin(np.abs(np.asarray(times) - time)))
    spacing = np.diff(times).min() if len(times) > 1 else max(abs(time), abs(times[0]))
    if abs(times[nearest] - time) > 1e-6 * spacing:
        raise MotionError(
            f"the sequence of displacement files has no level at t = {time:g}; it has {len(times)} levels from "
            f"{times[0]:g} to {times[-1]:g}, the nearest at {times[nearest]:g}. Choose one of its times"
        )
    return nearest


def at_time(formula: Expression, time: float, constants: Mapping[str, Any], what: str) -> float:
    """The value of a formula of t and constants. Raises MotionError when it is not finite."""
    value = float(formula({**constants, "x": 0.0, "y": 0.0, "z": 0.0, "t": time}))
    if not abs(value) <= LARGEST:
        raise MotionError(f"the {what} {formula.text!r} is {value:g} at t = {time:g}; expected a finite number")
    return value


def turned(arm: FloatArray, turn: FloatArray) -> FloatArray:
    """Displacement (n, 3) of arms (n, 3) by rotation vectors (3,) or (n, 3) in radians; exactly zero for zero.

    Rodrigues' formula."""
    angle = np.linalg.norm(turn, axis=-1, keepdims=True)
    axis = turn / np.where(angle > 0, angle, 1.0)
    lift = np.cross(axis, arm)
    return np.asarray(np.sin(angle) * lift + 2 * np.sin(angle / 2) ** 2 * np.cross(axis, lift))


def _vector(parts: tuple[Expression, Expression, Expression], values: Mapping[str, Any], n: int) -> FloatArray:
    return np.stack([np.broadcast_to(np.asarray(part(values), dtype=np.float64), n) for part in parts], axis=1)


def positions_as_displacements(points: FloatArray, displacement: FloatArray) -> list[str]:
    """A warning if moving nodes (n, 3) have displacements (n, 3) that are nearly their own coordinates."""
    if len(points) < _FEWEST:
        return []
    spread = float(np.sqrt(((points - points.mean(axis=0)) ** 2).mean()))
    off = float(np.sqrt(((displacement - points) ** 2).mean()))
    # Far from the origin every motion is small relative to the coordinates.
    if spread == 0.0 or off > _ALIKE * spread:
        return []
    return [
        "the displacements are nearly the coordinates of the nodes themselves, so the wall would double its size: are "
        "they positions? The displacement is the new position minus the old one"
    ]


def doubtful_rotations(name: str, motion: Motion) -> list[str]:
    """A warning for every constant rotation of boundary ``name`` whose angle looks like radians or exceeds a turn."""
    warnings = []
    for step in motion.steps:
        if isinstance(step, Rotate) and not step.angle.names & set(VARIABLES):
            angle = float(np.asarray(step.angle(motion.constants)))
            doubt = f"angles are in degrees, and {angle:.4g} radians would be {np.degrees(angle):.4g}"
            if abs(angle) > 360.0:
                doubt = f"its nodes come to where a turn by {np.fmod(angle, 360.0):.4g} degrees takes them"
            if 0.0 < abs(angle) < _SMALL_ANGLE or abs(angle) > 360.0:
                warnings.append(f"boundary {name!r} is rotated by {angle:.4g} degrees; {doubt}")
    return warnings
