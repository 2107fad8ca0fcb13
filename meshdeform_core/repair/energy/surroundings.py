"""An energy that compares cells with their neighbours in the deformed grid instead of with undeformed cells.

Where a gap closes to a few per cent, the cells of every valid grid are far from their undeformed shape, and an energy
relative to that shape folds some cells so that others keep theirs. Relative to the mean metric of the surrounding
deformed cells, a folded cell differs from its neighbours and unfolds within a few steps. Cells that are sheared between
walls rotating against each other gain nothing from that metric and are compared with undeformed cells.
"""

from __future__ import annotations

import numpy as np

from ...grid import FloatArray, IntArray
from ...parallel import Halo
from .elements import Energy
from .region import Dealt

_SQUEEZED = 0.03
"""Cells count as squeezed if the mean volume around them is below this fraction of the undeformed volume."""
_ROUNDS = 4
"""Number of times that metrics are averaged over the elements at each node and back over the nodes of each element."""


def among_others(energy: Energy, x: FloatArray, dealt: Dealt | None = None) -> Energy | None:
    """The energy relative to elements stretched like the average of their surroundings in the grid ``x`` (n, d);
    ``None`` if no element is squeezed."""
    halo = (dealt or Dealt.alone(energy)).nodes
    stretch = _stretch(energy.matrices(x), energy.nodes, halo)
    volume = np.linalg.det(stretch).min(initial=np.inf)
    return energy.stretched(stretch) if halo.joined(np.array([volume])).min() < _SQUEEZED else None


def _stretch(matrix: FloatArray, nodes: IntArray, halo: Halo) -> FloatArray:
    """The square root (m, d, d) of the mean metric around elements (m, k), from their Jacobian matrices (m, d, d)."""
    n = len(halo.numbers)
    metric = np.einsum("mji,mjk->mik", matrix, matrix)
    shape, corners = metric.shape, nodes.shape[1]
    at = nodes.ravel()
    count = halo.complete(np.maximum(np.bincount(at, minlength=n), 1))
    # A rank may have no elements.
    metric = metric.reshape(shape[0], shape[1] * shape[2])
    for _ in range(_ROUNDS):
        columns = [np.bincount(at, np.repeat(column, corners), minlength=n) / count for column in metric.T]
        metric = np.stack([halo.complete(column)[nodes].mean(axis=1) for column in columns], axis=1)
    squares, axes = np.linalg.eigh(metric.reshape(shape))
    # A small extent remains where all surrounding cells are flat.
    lengths = np.sqrt(np.maximum(squares, 1e-12))
    return np.einsum("mij,mj,mkj->mik", axes, lengths, axes)
