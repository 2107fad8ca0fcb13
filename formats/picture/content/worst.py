"""The cell with the worst value of a metric."""

from __future__ import annotations

import numpy as np

from meshdeform_core.grid import Shape
from meshdeform_core.parallel import of_all

from .subject import METRICS, Subject


def worst_cell(subject: Subject, metric: str) -> tuple[int, Shape]:
    """Block and cell (0-based) where a metric is worst; among invalid cells the one with the worst corner.

    Worst is the smallest value, for rising measures the largest, for ratios the one farthest from 1.
    """
    with subject.ready(metric):
        best = _worst_of_rank(subject, metric)
    _, block, cell = min(of_all(subject.grid.points, best), key=lambda each: each[0])
    return block, cell


def _worst_of_rank(subject: Subject, metric: str) -> tuple[float, int, Shape]:
    """Rank, block and place of the worst cell that this rank holds."""
    known = METRICS[metric]
    best = (np.inf, 0, (0, 0, 0))
    for block in range(subject.grid.n_blocks):
        cells = subject.own(block, subject.whole(block))
        if cells[0].start == cells[0].stop:
            continue
        values = subject.values(metric, block, cells)
        rank = -np.abs(np.log(np.maximum(values, 1e-300))) if known.diverging else -values if known.rising else values
        rank = np.where(np.isfinite(values), rank, np.inf)
        bad = subject.bad(block, cells)
        if bad.any():
            # Invalid cells rank below all valid ones, by the size of their negative corner Jacobian.
            scaled = subject.measure(block, cells).scaled
            rank = np.where(bad, -1e300 * (1.0 - 0.5 * scaled) / 1.5, rank)
        at = int(np.argmin(rank))
        if rank.ravel()[at] < best[0]:
            i, j, k = (int(n) for n in np.unravel_index(at, rank.shape))
            best = (float(rank.ravel()[at]), block, (cells[0].start + i, j, k))
    return best
