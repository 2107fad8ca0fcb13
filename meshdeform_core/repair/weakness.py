"""Which cells of a valid grid are weak, and which of two grids is the sounder one."""

from __future__ import annotations

import numpy as np

from ..grid import BoolArray, FloatArray
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


def is_sounder(original: Original, one: Comparison, other: Comparison) -> bool:
    """Whether the worst of the cells in which two grids differ is better in ``one``; prescribed ones are alike."""
    mine, theirs = _soundness(original, one), _soundness(original, other)
    differ = mine != theirs
    return bool(differ.any()) and float(mine[differ].min()) > float(theirs[differ].min())


def _soundness(original: Original, cells: Comparison) -> FloatArray:
    """(n_cells,) the smaller ratio of corner Jacobians and of f_skew to the undeformed ones."""
    assert original.measured is not None
    before = original.measured.skews
    kept = np.divide(cells.after.skews, before, out=np.ones_like(before), where=before > 0.0)
    return np.asarray(np.minimum(cells.verdict.ratio, kept))
