"""How much cells near moving walls count in a repair, so that they turn with the wall and others take what is left."""

from __future__ import annotations

import numpy as np

from ..grid import FloatArray, IntArray

FAR = 32
"""Cells that are so many cells away from moving walls, or more, count once; the first layer FAR^2 times.

Minimised alike everywhere, the energy concentrates shear at a wall that turns (in a ring, as 1 / r^2): first cells lost
nine tenths of their height there. Weights that fall with the square of the distance turn that round.
"""


def weights(layers: IntArray) -> FloatArray:
    """Weights (m,) of cells by the distances (m, k) of their nodes from moving walls, in cells, -1 beyond FAR."""
    layer = np.where(layers < 0, FAR, layers).min(axis=1, initial=FAR)
    return np.asarray(FAR / np.clip(layer + 1, 1, FAR)) ** 2
