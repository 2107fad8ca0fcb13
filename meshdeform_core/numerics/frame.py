"""The average rigid motion of a boundary: the frame in which the remainder of its motion is interpolated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .arrays import FloatArray, weighted_total
from .tape import Tracked


@dataclass(frozen=True)
class Frame:
    """A rotation ``turn`` (3, 3) about ``centre`` (3,), or none, followed by the translation ``shift`` (3,)."""

    shift: FloatArray
    turn: FloatArray | None = None
    centre: FloatArray | None = None

    @classmethod
    def fitted(
        cls, points: FloatArray, displacement: FloatArray, weight: FloatArray, normal: FloatArray | None
    ) -> Frame:
        """The rigid motion of ``points`` (n, 3) that is the weighted least-squares fit to ``displacement`` (n, 3).

        The rotation is that of Kabsch (Acta Cryst. A32, 922, 1976); with a ``normal`` (3,), it is about this axis.
        """
        share = weight / weight.sum()
        shift, centre = weighted_total(share, displacement), weighted_total(share, points)
        if not isinstance(displacement, Tracked) and not (displacement - shift).any():
            return cls(shift)
        arm = points - centre
        moment = (arm + displacement - shift).T @ (share[:, None] * arm)
        if normal is not None:
            moment += np.linalg.norm(moment) * np.outer(normal, normal)
        return cls(shift, _nearest_rotation(moment), centre)

    def relative(self, points: FloatArray, displacement: FloatArray) -> FloatArray:
        """Displacement (n, 3) of ``points`` (n, 3) as seen from the frame."""
        rest = displacement - self.shift
        if self.turn is None or self.centre is None:
            return rest
        # A single product with the inverse rotation leaves only round-off of a rigid motion.
        arm = points - self.centre
        inside: FloatArray = (arm + rest) @ self.turn - arm
        return inside

    def absolute(self, points: FloatArray, displacement: FloatArray) -> FloatArray:
        """The inverse of :meth:`relative`."""
        if self.turn is None or self.centre is None:
            return displacement + self.shift
        carried = (points - self.centre) @ (self.turn - np.eye(3)).T
        return np.asarray(displacement @ self.turn.T + carried + self.shift)


def _nearest_rotation(moment: FloatArray) -> FloatArray:
    """The rotation (3, 3) nearest to a matrix."""
    if isinstance(moment, Tracked):
        return _differentiated_rotation(moment)
    left, _, right = np.linalg.svd(moment)
    left[:, 2] *= np.linalg.det(left) * np.linalg.det(right)
    return np.asarray(left @ right)


def _differentiated_rotation(moment: Tracked) -> Tracked:
    """:func:`_nearest_rotation` with its derivative U (B - B^T) / (s_i + s_j) V^T, where B = U^T dM V and s are the
    singular values."""
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


AT_REST = Frame(np.zeros(3))
"""The frame of the grid itself."""
