"""Motions that are probably mistaken: positions given as displacements, radians as degrees."""

from __future__ import annotations

import numpy as np

from ...grid import FloatArray
from .motion import Motion, Rotate

_ALIKE = 0.1
"""Displacements are positions if they differ from the coordinates by less than this part of the coordinates' spread."""
_FEWEST = 4
_FAR = 10.0
"""Sizes of the grid beyond which a displacement is hardly in its length unit."""
_SMALL_ANGLE = 0.2
"""Constant rotations by fewer degrees may be meant in radians (up to 11 degrees)."""


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


def far_motion(extent: FloatArray, largest: float) -> list[str]:
    """A warning if a wall moves by many times the ``extent`` (3,) of the grid."""
    size = float(np.linalg.norm(extent))
    if largest <= _FAR * size:
        return []
    return [
        f"the largest displacement, {largest:.4g}, is {largest / size:.3g} times the size of the grid, {size:.4g}: is "
        "it in the length unit of the grid?"
    ]


def tiny_rotations(name: str, motion: Motion) -> list[str]:
    """A warning for every constant rotation of boundary ``name`` whose angle looks like radians."""
    warnings = []
    for step in motion.steps:
        if isinstance(step, Rotate) and not step.angle.names & {"x", "y", "z", "t"}:
            angle = float(np.asarray(step.angle(motion.constants)))
            if 0.0 < abs(angle) < _SMALL_ANGLE:
                warnings.append(
                    f"boundary {name!r} is rotated by only {angle:.4g} degrees; angles are in degrees, and {angle:.4g} "
                    f"radians would be {np.degrees(angle):.4g}"
                )
    return warnings
