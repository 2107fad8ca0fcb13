"""The nodes of a block edge, from sections that each have a share of the length and of the cells, and an expansion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from meshdeform_core.grid import FloatArray, IntArray


@dataclass(frozen=True)
class Section:
    """Part of an edge: its share of the length and of the cells, and the ratio of its last to its first cell."""

    length: float = 1.0
    cells: float = 1.0
    ratio: float = 1.0


Grading = tuple[Section, ...]
UNIFORM: Grading = (Section(),)


def reversed_grading(grading: Grading) -> Grading:
    """The grading as seen from the other end of the edge."""
    return tuple(Section(part.length, part.cells, 1.0 / part.ratio) for part in reversed(grading))


def divide(cells: int, grading: Sequence[Section]) -> FloatArray:
    """Parameters (cells + 1,) of the nodes from 0 to 1, as blockMesh places them.

    An edge with fewer cells than sections is divided uniformly. The section with the largest share of cells absorbs
    the rounding.
    """
    if cells < len(grading):
        return np.linspace(0.0, 1.0, cells + 1)
    lengths = np.array([part.length for part in grading])
    found = [np.zeros(1)]
    for part, length, count in zip(grading, lengths / lengths.sum(), section_cells(cells, grading), strict=True):
        found.append(found[-1][-1] + length * _section(int(count), part.ratio))
    nodes = np.concatenate(found)
    nodes[-1] = 1.0
    return nodes


def section_cells(cells: int, grading: Sequence[Section]) -> IntArray:
    """Cells of each section of an edge that has at least as many cells as sections."""
    shares = np.array([part.cells for part in grading])
    shares = shares / shares.sum()
    counts = np.floor(shares * cells + 0.5).astype(np.int64)
    counts[np.argmax(shares)] += cells - counts.sum()
    return np.asarray(counts)


def _section(count: int, ratio: float) -> FloatArray:
    """Ends of the cells of one section, in parts of its length."""
    steps = np.arange(1, count + 1)
    if count < 2 or abs(ratio - 1.0) < 1e-12:
        return steps / max(count, 1)
    growth = ratio ** (1.0 / (count - 1))
    return np.asarray((1.0 - growth**steps) / (1.0 - growth**count))
