"""Inverse distance weighting with a single source in place of all sources at rest.

Sources at rest share the same values whatever the others do, so the record for derivatives needs only one of them,
with the area of all.
"""

from __future__ import annotations

import copy
import dataclasses

import numpy as np

from ...grid import BoolArray
from ...numerics.arrays import places_among
from ...numerics.rotation import SurfaceRotations
from ..scattered.idw import PreparedIDW


def reduced(method: PreparedIDW, acting: BoolArray) -> PreparedIDW:
    """The method with only the ``acting`` (n,) images of sources, in order, followed by the first of the others.

    Faces and their edges connect acting sources only.
    """
    images, rest = method.images, np.flatnonzero(~acting)
    kept = np.concatenate([np.flatnonzero(acting), rest[:1]])
    number = places_among(kept, len(acting))
    area = images.area[kept]
    if rest.size:
        area[-1] = images.area[rest].sum()
    found = copy.copy(method)
    found.images = dataclasses.replace(
        images, points=images.points[kept], area=area, owner=images.owner[kept], reflection=images.reflection[kept],
        moving=images.moving[kept], corners=number[images.corners], edges=number[images.edges],
    )  # fmt: skip
    found.area, found.points = found.images.area, found.images.points
    normal = method.problem.plane_normal
    found._rotations = SurfaceRotations(found.points, found.images.corners, found.images.edges, normal)
    found._blunt = number[method._blunt]
    if method._share:
        found._share = dataclasses.replace(method._share, moving=method._share.moving[kept])
    return found
