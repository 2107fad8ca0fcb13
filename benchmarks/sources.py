"""Surface nodes of the hemisphere sample without the grid between them: for systems larger than any available grid."""

from __future__ import annotations

import numpy as np

from meshdeform_core.grid import FloatArray
from meshdeform_samples import hemisphere
from meshdeform_samples.building import geometric

_AMPLITUDE = 1.1e-2


def hemisphere_sources(size: int) -> tuple[FloatArray, FloatArray]:
    """Points (n, 3) and displacements (n, 3) of the membrane, the plate and the far field, each node once.

    The displacement is that of the sample's case file at its largest.
    """
    inner, outer = 0.5 * hemisphere.DIAMETER, 10 * hemisphere.DIAMETER
    radius = inner + geometric(2e-4 * hemisphere.DIAMETER, round(131 / 92 * size), outer - inner)
    panels = hemisphere.panels(size)
    shells = [panel.reshape(-1, 3) * r for panel in panels for r in (radius[0], radius[-1])]
    plate = [(panel[:, 0, None, :] * radius[None, :, None]).reshape(-1, 3) for panel in panels[1:]]
    points = np.concatenate(shells + plate)
    # Edges that panels share agree to round-off; the first cell is a million times larger.
    points = points[np.unique(np.round(points, 10) + 0.0, axis=0, return_index=True)[1]]
    membrane = np.linalg.norm(points, axis=1) < 1.01 * inner
    angle = np.arctan2(np.hypot(points[:, 0], points[:, 1]), points[:, 2])
    size_of = _AMPLITUDE * points[:, 2] / inner * np.cos(4 * angle)
    return points, np.where(membrane[:, None], points / inner * size_of[:, None], 0.0)
