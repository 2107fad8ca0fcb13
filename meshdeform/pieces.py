"""Arrays of which every MPI rank holds a piece, as in distributed solvers and OpenMDAO."""

from __future__ import annotations

from typing import Any

import numpy as np

from meshdeform_core.grid import FloatArray, IntArray
from meshdeform_core.parallel import Ranks


def share_of(count: int, ranks: Ranks) -> slice:
    """The rows of this rank when ``count`` rows are divided evenly: those of rank r begin at int(count r / ranks)."""
    return slice(count * ranks.number // ranks.count, count * (ranks.number + 1) // ranks.count)


def gathered(ranks: Ranks, piece: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """The rows of all ranks, in the order of the ranks."""
    return np.array(ranks.collect(piece, ranks.gather([len(piece)])))


def summed(ranks: Ranks, count: int, rows: IntArray, values: FloatArray) -> FloatArray:
    """Sum (count, 3) of the ``values`` (n, 3) of all ranks for ``rows`` (n,), which may repeat."""
    every, what = gathered(ranks, rows), gathered(ranks, values)
    return np.stack([np.bincount(every, what[:, axis], minlength=count) for axis in range(3)], axis=1)
