"""Problem 1 of Sen et al.: a square with a tent at the bottom and waves on the other sides, 2-D."""

import numpy as np

from meshdeform_core.grid import Grid

from ..building import with_patches

DEFAULT_SIZE = 21
SIZES = {"small": 21, "paper": 301}
SIZE_HELP = "nodes per side (paper: 21 and 301)"


def generate(size: int = DEFAULT_SIZE) -> Grid:
    """The undeformed square, clustered at the bottom and at the left: x_i = (10^s - 1) / 9, s = i / (n - 1)."""
    if size < 3:
        raise ValueError(f"size = {size} nodes per side; expected at least 3")
    line = (10.0 ** np.linspace(0.0, 1.0, size) - 1.0) / 9.0
    x = np.zeros((size, size, 1, 3))
    x[..., 0, 0], x[..., 0, 1] = np.meshgrid(line, line, indexing="ij")
    return with_patches(
        Grid.from_blocks([x], ["square"]),
        [
            ("bottom", "BCWall", lambda c, side: c[:, 1] == 0.0),
            ("top", "BCWall", lambda c, side: c[:, 1] == 1.0),
            ("left", "BCWall", lambda c, side: c[:, 0] == 0.0),
            ("right", "BCWall", lambda c, side: c[:, 0] == 1.0),
        ],
    )
