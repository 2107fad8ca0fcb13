"""The quantities that IDW averages: rigid motions of the sources, represented as in :mod:`..numerics.rigid`, and the
transition between moving sources and sources at rest: how ``lie`` distributes the motion across the gap.

With weights alone, the share of the moving sources falls steeply half-way between two boundaries, where cells then
shear most. The share that :func:`.rigid.finish` computes from the same sums instead falls linearly across the
gap, except near both ends, where cells follow their wall.
"""

from __future__ import annotations

import numpy as np

from ...boundary import Kind
from ...grid import BoolArray, FloatArray
from ...numerics.arrays import weighted_total
from ...numerics.geometry import quaternions as rot
from ...numerics.geometry.coincidence import connected_components
from ...numerics.rigid import WIDTHS, Transition
from ...numerics.tape import Tracked
from ..base import Problem
from .mirror import Images

_TOGETHER = 100_000
"""Sources whose motions are computed at a time, which bounds the memory."""
_CURVE, _SURFACE = 1.0, 2.0
"""The total weight of a curve decays like r^(1 - a), as does that of a surface at distances beyond its breadth; closer
to a surface it decays like r^(2 - a)."""
_PERIMETER = 5.0
"""Assumed ratio of the perimeter of a body's longer section to its largest radius."""


def with_motion(images: Images) -> BoolArray:
    """Sources (n,) on moving faces; all others are at rest."""
    moving = images.moving.copy()
    moving[images.corners] = True
    return moving


def bodies(images: Images) -> int:
    """Number of connected components of the moving surface."""
    label = connected_components(len(images.moving), images.corners[:, :2])
    return len(np.unique(label[images.corners[:, 0]]))


def breadth(images: Images) -> float:
    """Shorter side of the moving surface: its area over the perimeter of its longer section.

    The perimeter is between 4 (a plate) and 2 pi (a cylinder) times the largest distance from the centroid.
    """
    moving = with_motion(images)
    area, x = images.area[moving], images.points[moving]
    reach = np.linalg.norm(x - weighted_total(area, x) / area.sum(), axis=1).max()
    found: float = area.sum() / (_PERIMETER * reach)
    return found


def transition_of(images: Images, problem: Problem, far: float, width: float) -> Transition:
    """The transition for sources with the exponent ``far`` of eq. 16 and weights relative to the largest nodal area.

    Close to a body that moves as a whole, weights decay as near a surface: with the law of curves, walls on the
    other side of the body would contribute to the motion of its first cells. Where moving and fixed faces meet,
    both weights must decay alike.
    """
    power = max(far - _CURVE, 1.0)
    # Moving faces share nodes with faces at rest, as those of a membrane clamped in a plate do.
    quads, kind = problem.topology.quads.corners, problem.boundary.quad_kind
    attached = np.intersect1d(quads[kind == Kind.MOVING], quads[kind == Kind.FIXED]).size > 0
    if problem.plane or far <= _SURFACE or attached:
        return Transition(np.zeros(6), power, power, 1.0, width)
    near = far - _SURFACE
    # The integral of r^-a over a plane at the distance of the breadth.
    crossing = 2.0 * np.pi / near * breadth(images) ** -near / images.area.max()
    return Transition(np.zeros(6), power, near, crossing, width)


def motion_values(
    rotation: str, divisions: int, x: FloatArray, d: FloatArray, q: FloatArray, w: FloatArray
) -> FloatArray:
    """The quantities to average, (k, n), for sources at ``x`` with displacements ``d``.

    ``q`` (n, 4) and ``w`` (n, 3) are their rotations as quaternions and as vectors.
    """
    if rotation == "none":
        return d.T.copy()
    if isinstance(d, Tracked) or len(x) <= _TOGETHER:
        return _values(rotation, divisions, x, d, q, w)
    found = np.empty((WIDTHS[rotation], len(x)))
    for lo in range(0, len(x), _TOGETHER):
        rows = slice(lo, lo + _TOGETHER)
        found[:, rows] = _values(rotation, divisions, x[rows], d[rows], q[rows], w[rows])
    return found


def _values(rotation: str, divisions: int, x: FloatArray, d: FloatArray, q: FloatArray, w: FloatArray) -> FloatArray:
    turned = rot.rotate(q, x) - x
    translation = d - turned
    if rotation == "lie":
        return np.concatenate([w.T, rot.twist_velocity(w, translation).T])
    if rotation == "blend":
        columns = [rot.rotate(q, np.tile(e, (len(x), 1))) - e for e in np.eye(3)]
        return np.concatenate([np.stack(columns, axis=2).reshape(len(x), 9).T, translation.T])
    if rotation == "division":
        part = rot.quaternion_of(w / divisions)
        # T_m = M^-1 T of eq. 27; each of m equal steps of a screw motion has the twist (w, v) / m.
        v = rot.twist_velocity(w, translation)
        return np.concatenate([part.T, rot.translation_of_twist(w / divisions, v / divisions).T])
    return np.concatenate([q.T, translation.T])
