"""Which cells of a valid grid are weak, where the grid is too large for the measure of :mod:`.onset`."""

from __future__ import annotations

import numpy as np

from ..grid import BoolArray
from ..quality import Original
from ..quality.comparison import Comparison
from ..quality.validity import Verdict

POOR = 0.1
"""Valid cells with a corner below this share of its undeformed Jacobian are weak."""
SKEWED, LOST = 0.2, 0.5
"""So are cells with f_skew below SKEWED, if the undeformed cell has more than that over LOST."""


def is_weak(original: Original, verdict: Verdict, cells: Comparison | None) -> bool:
    """Whether there are invalid or weak cells; without ``cells``, their f_skew is not looked at."""
    if verdict.failed.any() or (verdict.ratio < POOR).any():
        return True
    return cells is not None and bool(skewed(original, cells).any())


def skewed(original: Original, cells: Comparison) -> BoolArray:
    """(n_cells,) cells that the deformation has made skew."""
    assert original.measured is not None
    after = cells.after.skews
    return np.asarray((after < SKEWED) & (after < LOST * original.measured.skews))
