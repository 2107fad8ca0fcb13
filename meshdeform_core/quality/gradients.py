"""Gradients of quality measures with respect to the coordinates, for constraints of optimisers."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from ..errors import GridError
from ..grid import FloatArray, Grid, IntArray
from ..grid.planes import plane_normal
from ..grid.topology import Topology
from ..numerics.cell.measures import corners_and_edges, scaled_jacobians, volume
from ..numerics.pieces import pieces
from ..numerics.tape import Tape, plain
from ..parallel import Nodes
from .cells import corner_nodes, places, positive_side

# Cells recorded on one tape.
_CELLS = 8192


def quality_gradient(
    grid: Grid,
    points: FloatArray,
    topology: Topology,
    measure: str,
    sharpness: float,
    blocks: Sequence[int] | None = None,
) -> tuple[float, FloatArray]:
    """A measure of the grid with coordinates ``points`` (n_nodes, 3), and its gradient (n_nodes, 3).

    With ``blocks`` (numbers from 0), only the cells of these blocks count. Of a grid in parts, all ranks must call
    this. f_skew of a grid with a corner Jacobian <= 0, where it is zero, has no gradient and is refused.
    """
    if measure not in MEASURES:
        raise GridError(f"no quality measure {measure!r}; expected one of {', '.join(MEASURES)}")
    some = range(grid.n_blocks) if blocks is None else sorted(set(blocks))
    if not some or not all(0 <= block < grid.n_blocks for block in some):
        raise GridError(f"blocks = {list(some)}; expected numbers from 0 to {grid.n_blocks - 1}")
    grid.hold_neighbours(points)
    (values, smallest), ranks = MEASURES[measure], Nodes.of(points)
    with np.errstate(all="ignore"):
        cells = _cells_behind_planes(grid, topology, some, False)
        parts = [values(ranks.rows[nodes], side) for nodes, side in cells]
    invalid = sum(ranks.gather(sum(np.count_nonzero(~np.isfinite(part)) for part in parts)))
    if invalid:
        raise GridError(
            f"{measure} is zero in {invalid:,} cells with a corner Jacobian that is not "
            f"positive, and has no gradient there; expected a valid grid, or use scaled_jacobian_min"
        )
    least = min(ranks.gather(min((float(part.min()) for part in parts), default=math.inf)))

    def share(part: FloatArray) -> FloatArray:
        return np.exp(-sharpness * (part - least)) if smallest else part

    # Part by part, so that it does not depend on the ranks.
    total = math.fsum(each for found in ranks.gather([float(share(part).sum()) for part in parts]) for each in found)
    count = sum(ranks.gather(sum(part.size for part in parts)))
    slope: Callable[[FloatArray], FloatArray] = np.ones_like
    value = total
    if smallest:
        # Kreisselmeier & Steinhauser 1979: too low by log(count) / sharpness at most.
        value, slope = least - math.log(total) / sharpness, lambda part: share(part) / total
    elif measure == "f_skew":
        value, slope = count / total, lambda part: np.full(len(part), -count / total**2)
    gradient = ranks.like(3)
    Nodes.of(gradient).each(lambda own: gradient[own].fill(0.0))
    for nodes, side in _cells_behind_planes(grid, topology, some, True):
        tape = Tape()
        corners = tape.variable(ranks.rows[nodes])
        result = values(corners, side)
        np.add.at(Nodes.of(gradient).rows, nodes, tape.pull({result.number: slope(plain(result))}, [corners.number])[0])
    return value, gradient


def _cells_behind_planes(
    grid: Grid, topology: Topology, blocks: Iterable[int], around: bool
) -> Iterator[tuple[IntArray, Any]]:
    """Corner nodes (n, 8 or 4) and side of the cells of blocks behind the planes i of this rank, a limited number of
    them at a time, in the order of pieces; with ``around``, also of those before its first plane, which come first."""
    normal = plane_normal(grid)
    for block, first, last in pieces(grid.shapes).tolist():
        own, (ci, cj, ck) = grid.planes(block), grid.cell_shapes[block]
        if block not in blocks or not own.start <= first < last <= own.stop:
            continue
        begin = first - (around and first == own.start > 0)
        side = positive_side(grid.shapes[block][1] == 1, topology.handedness[block] * 1.0, normal)
        start, stop = (int(grid.cell_offsets[block]) + min(plane, ci) * cj * ck for plane in (begin, last))
        for lo in range(start, stop, _CELLS):
            yield corner_nodes(grid, *places(grid, np.arange(lo, min(lo + _CELLS, stop)))), side


def _inverse_skew(x: Any, side: Any) -> Any:
    """1 / f_skew (n,) (Knupp 2003); infinite or not a number where a corner Jacobian is not positive."""
    corners = corners_and_edges(x, side)
    scaled = scaled_jacobians(corners)
    scaled = np.where(scaled > 0.0, scaled, np.nan)
    return (scaled ** (-2.0 / len(corners[0][1]))).sum(axis=1) / len(corners)


MEASURES: dict[str, tuple[Callable[[Any, Any], Any], bool]] = {
    "f_skew": (_inverse_skew, False),
    "f_skew_min": (lambda x, side: 1.0 / _inverse_skew(x, side), True),
    "scaled_jacobian_min": (lambda x, side: scaled_jacobians(corners_and_edges(x, side)), True),
    "volume": (lambda x, side: volume(corners_and_edges(x, side), side), False),
}
"""Values of cells (n, ...), and whether their smooth minimum is taken: harmonic mean and smooth minimum of f_skew,
smooth minimum of scaled corner Jacobians, total volume."""
