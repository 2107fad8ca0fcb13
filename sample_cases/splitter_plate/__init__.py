"""Square cylinder with a splitter plate in a channel (Sen et al. section 4): ten blocks, uniform square cells."""

import numpy as np

from meshdeform_core.grid import Grid

from ..building import even, with_patches

DEFAULT_SIZE = 8
SIZES = {"small": 8, "paper": 16, "large": 32}
SIZE_HELP = "cells per unit length, a multiple of 8 (paper: 16)"

# (name, x range, y range) of the ten blocks; the interfaces at plate and cylinder are partial faces.
_BLOCKS = (
    ("upstream-top", (-3.5, -0.5), (0.5, 6.5)),
    ("upstream-middle", (-3.5, -0.5), (-0.5, 0.5)),
    ("upstream-bottom", (-3.5, -0.5), (-6.5, -0.5)),
    ("cylinder-top", (-0.5, 0.5), (0.5, 6.5)),
    ("cylinder-bottom", (-0.5, 0.5), (-6.5, -0.5)),
    ("plate-top", (0.5, 5.5), (0.125, 6.5)),
    ("plate-bottom", (0.5, 5.5), (-6.5, -0.125)),
    ("wake-top", (5.5, 8.5), (0.125, 6.5)),
    ("wake-middle", (5.5, 8.5), (-0.125, 0.125)),
    ("wake-bottom", (5.5, 8.5), (-6.5, -0.125)),
)


def generate(size: int = DEFAULT_SIZE) -> Grid:
    """The undeformed grid with ``size`` cells per unit length (a multiple of 8; the paper has 16) and size/2 in z."""
    if size < 8 or size % 8:
        raise ValueError(f"size = {size} cells per unit; expected a multiple of 8 (the plate is a quarter thick)")

    z = even((0.0, 0.5), size)
    blocks = [np.stack(np.meshgrid(even(x, size), even(y, size), z, indexing="ij"), axis=-1) for _, x, y in _BLOCKS]
    grid = Grid.from_blocks(blocks, [name for name, _, _ in _BLOCKS])
    return with_patches(
        grid,
        [
            ("span", "BCSymmetryPlane", lambda x, side: np.full(len(x), side.axis == 2)),
            ("body", "BCWall", lambda x, side: (np.abs(x[:, 1]) < 0.55) & (x[:, 0] > -0.55) & (x[:, 0] < 5.55)),
            ("outer", "BCFarfield", lambda x, side: np.full(len(x), True)),
        ],
    )
