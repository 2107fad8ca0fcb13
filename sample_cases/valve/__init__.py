"""A flap above its seat opens over time: a motion as a formula of t, for deform --time and series, 3-D."""

import numpy as np

from meshdeform_core.grid import Grid

from ..building import around, columns, geometric, with_patches

DEFAULT_SIZE = 32
SIZES = {"small": 16, "medium": 32, "large": 96}
SIZE_HELP = "cells along the flap, a multiple of 8: 32 gives 20 k cells, 96 gives 0.5 M"

_LENGTH, _THICKNESS, _WIDTH = 1.0, 0.0625, 0.5
_GAP = 0.25
_UPSTREAM, _DOWNSTREAM, _CEILING = 1.5, 3.0, 2.0


def generate(size: int = DEFAULT_SIZE) -> Grid:
    """Eight blocks around a closed flap 0 <= x <= 1 of thickness 1/16, a quarter above the floor of a channel."""
    if size < 8 or size % 8:
        raise ValueError(f"size = {size} cells along the flap; expected a multiple of 8")
    cell = _LENGTH / size
    along = np.linspace(0.0, _LENGTH, size + 1)
    x = [-geometric(cell, size // 2, _UPSTREAM)[::-1], along, _LENGTH + geometric(cell, 3 * size // 4, _DOWNSTREAM)]
    half = _THICKNESS / 2
    y = [
        -half - np.linspace(_GAP, 0.0, size // 4 + 1),
        np.linspace(-half, half, max(size // 16, 1) + 1),
        half + geometric(cell, 3 * size // 4, _CEILING),
    ]
    z = np.linspace(0.0, _WIDTH, size // 4 + 1)
    return with_patches(
        around(x, y, z, columns("flap")),
        [
            ("sides", "BCSymmetryPlane", lambda c, side: np.full(len(c), side.axis == 2)),
            ("flap", "BCWall", lambda c, side: (np.abs(c[:, 1]) < 1.01 * half) & (np.abs(c[:, 0] - 0.5) < 0.501)),
            ("floor", "BCWall", lambda c, side: c[:, 1] < -0.99 * (half + _GAP)),
            ("channel", "BCFarfield", lambda c, side: np.full(len(c), True)),
        ],
    )
