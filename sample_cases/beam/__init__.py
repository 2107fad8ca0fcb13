"""Appendix B of Sen et al.: a thin beam in a rectangle bends into a parabola, 2-D."""

import numpy as np

from meshdeform_core.grid import Grid

from ..building import around, with_patches

DEFAULT_SIZE = 40
SIZES = {"small": 40, "paper": 400}
SIZE_HELP = "cells along the rectangle, a multiple of 40: 40 and 400 in the paper"


def generate(size: int = DEFAULT_SIZE, origin: tuple[float, float] = (0.0, 0.0)) -> Grid:
    """Rectangle of 4 x 2, ``size`` x (``size``/2 + 1) cells; the beam |x| <= 0.5 is a hole in the middle row.

    ``origin`` is the position of the rectangle's centre (the paper also puts the coordinate origin at a corner).
    """
    if size < 40 or size % 40:
        raise ValueError(f"size = {size} cells along x; expected a multiple of 40")
    x = np.asarray((np.arange(size + 1) - size // 2) * (4.0 / size) + origin[0])
    rows = size // 2 + 1
    y = np.asarray((np.arange(rows + 1) - rows / 2) * (2.0 / rows) + origin[1])
    a, b, c = 3 * size // 8, 5 * size // 8, rows // 2
    return with_patches(
        around([x[: a + 1], x[a : b + 1], x[b:]], [y[: c + 1], y[c : c + 2], y[c + 1 :]], [0.0]),
        [
            ("outer", "BCFarfield", lambda c, side: np.abs((c[:, :2] - origin) / [1.999, 0.999]).max(axis=1) > 1.0),
            ("beam", "BCWall", lambda c, side: np.full(len(c), True)),
        ],
    )
