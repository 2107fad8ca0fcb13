"""Symmetry planes: every scattered-data method includes the mirror images of the sources."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...boundary import Kind
from ...grid import BoolArray, FloatArray, IntArray
from ...grid.topology import RELATIVE_TOLERANCE
from ...numerics.arrays import distinct_pairs
from ..base import Problem


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
