"""Nodes around invalid cells are moved until every cell is sound; the boundary stays where it is."""

from __future__ import annotations

import time as clock
from dataclasses import dataclass

import numpy as np

from ..grid import FloatArray, IntArray
from .energy import lowest_determinants
from .neighbourhood import Neighbourhood
from .untangle import Region, Untangler

WEAK = 0.2
_LAYERS = (8, 16, 32)
_CORNERS = (1 << 8) - 1


@dataclass(frozen=True)
class Repair:
    """What a repair did: invalid cells before, nodes moved and how far, Newton steps, seconds."""

    cells: int
    nodes: int
    max_movement: float
    newton_steps: int
    seconds: float


def weak_first(region: Region, x: FloatArray) -> None:
    """Take all samples of weak cells, and only the corners of the others."""
    sound = region.mask
    if region.cells.shape[1] == 8:
        region.mask = sound & _CORNERS
        lowest = lowest_determinants(x, *region.energy)
        weak = lowest < WEAK
        region.mask[weak] = sound[weak]
