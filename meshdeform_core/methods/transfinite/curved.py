"""Linear precision of TFI in sub-blocks with curved grid lines.

TFI, as an operator T, reproduces a linear map, such as a rotation, only where it would also generate the grid: T x = x.
Elsewhere, for example around leading edges, the image of the deviation x - T x is missing. With the gradient G of the
displacement of the sub-block, fitted to its corners, T d + G (x - T x) reproduces every linear map. In grids that TFI
generated there are no deviations, and no cost.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...grid import FloatArray, IntArray
from ...numerics.transfinite.boxes import box_nodes, inner_numbers
from .groups import Group

# Deviations below this fraction of the size of a sub-block are round-off.
_ROUND_OFF = 1e-8
THINNEST = 1e-7
"""In sub-blocks thinner than this fraction of their length, the gradient across them is not determined."""


@dataclass(frozen=True)
class Bent:
    """The sub-blocks of a group that have deviations.

    ``rows`` (m,): their rows in the group; ``corners`` (m, 8): their corner nodes; ``inverse`` (m, 3, 8): maps values
    at the corners to their least-squares gradient.
    """

    rows: IntArray
    corners: IntArray
    inverse: FloatArray


@dataclass(frozen=True)
class CurvedLines:
    """Deviations of the nodes inside the sub-blocks of a group.

    Attributes
    ----------
    bent : the sub-blocks with deviations
    nodes, sub : (n,) flat indices of the nodes inside these, and the row of ``bent`` to which each belongs
    deviation : (n, 3) their deviations
    """

    bent: Bent
    nodes: IntArray
    sub: IntArray
    deviation: FloatArray

    @classmethod
    def of(cls, group: Group, bent: Bent | None = None) -> CurvedLines:
        """The deviations of a group; the search for sub-blocks with deviations is skipped if ``bent`` is given."""
        if bent is None:
            rows = np.flatnonzero(inner_numbers(group.subs))
            corners = corners_of(group.subs)
            size = np.abs(arms(group.points, corners)).max(axis=(1, 2))
            # One plane of each sub-block excludes most of those without deviations; measuring all planes costs twice
            # that.
            for one_plane in (True, False):
                rows = rows[_largest(_measured(group, rows, one_plane)) > _ROUND_OFF * size[rows]]
            inverse = np.linalg.pinv(arms(group.points, corners[rows]), rcond=THINNEST)
            bent = Bent(rows, corners[rows], np.asarray(inverse, dtype=np.float64))
        sub, deviation = _measured(group, bent.rows)
        return cls(bent, box_nodes(group.subs[bent.rows], inside=True), sub, deviation)

    def add(self, displacement: FloatArray) -> None:
        """Add the missing linear part to the displacement (n_nodes, 3) of inner nodes, in place."""
        gradient = self.bent.inverse @ displacement[self.bent.corners]
        displacement[self.nodes] += np.einsum("na,nac->nc", self.deviation, gradient[self.sub])

    def pull(self, gradient: FloatArray) -> None:
        """Transpose of :meth:`add`: add to the gradients (n_nodes, 3) of the corners, in place."""
        given, found = gradient[self.nodes], np.empty((len(self.bent.rows), 3, 3))
        for a, c in np.ndindex(3, 3):
            found[:, a, c] = np.bincount(self.sub, self.deviation[:, a] * given[:, c], len(found))
        np.add.at(gradient, self.bent.corners, np.einsum("nac,nak->nkc", found, self.bent.inverse))


def _measured(group: Group, rows: IntArray, one_plane: bool = False) -> tuple[IntArray, FloatArray]:
    """Deviations of the nodes inside some sub-blocks, or in one plane of each, from where TFI would place them: the
    position of their sub-block in ``rows`` (n,), and the deviations (n, 3)."""
    part = group.apart(rows)
    blended, subs = part.points.copy(), part.subs
    if one_plane:
        # At a third, not the middle, where S-shaped lines have no deviation.
        low, high = subs[:, 4], subs[:, 7]
        plane, subs = low + np.maximum((high - low) // 3, 1), subs.copy()
        subs[:, 4], subs[:, 7] = np.where(high > low, [plane - 1, plane + 1], [low, high])
    part.blend(blended, np.column_stack([np.arange(len(rows)), subs[:, 4] + 1, subs[:, 7]]) if one_plane else None)
    nodes = box_nodes(subs, inside=True)
    return np.repeat(np.arange(len(rows)), inner_numbers(subs)), part.points[nodes] - blended[nodes]


def _largest(measured: tuple[IntArray, FloatArray]) -> FloatArray:
    """Largest component of the deviations of each sub-block, all of which have nodes inside."""
    sub, deviation = measured
    start = np.flatnonzero(np.diff(sub, prepend=-1))
    return np.maximum.reduceat(np.abs(deviation).max(axis=1), start) if len(start) else np.empty(0)


def arms(points: FloatArray, corners: IntArray) -> FloatArray:
    """Corners (n, 8, 3) relative to their mean."""
    return np.asarray(points[corners] - points[corners].mean(axis=1, keepdims=True))


def corners_of(subs: IntArray) -> IntArray:
    """Flat indices (n, 8) of the corners of sub-blocks."""
    ends = np.stack([subs[:, 4:7], subs[:, 7:10]], axis=1)
    i, j, k = (ends[:, n, axis] for axis, n in enumerate(np.indices((2, 2, 2)).reshape(3, 8)))
    shape = subs[:, 1:4, None]
    return np.asarray(subs[:, :1] + (i * shape[:, 1] + j) * shape[:, 2] + k)
