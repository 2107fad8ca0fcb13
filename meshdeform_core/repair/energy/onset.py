"""How much a repair does: nothing while all cells are healthy, smoothly more as they grow weak.

A repair that began at a threshold would make a moving grid jump where the threshold is passed. The share of the energy
of cells, against the elastic one that holds the grid, therefore grows as a power of the excess of the whole grid: the
norm of log(f / HEALTHY) over all corners, with f regularised so that it passes through inversion without a jump.
"""

from __future__ import annotations

import numpy as np

from ...grid import FloatArray
from ..tuned import BETWEEN, FULL, NORM, POWER
from .elements import Energy


def share_of(energy: Energy, x: FloatArray) -> tuple[float, Energy]:
    """The share of the energy for a grid at ``x`` (n, d), 0 where all cells are healthy, and the energy of it.

    Samples of hexahedra between corners count by the excess of their own cell, at most as corners do.
    """
    excess, whole = _excess(energy, x)
    if whole == 0.0:
        return 0.0, energy
    return (whole / FULL) ** POWER, energy.with_between(_share_between(excess))


def share_slopes(energy: Energy, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """How the share, and that of the samples between corners of each cell, follow the excess of the cells (m,)."""
    excess, whole = _excess(energy, x)
    if whole == 0.0:
        return np.zeros_like(excess), np.zeros_like(excess)
    between, beyond = _share_between(excess), excess - BETWEEN
    inside = (between > 0.0) & (between < 1.0)
    of_between = np.divide(POWER * between, beyond, out=np.zeros_like(excess), where=inside)
    return POWER / FULL * (whole / FULL) ** (POWER - 1.0) * (excess / whole) ** (NORM - 1.0), of_between


def _excess(energy: Energy, x: FloatArray) -> tuple[FloatArray, float]:
    """The excess of the cells (m,), and that of the whole grid."""
    excess = energy.excess(x)
    largest = float(excess.max(initial=0.0))
    if largest == 0.0:
        return excess, 0.0
    return excess, largest * float(((excess / largest) ** NORM).sum()) ** (1.0 / NORM)


def _share_between(excess: FloatArray) -> FloatArray:
    return np.clip((excess - BETWEEN) / (FULL - BETWEEN), 0.0, 1.0) ** POWER
