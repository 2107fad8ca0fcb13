"""How much a repair does: nothing while all cells are healthy, smoothly more as they grow weak.

A repair that began at a threshold would make a moving grid jump where the threshold is passed. The share of the energy
of cells, against the elastic one that holds the grid, therefore grows as a power of the excess of the whole grid: the
norm of log(f / HEALTHY) over all corners, with f regularised so that it passes through inversion without a jump.
"""

from __future__ import annotations

import numpy as np

from ...grid import FloatArray
from .elements import HEALTHY, NORM, Energy

_FULL, _POWER = 15.0, 3.0
"""A grid whose excess is that of one corner with f = FULL has a share of 1, with which the elastic energy matters
little."""


def share_of(energy: Energy, x: FloatArray) -> tuple[float, Energy]:
    """The share of the energy for a grid at ``x`` (n, d), 0 where all cells are healthy, and the energy of it.

    Samples of hexahedra between corners count by the excess of their own cell, at most as corners do.
    """
    excess = energy.excess(x)
    largest = float(excess.max(initial=0.0))
    if largest == 0.0:
        return 0.0, energy
    whole = largest * float(((excess / largest) ** NORM).sum()) ** (1.0 / NORM)
    return float(_share(whole)), energy.with_between(np.minimum(_share(excess), 1.0))


def share_slopes(energy: Energy, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """How the share, and that of the samples between corners of each cell, follow the excess of the cells (m,)."""
    excess = energy.excess(x)
    largest = float(excess.max(initial=0.0))
    if largest == 0.0:
        return np.zeros_like(excess), np.zeros_like(excess)
    whole = largest * float(((excess / largest) ** NORM).sum()) ** (1.0 / NORM)
    alone = _share(excess)
    inside = (excess > 0.0) & (alone < 1.0)
    between = np.divide(_POWER * alone, excess, out=np.zeros_like(excess), where=inside)
    return _POWER * _share(whole) / whole * (excess / whole) ** (NORM - 1.0), between


def _share(excess: float | FloatArray) -> float | FloatArray:
    return (excess / np.log(_FULL / HEALTHY)) ** _POWER
