"""Gradients of quality measures with respect to the coordinates, for constraints of optimisers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...errors import GridError
from ...grid import FloatArray, Grid, IntArray
from ...grid.planes import plane_normal
from ...grid.topology import Topology
from ...numerics.tape import Tape
from .cells import corner_nodes, places, side_of_good_quads

# Cells recorded on one tape.
_CELLS = 8192

Values = Callable[[Any, Any], Any]


@dataclass(frozen=True)
class Measure:
    """A measure of a grid: ``values`` of cells (n, ...) from their edges, and a function that combines them.

    ``combine(values, sharpness)`` gives the number and its derivatives with respect to the values.
    """

    values: Values
    combine: Callable[[FloatArray, float], tuple[float, FloatArray]]


def quality_gradient(
    grid: Grid,
    points: FloatArray,
    topology: Topology,
    measure: str,
    sharpness: float,
    blocks: Sequence[int] | None = None,
) -> tuple[float, FloatArray]:
    """A measure of the grid with coordinates ``points`` (n_nodes, 3), and its gradient (n_nodes, 3).

    With ``blocks`` (numbers from 0), only the cells of these blocks count.

    Raises
    ------
    GridError
        For an unknown measure or block, and for f_skew of a grid with a corner Jacobian <= 0, where it is zero.
    """
    if measure not in MEASURES:
        raise GridError(f"no quality measure {measure!r}; expected one of {', '.join(MEASURES)}")
    some = range(grid.n_blocks) if blocks is None else sorted(set(blocks))
    if not some or not all(0 <= block < grid.n_blocks for block in some):
        raise GridError(f"blocks = {list(some)}; expected numbers from 0 to {grid.n_blocks - 1}")
    chosen, parts = MEASURES[measure], list(_parts(grid, topology, some))
    with np.errstate(all="ignore"):
        every = [chosen.values(points[nodes], side) for nodes, side in parts]
    found = np.concatenate(every)
    if not np.isfinite(found).all():
        raise GridError(
            f"{measure} is zero in {np.count_nonzero(~np.isfinite(found)):,} cells with a corner Jacobian that is not "
            f"positive, and has no gradient there; expected a valid grid, or use scaled_jacobian_min"
        )
    value, weights = chosen.combine(found, sharpness)
    gradient, first = np.zeros((grid.n_nodes, 3)), 0
    for nodes, side in parts:
        tape = Tape()
        corners = tape.variable(points[nodes])
        result = chosen.values(corners, side)
        weight = weights[first : first + len(nodes)]
        np.add.at(gradient, nodes, tape.pull({result.number: weight}, [corners.number])[0])
        first += len(nodes)
    return value, gradient


def _parts(grid: Grid, topology: Topology, blocks: Iterable[int]) -> Iterator[tuple[IntArray, Any]]:
    """Corner nodes (n, 8) of a limited number of cells of one block at a time, with the handedness of the block or, in
    2-D, the normal of its cells."""
    starts, normal = grid.cell_offsets, plane_normal(grid)
    for block in blocks:
        side: Any = float(topology.handedness[block])
        if normal is not None:
            flat = grid.shapes[block].index(1)
            side = flat, side_of_good_quads(flat, side, normal)
        for first in range(starts[block], starts[block + 1], _CELLS):
            cells = np.arange(first, min(first + _CELLS, starts[block + 1]))
            yield corner_nodes(grid, *places(grid, cells)), side


def _corner_edges(x: Any, side: Any) -> Iterator[tuple[Any, list[Any]]]:
    """Jacobian (n,) and edges of every corner of cells with corners ``x`` (n, 8, 3); (n, 3) each."""

    def edge(axis: int, corner: tuple[int, int, int]) -> Any:
        low, high = list(corner), list(corner)
        low[axis], high[axis] = 0, 1
        return x[:, 4 * high[0] + 2 * high[1] + high[2]] - x[:, 4 * low[0] + 2 * low[1] + low[2]]

    plane = isinstance(side, tuple)
    for corner in np.ndindex(2, 2, 2):
        if not plane:
            edges = [edge(axis, corner) for axis in range(3)]
            yield side * np.einsum("ni,ni->n", edges[0], np.cross(edges[1], edges[2])), edges
        elif corner[side[0]] == 0:
            edges = [edge(axis, corner) for axis in range(3) if axis != side[0]]
            yield np.einsum("ni,i->n", np.cross(*edges), side[1]), edges


def _inverse_skew(x: Any, side: Any) -> Any:
    """1 / f_skew (n,) (Knupp 2003); infinite or not a number where a corner Jacobian is not positive."""
    total, count = 0.0, 0
    for jacobian, edges in _corner_edges(x, side):
        product = 1.0
        for edge in edges:
            product = product * np.einsum("ni,ni->n", edge, edge)
        # Negative bases of the power yield NaN.
        total = total + (np.sqrt(product) / jacobian) ** (2.0 / len(edges))
        count += 1
    return total / count


def _scaled_jacobians(x: Any, side: Any) -> Any:
    """Jacobians (n, corners) of all corners with edges scaled to unit length; zero at collapsed edges."""
    found = []
    for jacobian, edges in _corner_edges(x, side):
        for edge in edges:
            square = np.einsum("ni,ni->n", edge, edge)
            jacobian = jacobian / np.sqrt(np.where(square > 0.0, square, 1.0))
        found.append(jacobian)
    return np.stack(found, axis=1)


def _volume(x: Any, side: Any) -> Any:
    """Volume (n,) of trilinear cells, in 2-D their area."""
    total, edges_of = 0.0, []
    for jacobian, edges in _corner_edges(x, side):
        total = total + jacobian
        edges_of.append(edges)
    if len(edges_of) == 4:
        return total / 4.0
    # Every edge belongs to two corners.
    u, v, w = (sum((each[axis] for each in edges_of[1:]), edges_of[0][axis]) / 8.0 for axis in range(3))
    return total / 24.0 + (2.0 / 3.0) * side * np.einsum("ni,ni->n", u, np.cross(v, w))


def _harmonic(inverse: FloatArray, sharpness: float) -> tuple[float, FloatArray]:
    total = float(inverse.sum())
    return len(inverse) / total, np.full(len(inverse), -len(inverse) / total**2)


def _smallest(values: FloatArray, sharpness: float) -> tuple[float, FloatArray]:
    """Smooth lower bound of the minimum (Kreisselmeier & Steinhauser 1979), too low by log(n) / sharpness at most."""
    least = float(values.min())
    share = np.exp(-sharpness * (values - least))
    total = float(share.sum())
    return least - np.log(total) / sharpness, share / total


def _smallest_skew(inverse: FloatArray, sharpness: float) -> tuple[float, FloatArray]:
    value, share = _smallest(1.0 / inverse, sharpness)
    return value, -share / inverse**2


def _sum(values: FloatArray, sharpness: float) -> tuple[float, FloatArray]:
    return float(values.sum()), np.ones(len(values))


MEASURES = {
    "f_skew": Measure(_inverse_skew, _harmonic),
    "f_skew_min": Measure(_inverse_skew, _smallest_skew),
    "scaled_jacobian_min": Measure(_scaled_jacobians, _smallest),
    "volume": Measure(_volume, _sum),
}
"""Harmonic mean and smooth minimum of f_skew, smooth minimum of scaled corner Jacobians, total volume."""
