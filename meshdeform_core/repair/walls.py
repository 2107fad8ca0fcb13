"""How much cells near moving walls count in a repair, so that they turn with the wall and others take what is left.

Minimised alike everywhere, the energy concentrates shear at a wall that turns (in a ring, as 1 / r^2): first cells lost
nine tenths of their height there. Weights that fall with the square of the distance turn that round.
"""

from __future__ import annotations

import numpy as np

from ..grid import FloatArray

REACH = 32
_SHARE = 0.4
"""Cells count more up to REACH cells from moving walls, and up to this share of the largest distance in the grid: where
there is little room, walls must give, too."""
UNLIMITED = 1 << 14


def nearness(layers: np.ndarray) -> FloatArray:
    """Distance of nodes from moving walls as a share (n,) of how far these count, at most 1; 1 without any walls.

    ``layers`` (n,) are the distances in cells, -1 where there is no way to a wall.
    """
    reach = max(1.0, min(REACH, _SHARE * int(layers.max(initial=0))))
    return np.where(layers < 0, 1.0, np.minimum((layers + 1.0) / reach, 1.0)).astype(np.float64)


def weights(share: FloatArray) -> FloatArray:
    """Weights (m,) of cells by the :func:`nearness` (m, k) of their nodes."""
    return np.asarray(share.min(axis=1) ** -2.0)
