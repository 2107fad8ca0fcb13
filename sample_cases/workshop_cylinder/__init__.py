"""The cylinder of the Mesh Motion suite, High-Fidelity CFD Verification Workshop 2024: a closed disk, 2-D."""

import numpy as np

from meshdeform_core.grid import Grid

from ..building import tanh_law, with_patches

DEFAULT_SIZE = 16
SIZES = {"small": 8, "medium": 16, "large": 64}
SIZE_HELP = "cells across each of the five blocks: 16 gives 1.3 k cells"

_RADIUS, _CORE, _TWIST = 0.5, 0.2, 0.15


def generate(size: int = DEFAULT_SIZE) -> Grid:
    """A block with rounded sides in the middle of a disk and four around it, bunched at the wall, with the twist that
    the suite gives its nodes at t = 0."""
    if size < 4:
        raise ValueError(f"size = {size} cells across each block; expected at least 4")
    s = np.linspace(-1.0, 1.0, size + 1)
    x, y = np.meshgrid(s, s, indexing="ij")
    core = _CORE * (x * np.sqrt(1.0 - 0.25 * y**2) + 1j * y * np.sqrt(1.0 - 0.25 * x**2))
    outward = 1.0 - tanh_law(0.3 / size, size, 1.0)[::-1, None]
    east = core[-1] + outward * (_RADIUS * np.exp(0.25j * np.pi * s) - core[-1])
    blocks = []
    for plane in (core, east, 1j * east, -east, -1j * east):
        angle = np.angle(plane)
        twist = _TWIST * (np.abs(plane) / _RADIUS) ** 4 * np.sin(angle + 0.7 * (1.0 - np.cos(angle)))
        turned = plane * np.exp(1j * twist)
        blocks.append(np.stack([turned.real, turned.imag, 0.0 * angle], axis=-1)[:, :, None])
    grid = Grid.from_blocks(blocks, ["core", "east", "north", "west", "south"])
    return with_patches(grid, [("wall", "BCWall", lambda c, side: np.full(len(c), True))])
