"""Plausibility checks of the coordinates of a grid from any format."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from meshdeform_core.errors import GridError
from meshdeform_core.grid import FloatArray, Grid
from meshdeform_core.numerics.arrays import IntArray, extent
from meshdeform_core.wording import vector

# The square of a larger length overflows in single precision, and no grid is so large in any unit.
LARGEST = 1e30
# Number of nodes sampled, and the fraction of them that may have denormal coordinates.
_SAMPLE = 10_000
_MOST_DENORMAL = 0.01
# A node off the line through two others by less than this fraction of their distance lies on it.
_ON_LINE = 1e-13


def require_plausible(grid: Grid, path: Path) -> None:
    """Refuse coordinates that are not finite, implausibly large, or all at one point or on one line.

    Raises GridError naming the first such node.
    """
    bad: list[IntArray] = []

    def judge(rows: slice) -> None:
        good = np.abs(grid.points[rows]) <= LARGEST
        # numpy is slow on axes of length 3, and this is hardly ever needed.
        if not good.all():
            bad.append(rows.start + np.flatnonzero(~good.all(axis=1)))

    grid.nodes.each(judge)
    found = [rows for own in grid.nodes.gather(bad) for rows in own]
    if found:
        count, first = sum(map(len, found)), min(int(rows[0]) for rows in found)
        point = grid.points[first]
        what = f"beyond {LARGEST:g}" if np.isfinite(point).all() else "not finite numbers"
        raise GridError(
            f"{path} has {count} nodes whose coordinates are {what}; the first is "
            f"{grid.node_label(first)} = {vector(point)}"
        )
    sample = grid.sample(_SAMPLE)
    size = np.abs(sample)
    share = float(((size > 0) & (size < np.finfo(np.float64).tiny)).mean())
    if share > _MOST_DENORMAL:
        raise GridError(
            f"{path}: {share:.0%} of the coordinates are smaller than any normal number ({size[size > 0].min():g}); "
            "they are bits of something else, or in the other byte order"
        )
    if not _on_one_line(sample):
        return
    # A sample is not enough, as it may happen to lie on a grid line.
    grid.nodes.require_whole("a sample of its nodes lies on one line")
    if _on_one_line(grid.points):
        first, (low, high) = grid.points[0], extent(grid.points)
        what = "on one line" if (low < high).any() else f"at one point, {vector(first)}"
        raise GridError(f"{path}: all {grid.n_nodes} nodes lie {what}; a grid needs at least a surface")


def _on_one_line(points: FloatArray) -> bool:
    """Whether all points ``(n, 3)`` lie on the line through the first one and the one farthest from it."""
    offsets = points - points[0]
    lengths = np.linalg.norm(offsets, axis=1)
    farthest = offsets[int(np.argmax(lengths))]
    length = float(lengths.max())
    if length == 0:
        return True
    off = np.linalg.norm(np.cross(offsets / length, farthest / length), axis=1)
    return bool(off.max() < _ON_LINE)
