"""From interpolated rigid motions to the displacement of nodes; the average rigid or affine motion of a boundary, the
frame in which the remainder of its motion is interpolated.

Plain array operations, as derivatives record them (:mod:`.tape`). Those of interpolated motions take the weighted sums
column by column, weight first, and the coordinates of nodes relative to the origin that the translations refer to.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from .arrays import FloatArray, weighted_total
from .tape import Tracked, plain

Columns = Sequence[FloatArray] | FloatArray
Triple = tuple[FloatArray, ...]
"""The three components (n,) of vectors, apart: short rows would take most of the time."""
_SMALL = 1e-2
"""Squared angle (radians) below which trigonometric functions are replaced by series."""
_FLATTEST = 1e-3
"""Smallest ratio of the stretches of an affine frame along its axes; flatter ones have no accurate inverse."""
_FOLLOWS = 0.1
"""Share of the motion within the rigid frame, as mean squares, that may remain within an affine one: a boundary that
deforms by more has no affine motion, and that of its mean would only shear the layers along it."""


class Transition(NamedTuple):
    """Transition, in kind ``lie``, between the moving sources and all others, which share the twist ``rest`` (6,).

    Total weights decay like distance^-power far from the sources, and like distance^-near closer than the breadth of
    the surface, where they exceed ``crossing``. ``width`` is the length of the parabolic ends of the share relative to
    the gap, 0 without a transition; see :func:`_share`.
    """

    rest: FloatArray
    power: float
    near: float
    crossing: float
    width: float


NO_TRANSITION = Transition(np.zeros(6), 1.0, 1.0, 1.0, 0.0)
"""No transition: every source counts by its weight."""

WIDTHS = {"none": 3, "quaternion": 7, "division": 7, "blend": 12, "lie": 6}
"""Number of values per source that :func:`finish` needs for each kind."""


def finish(
    kind: str, sums: Columns, points: FloatArray, steps: int = 1, transition: Transition = NO_TRANSITION
) -> FloatArray:
    """Displacements (n, 3) of points (n, 3) for one of the kinds of :data:`WIDTHS`.

    ``sums`` are 1 + k columns (n,), the total weight first, then the weighted sums of the values; with a transition,
    the last one is the total weight of the moving sources, and twists are relative to that of all others. A mean
    quaternion and translation are applied ``steps`` times.
    """
    x = tuple(np.ascontiguousarray(points.T))
    found: tuple[FloatArray, ...]
    # Weights of any size: what is no number is found by whoever judges the grid.
    with np.errstate(all="ignore"):
        if kind in ("quaternion", "division"):
            # Mean quaternion, normalised, and mean translation (eqs. 19, 20), applied ``steps`` times (eqs. 26-28).
            q0, q1, q2, q3 = sums[1:5]
            norm, inverse = 1.0 / np.sqrt(q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3), 1.0 / sums[0]
            scalar, axis, shift = q0 * norm, (q1 * norm, q2 * norm, q3 * norm), [part * inverse for part in sums[5:8]]
            d0, d1, d2 = np.zeros((3, len(x[0])))
            for _ in range(steps):
                once = _cross(axis, (x[0] + d0, x[1] + d1, x[2] + d2))
                twice = _cross(axis, once)
                d0, d1, d2 = (
                    d + 2.0 * (scalar * c + e) + t for d, c, e, t in zip((d0, d1, d2), once, twice, shift, strict=True)
                )
            found = d0, d1, d2
        elif kind == "lie":
            found = _by_twist(sums, x, transition)
        else:
            inverse, found = 1.0 / sums[0], (sums[1], sums[2], sums[3])
            if kind == "blend":
                # Mean of the predicted positions R_i (x - x_i) + y_i (Luke et al. 2012): an affine map of x.
                found = tuple(sums[d] * x[0] + sums[d + 1] * x[1] + sums[d + 2] * x[2] for d in (1, 4, 7))
                found = tuple(part + sums[10 + d] for d, part in enumerate(found))
            # Or, for ``none``, the mean displacement (eq. 14).
            found = tuple(part * inverse for part in found)
    return np.stack(found, axis=1)


def _cross(a: Triple, b: Triple) -> Triple:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _by_twist(sums: Columns, x: Triple, transition: Transition) -> Triple:
    """Exponential of the mean twist: (R - 1) x + V v with R = exp w."""
    if transition.width > 0.0:
        moving = sums[7]
        acts = plain(moving) > 0.0
        others = np.maximum(sums[0] - moving, 0.0)
        divisor = np.where(acts, moving, 1.0)
        inverse = np.where(acts, _share(divisor, others, transition), 0.0) / divisor
    else:
        inverse = 1.0 / sums[0]
    w0, w1, w2, v0, v1, v2 = (part * inverse + transition.rest[d] for d, part in enumerate(sums[1:7]))
    w = w0, w1, w2
    angle2 = w0 * w0 + w1 * w1 + w2 * w2
    small = plain(angle2) < _SMALL
    # (1 - cos a) / a^2 and (a - sin a) / a^3.
    square = np.where(small, 1.0, angle2)
    angle = np.sqrt(square)
    half = np.sin(0.5 * angle)
    b = 2.0 * half * half / square
    c = (angle - np.sin(angle)) / (square * angle)
    if small.any():
        series = 1 / 24 - angle2 * (1 / 720 - angle2 * (1 / 40320 - angle2 * (1 / 3628800)))
        b = np.where(small, 0.5 - angle2 * series, b)
        series = 1 / 120 - angle2 * (1 / 5040 - angle2 * (1 / 362880 - angle2 * (1 / 39916800)))
        c = np.where(small, 1 / 6 - angle2 * series, c)
    # exp of a twist displaces x by V(w) (w cross x + v): the velocity at x, integrated along the screw motion.
    u0, u1, u2 = _cross(w, x)
    u = u0 + v0, u1 + v1, u2 + v2
    once = _cross(w, u)
    d0, d1, d2 = (a + b * e + c * f for a, e, f in zip(u, once, _cross(w, once), strict=True))
    return d0, d1, d2


def _share(moving: FloatArray, rest: FloatArray, transition: Transition) -> FloatArray:
    """Share (n,) of the moving sources in the motion, from their total weight and that of all other sources.

    The ratio of the distances gives the position in the gap, 0 at the moving boundary and 1 at the resting one. The
    share falls linearly across the gap, with parabolic ends of length ``width``, so that nodes at walls move rigidly.
    """
    width, felt = transition.width, plain(rest) > 0.0
    # The logarithm of the ratio of the distances: less work than powers of both weights.
    ratio = _log_closeness(np.where(felt, rest, 1.0), transition) - _log_closeness(moving, transition)
    near = (plain(ratio) < 0.0) | ~felt
    smaller = np.where(felt, np.exp(np.where(near, ratio, -ratio)), 0.0)
    end = smaller / (1.0 + smaller)
    part = np.where(plain(end) < width, end * end * (0.5 / width), end - 0.5 * width) * (1.0 / (1.0 - width))
    return np.where(near, 1.0 - part, part)


def _log_closeness(weight: FloatArray, transition: Transition) -> FloatArray:
    """Logarithm of the inverse distance, but for a constant, that corresponds to a positive total weight; see
    :class:`Transition`."""
    far: FloatArray = np.log(weight) * (1.0 / transition.power)
    if transition.near == transition.power:
        return far
    bend: FloatArray = np.log(np.hypot(1.0, weight * (1.0 / transition.crossing)))
    return far + bend * (1.0 / transition.near - 1.0 / transition.power)


@dataclass(frozen=True)
class Frame:
    """A linear map ``turn`` (3, 3) about ``centre`` (3,), a rotation unless said otherwise, or none, followed by the
    translation ``shift`` (3,); ``back`` (3, 3) is the transpose of the inverse of ``turn``."""

    shift: FloatArray
    turn: FloatArray | None = None
    centre: FloatArray | None = None
    back: FloatArray | None = None

    @classmethod
    def fitted(
        cls,
        points: FloatArray,
        displacement: FloatArray,
        weight: FloatArray,
        normal: FloatArray | None,
        stretches: bool,
    ) -> Frame:
        """The rigid motion of ``points`` (n, 3) that is the weighted least-squares fit to ``displacement`` (n, 3); if
        it ``stretches``, the affine one where the points follow that, with a smooth transition to the rigid one where
        they do not.

        The rotation is that of Kabsch (Acta Cryst. A32, 922, 1976); with a ``normal`` (3,), it is about this axis,
        along which nothing stretches.
        """
        share = weight / weight.sum()
        shift, centre = weighted_total(share, displacement), weighted_total(share, points)
        if not isinstance(displacement, Tracked) and not (displacement - shift).any():
            return cls(shift)
        arm, rest = points - centre, displacement - shift
        moment = (arm + rest).T @ (share[:, None] * arm)
        if normal is not None:
            moment = moment + np.linalg.norm(moment) * np.outer(normal, normal)
        turn = _nearest_rotation(moment)
        if not stretches:
            return cls(shift, turn, centre, turn)
        inertia = arm.T @ (share[:, None] * arm)
        if normal is not None:
            inertia += np.linalg.norm(inertia) * np.outer(normal, normal)
        affine = np.eye(3) + rest.T @ (share[:, None] * arm) @ np.linalg.pinv(inertia)
        left, whole = ((share[:, None] * (rest - arm @ (map - np.eye(3)).T) ** 2).sum() for map in (affine, turn))
        size = np.linalg.svd(plain(affine), compute_uv=False)
        flat = size[2] <= _FLATTEST * size[0] or np.linalg.det(plain(affine)) <= 0.0
        if flat or plain(left) >= _FOLLOWS * plain(whole):
            return cls(shift, turn, centre, turn)
        turn = turn + (affine - turn) * (1.0 - left / (_FOLLOWS * whole)) ** 2
        inverse: FloatArray = np.linalg.inv(plain(turn)).T
        back: Any = inverse
        if isinstance(turn, Tracked):
            # The derivative is its own transpose.
            back = turn.tape.result(inverse, [(turn, *2 * (lambda t: -inverse @ t.T @ inverse,))])
        return cls(shift, turn, centre, back)

    def relative(self, points: FloatArray, displacement: FloatArray) -> FloatArray:
        """Displacement (n, 3) of ``points`` (n, 3) as seen from the frame."""
        rest = displacement - self.shift
        if self.back is None or self.centre is None:
            return rest
        # A single product with the inverse leaves only round-off of the motion itself.
        arm = points - self.centre
        inside: FloatArray = (arm + rest) @ self.back - arm
        return inside

    def absolute(self, points: FloatArray, displacement: FloatArray) -> FloatArray:
        """The inverse of :meth:`relative`."""
        if self.turn is None or self.centre is None:
            return displacement + self.shift
        carried = (points - self.centre) @ (self.turn - np.eye(3)).T
        moved: FloatArray = displacement @ self.turn.T + carried + self.shift
        return moved


def _nearest_rotation(moment: FloatArray) -> FloatArray:
    """The rotation (3, 3) nearest to a matrix."""
    if isinstance(moment, Tracked):
        # The derivative is U (B - B^T) / (s_i + s_j) V^T, where B = U^T dM V and s are the singular values.
        left, size, right = np.linalg.svd(moment.value)
        sign = np.linalg.det(left) * np.linalg.det(right)
        left[:, 2] *= sign
        size[2] *= sign
        sums = size[:, None] + size
        share = np.divide(1.0, sums, out=np.zeros((3, 3)), where=np.abs(sums) > 1e-12 * size[0])

        def push(t: FloatArray) -> FloatArray:
            inner = left.T @ t @ right.T
            return np.asarray(left @ (share * (inner - inner.T)) @ right)

        def pull(g: FloatArray) -> FloatArray:
            inner = share * (left.T @ g @ right.T)
            return np.asarray(left @ (inner - inner.T) @ right)

        return moment.tape.result(left @ right, [(moment, push, pull)])
    left, _, right = np.linalg.svd(moment)
    left[:, 2] *= np.linalg.det(left) * np.linalg.det(right)
    return np.asarray(left @ right)


AT_REST = Frame(np.zeros(3))
"""The frame of the grid itself."""
