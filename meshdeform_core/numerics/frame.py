"""The average rigid or affine motion of a boundary: the frame in which the remainder of its motion is interpolated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from .arrays import FloatArray, weighted_total
from .tape import Tracked, plain

_FLATTEST = 1e-3
"""Smallest ratio of the stretches of an affine frame along its axes; flatter ones have no accurate inverse."""
_FOLLOWS = 0.1
"""Share of the motion within the rigid frame, as mean squares, that may remain within an affine one: a boundary that
deforms by more has no affine motion, and that of its mean would only shear the layers along it."""


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
