"""A square bar rotates in a cascade of equal bars: the upper and lower boundaries are periodic, 2-D."""

import numpy as np

from meshdeform_core.grid import Grid

from ..building import around, columns, even, with_patches

DEFAULT_SIZE = 32
SIZES = {"small": 16, "medium": 32, "large": 128}
SIZE_HELP = "cells along an edge of the bar, an even number: 32 gives 48 k cells"

_PITCH = 4.0
_INLET, _OUTLET = -4.0, 8.0


def generate(size: int = DEFAULT_SIZE) -> Grid:
    """Eight blocks of uniform square cells around a bar of unit edge; one pitch of 4 of the cascade."""
    if size < 4 or size % 2:
        raise ValueError(f"size = {size} cells along an edge of the bar; expected an even number, at least 4")
    x = [even(span, size) for span in ((_INLET, -0.5), (-0.5, 0.5), (0.5, _OUTLET))]
    y = [even(span, size) for span in ((-_PITCH / 2, -0.5), (-0.5, 0.5), (0.5, _PITCH / 2))]
    return with_patches(
        around(x, y, [0.0], columns("bar")),
        [
            ("bar", "BCWall", lambda c, side: np.abs(c[:, :2]).max(axis=1) < 0.51),
            ("inlet", "BCInflow", lambda c, side: c[:, 0] == _INLET),
            ("outlet", "BCOutflow", lambda c, side: c[:, 0] == _OUTLET),
            ("lower", "", lambda c, side: c[:, 1] == -_PITCH / 2),
            ("upper", "", lambda c, side: c[:, 1] == _PITCH / 2),
        ],
    )
