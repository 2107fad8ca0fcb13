"""Section 5 of Sen et al.: a membrane hemisphere on a plate, half a cubed sphere of five blocks."""

import numpy as np

from meshdeform_core.grid import FloatArray, Grid

from ..building import geometric, split, with_patches

DEFAULT_SIZE = 24
SIZES = {"small": 12, "medium": 24, "paper": 92}
SIZE_HELP = "cells across the top panel, a multiple of 4: 24 gives 78 k cells, 92 the paper's 4.44 M"

DIAMETER = 0.15
_OUTER = 10 * DIAMETER
_WALL_CELL, _PLATE_CELL = 2e-4 * DIAMETER, 1e-3 * DIAMETER


def generate(size: int = DEFAULT_SIZE, max_cells: int = 0) -> Grid:
    """Top panel ``size`` x ``size`` cells, four side panels ``size`` x 3/4 ``size``, radially 131/92 ``size``.

    ``max_cells`` splits the five blocks into blocks of at most this many cells per direction (44 gives the paper's 99
    blocks at size 92); 0 keeps the five.
    """
    if size < 8 or size % 4:
        raise ValueError(f"size = {size} cells across the top; expected a multiple of 4, at least 8")
    radius = DIAMETER / 2 + geometric(_WALL_CELL, round(131 / 92 * size), _OUTER - DIAMETER / 2)
    shells = [directions[:, :, None, :] * radius[None, None, :, None] for directions in panels(size)]
    grid = Grid.from_blocks(shells, ["top", "east", "north", "west", "south"])
    if max_cells:
        grid = split(grid, max_cells)
    return with_patches(
        grid,
        [
            ("plate", "BCWall", lambda c, side: np.abs(c[:, 2]) < 1e-12),
            ("membrane", "BCWall", lambda c, side: np.linalg.norm(c, axis=1) < 0.51 * DIAMETER),
            ("outer", "BCFarfield", lambda c, side: np.full(len(c), True)),
        ],
    )


def panels(n: int) -> list[FloatArray]:
    """Unit directions of the nodes of the five panels of half a cubed sphere (equal angles across each panel)."""
    tangent = np.tan(np.linspace(-np.pi / 4, np.pi / 4, n + 1))
    # Exactly antisymmetric, so that panels share their edge nodes to the last bit.
    tangent = 0.5 * (tangent - tangent[::-1])
    u, v = np.meshgrid(tangent, tangent, indexing="ij")
    top = np.stack([u, v, np.ones_like(u)], axis=-1)
    # Elevation from the plate: first cell given as an arc length on the hemisphere.
    rise = np.tan(geometric(_PLATE_CELL / (DIAMETER / 2), 3 * n // 4, np.pi / 4))
    rise[-1] = 1.0
    a, b = np.meshgrid(tangent, rise, indexing="ij")
    one = np.ones_like(a)
    sides = [
        np.stack([one, a, b], axis=-1), np.stack([-a, one, b], axis=-1),
        np.stack([-one, -a, b], axis=-1), np.stack([a, -one, b], axis=-1),
    ]  # fmt: skip
    return [p / np.sqrt((np.sort(p**2, axis=-1)).sum(axis=-1, keepdims=True)) for p in (top, *sides)]
