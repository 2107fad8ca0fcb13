"""From the moving sources to those at rest: how ``lie`` divides the motion between them.

Weights alone give the moving sources a share that falls off as a power of the distance, steeply half-way between two
boundaries: cells there shear most. The share that :func:`.rigid.finish_twist` computes from the same sums falls
linearly across the gap instead, but for its ends, where cells follow their wall.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...grid import BoolArray, FloatArray
from ...numerics.geometry.coincidence import connected_components
from ...numerics.rigid import Transition
from .mirror import Images

WIDTH, WIDTH_IN_PLANES = 0.5, 0.3
"""Part of the gap at either end over which the share of the moving sources changes its slope."""
FAR_OF_ONE_BODY = 4.0
"""Exponent a of eq. 16 for one moving body: with the transition, it only matters along the body."""
STEEPER = 1.5
"""Accuracy of fast sums is judged by displacements this much larger: the share may change faster than the weights."""
_DECAY = 1.0
"""The total weight of a curve falls off as r^(1 - a), so does that of a surface beyond its shorter side."""


def with_motion(images: Images) -> BoolArray:
    """Sources (n,) on moving faces; all others are at rest."""
    moving = images.moving.copy()
    moving[images.corners] = True
    return moving


def bodies(images: Images) -> int:
    """Number of connected surfaces that the moving faces make."""
    label = connected_components(len(images.moving), images.corners[:, :2])
    return len(np.unique(label[images.corners[:, 0]]))


@dataclass(frozen=True)
class MovingShare:
    """Which sources (n,) move, and the shape of their share."""

    moving: BoolArray
    power: float
    width: float

    @classmethod
    def of(cls, images: Images, far: float, width: float) -> MovingShare:
        """Share for sources with the exponent ``far`` of eq. 16."""
        return cls(with_motion(images), max(far - _DECAY, 1.0), width)

    def applied(self, values: FloatArray) -> tuple[FloatArray, Transition] | None:
        """Twists (6, n) relative to those at rest, a row that is 1 for moving sources, and the transition.

        ``None`` if sources at rest were given different motions: then weights alone decide.
        """
        rest = values[:, ~self.moving]
        if (rest != rest[:, :1]).any():
            return None
        relative = values - rest[:, :1]
        return np.concatenate([relative, self.moving[None]]), Transition(rest[:, 0].copy(), self.power, self.width)
