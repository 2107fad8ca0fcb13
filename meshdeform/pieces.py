"""Arrays of which every MPI rank holds a piece, as distributed solvers and OpenMDAO hand them over."""

from __future__ import annotations

from typing import Any

import numpy as np

from meshdeform_core.grid import FloatArray, IntArray
from meshdeform_core.parallel import Ranks, empty, sharing


def share_of(count: int, ranks: Ranks) -> slice:
    """The rows of this rank where ``count`` rows are divided evenly: rank r has those from int(count r / ranks)."""
    return slice(count * ranks.number // ranks.count, count * (ranks.number + 1) // ranks.count)


def gathered(ranks: Ranks, piece: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """The rows of all ranks, in the order of the ranks; read-only, as the ranks of a machine share them."""
    ends = np.cumsum([0, *ranks.gather([len(piece)])])
    with sharing(ranks, None):
        whole: np.ndarray[Any, Any] = empty((int(ends[-1]), *piece.shape[1:]), piece.dtype)
    ranks.begin([whole])
    whole[ends[ranks.number] : ends[ranks.number + 1]] = piece
    ranks.share(whole, lambda number: [np.arange(ends[number], ends[number + 1])])
    ranks.finish([whole])
    return whole


def summed(ranks: Ranks, count: int, rows: IntArray, values: FloatArray) -> FloatArray:
    """Sum (count, 3) of the ``values`` (n, 3) that all ranks give for ``rows`` (n,); rows may repeat."""
    every, what = gathered(ranks, rows), gathered(ranks, values)
    with sharing(ranks, None):
        total: FloatArray = empty((count, 3))

    def add() -> None:
        for axis in range(3):
            total[:, axis] = np.bincount(every, what[:, axis], minlength=count)

    ranks.alter(total, add)
    return total
