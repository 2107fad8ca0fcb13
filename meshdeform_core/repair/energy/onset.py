"""The onset of a repair: no effect while all cells are healthy, and a smoothly growing effect as they become weak.

A repair with a sharp threshold would make a moving grid jump when the threshold is passed. The energy of the cells
is therefore weighted, against the elastic energy that holds the grid, by a *share* that grows as a power of the
*excess* of the grid: the norm of log(f / HEALTHY) over all corners, with f regularised to stay finite on inversion.
"""

from __future__ import annotations

import itertools

import numpy as np

from ...grid import FloatArray
from ..tuned import ALONG, BETWEEN, FULL, NORM, POWER, SLOWLY
from .elements import Energy
from .region import Dealt


def share_of(energy: Energy, x: FloatArray, dealt: Dealt | None = None) -> tuple[float, Energy]:
    """The share for a grid at ``x`` (n, d), 0 where all cells are healthy, and the energy to which it applies.

    Samples of hexahedra between corners are weighted by the excess of their own cell, with corners as the upper limit.
    """
    excess, whole = _excess(energy, x, dealt or Dealt.alone(energy))
    if whole == 0.0:
        return 0.0, energy
    return (whole / FULL) ** POWER, energy.with_between(_share_between(excess))


def share_slopes(energy: Energy, x: FloatArray, dealt: Dealt | None = None) -> tuple[FloatArray, FloatArray]:
    """Derivatives of the share, and of each cell's share of samples between corners, with respect to excess (m,)."""
    excess, whole = _excess(energy, x, dealt or Dealt.alone(energy))
    if whole == 0.0:
        return np.zeros_like(excess), np.zeros_like(excess)
    between, beyond = _share_between(excess), excess - BETWEEN
    inside = (between > 0.0) & (between < 1.0)
    of_between = np.divide(SLOWLY * between, beyond, out=np.zeros_like(excess), where=inside)
    return POWER / FULL * (whole / FULL) ** (POWER - 1.0) * (excess / whole) ** (NORM - 1.0), of_between


def kept_along_lines(share: float) -> tuple[float, float]:
    """The part of the differences along the lines of an extruded grid that a repair keeps, and its derivative with
    respect to the share; smooth where it ends."""
    part = min(share / ALONG, 1.0)
    return (1.0 - part) ** 2 * (1.0 + 2.0 * part), -6.0 * part * (1.0 - part) / ALONG


def _excess(energy: Energy, x: FloatArray, dealt: Dealt) -> tuple[FloatArray, float]:
    """The excess (m,) of the cells, and that of the grid."""
    excess = energy.excess(x)
    largest = float(dealt.nodes.joined(np.array([excess.max(initial=0.0)])).max())
    if largest == 0.0:
        return excess, 0.0
    sums = [((excess[low:high] / largest) ** NORM).sum() for low, high in itertools.pairwise(dealt.chunks)]
    return excess, largest * float(dealt.nodes.joined(np.array(sums)).sum()) ** (1.0 / NORM)


def _share_between(excess: FloatArray) -> FloatArray:
    return np.asarray(np.clip((excess - BETWEEN) / (FULL - BETWEEN), 0.0, 1.0) ** SLOWLY)
