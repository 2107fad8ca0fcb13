"""What IDW and RBF interpolate from: the sources and their mirror images at symmetry planes, which every scattered-data
method includes; and for IDW the rigid motions of the sources, represented as in :mod:`...numerics.rigid`, and the
transition between moving sources and sources at rest: how ``lie`` distributes the motion across the gap.

With weights alone, the share of the moving sources falls steeply half-way between two boundaries, where cells then
shear most. The share that :func:`.rigid.finish` computes from the same sums instead falls linearly across the
gap, except near both ends, where cells follow their wall.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...boundary import Kind
from ...grid import BoolArray, FloatArray, IntArray
from ...grid.topology import RELATIVE_TOLERANCE
from ...numerics import rotation as rot
from ...numerics.arrays import distinct_pairs, weighted_total
from ...numerics.geometry.coincidence import connected_components
from ...numerics.rigid import WIDTHS, Transition
from ...numerics.tape import Tracked
from ..base import Problem

_TOGETHER = 100_000
"""Sources whose motions are computed at a time, which bounds the memory."""
_CURVE, _SURFACE = 1.0, 2.0
"""The total weight of a curve decays like r^(1 - a), as does that of a surface at distances beyond its breadth; closer
to a surface it decays like r^(2 - a)."""
_PERIMETER = 5.0
"""Assumed ratio of the perimeter of a body's longer section to its largest radius."""


@dataclass(frozen=True)
class Images:
    """Sources and their mirror images as one surface, connected across symmetry planes.

    ``owner`` (n,) is the source of each image, ``reflection`` (n, 3, 3) the reflection that made it;
    ``corners`` and ``edges`` as in :class:`.base.Surface`, into the images.
    """

    points: FloatArray
    area: FloatArray
    owner: IntArray
    reflection: FloatArray
    moving: BoolArray
    corners: IntArray
    edges: IntArray

    def displaced(self, displacement: FloatArray) -> FloatArray:
        """Displacements of all images from those of the sources."""
        return np.einsum("nij,nj->ni", self.reflection, displacement[self.owner])

    @property
    def with_motion(self) -> BoolArray:
        """Sources (n,) on moving faces; all others are at rest."""
        moving = self.moving.copy()
        moving[self.corners] = True
        return moving

    @property
    def bodies(self) -> int:
        """Number of connected components of the moving surface."""
        label = connected_components(len(self.moving), self.corners[:, :2])
        return len(np.unique(label[self.corners[:, 0]]))

    def gathered(self, gradient: FloatArray) -> FloatArray:
        """Transpose of :meth:`displaced`: gradients of the sources from those (n, 3) of all images."""
        found = np.zeros((int(self.owner.max(initial=-1)) + 1, 3))
        np.add.at(found, self.owner, np.einsum("nij,ni->nj", self.reflection, gradient))
        return found


def mirror_images(problem: Problem) -> Images:
    """The sources of a problem with their images at all symmetry planes."""
    n = len(problem.source_points)
    moving = np.asarray(problem.boundary.kind[problem.source_numbers] == Kind.MOVING)
    reflection = np.broadcast_to(np.eye(3), (n, 3, 3))
    surface = problem.surface
    images = Images(
        problem.source_points, surface.area, np.arange(n), reflection, moving, surface.corners, surface.edges
    )
    for plane in problem.boundary.mirrors:
        # The images at one plane; a node on the plane is its own image, with the area of both sides.
        height = (images.points - plane.point) @ plane.normal
        edge = problem.topology.edge[problem.source_numbers][images.owner]
        on_plane = np.abs(height) <= RELATIVE_TOLERANCE * edge
        off = ~on_plane
        area = np.where(on_plane, 2 * images.area, images.area)
        mirror = np.eye(3) - 2 * np.outer(plane.normal, plane.normal)
        image_of = np.where(on_plane, np.arange(len(off)), len(off) + np.cumsum(off) - 1)
        # A mirrored face has the opposite orientation: next and previous node are exchanged.
        order = [0, 2, 1] if images.corners.shape[1] == 3 else [1, 0]
        images = Images(
            np.concatenate([images.points, images.points[off] - 2 * height[off, None] * plane.normal]),
            np.concatenate([area, area[off]]),
            np.concatenate([images.owner, images.owner[off]]),
            np.concatenate([images.reflection, mirror @ images.reflection[off]]),
            np.concatenate([images.moving, images.moving[off]]),
            np.concatenate([images.corners, image_of[images.corners][:, order]]),
            distinct_pairs(np.concatenate([images.edges, image_of[images.edges]])),
        )
    return images


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
    # The shorter side of the moving surface: its area over the perimeter of its longer section, which is between 4 (a
    # plate) and 2 pi (a cylinder) times the largest distance from the centroid.
    moving = images.with_motion
    area, x = images.area[moving], images.points[moving]
    reach = np.linalg.norm(x - weighted_total(area, x) / area.sum(), axis=1).max()
    breadth = area.sum() / (_PERIMETER * reach)
    # The integral of r^-a over a plane at the distance of the breadth.
    crossing = 2.0 * np.pi / near * breadth**-near / images.area.max()
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
