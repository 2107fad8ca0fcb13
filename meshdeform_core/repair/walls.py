"""Weights of cells near moving walls in a repair: these cells turn with the wall, and others take up the rest.

With equal weights everywhere, the minimum of the energy concentrates shear at a rotating wall (in a ring, as 1 / r^2),
where first cells would lose nine tenths of their height. Weights that fall with the square of distance reverse that.
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
    """Distance of nodes from moving walls relative to their reach, (n,), at most 1; 1 without any walls.

    ``layers`` (n,) are the distances in cells, -1 where no wall can be reached.
    """
    reach = max(1.0, min(REACH, _SHARE * int(layers.max(initial=0))))
    return np.where(layers < 0, 1.0, np.minimum((layers + 1.0) / reach, 1.0)).astype(np.float64)


def weights(share: FloatArray) -> FloatArray:
    """Weights (m,) of cells by the :func:`nearness` (m, k) of their nodes."""
    return np.asarray(share.min(axis=1) ** -2.0)
