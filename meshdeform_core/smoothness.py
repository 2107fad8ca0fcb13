"""How smoothly the nodes of a grid move from level to level of a series."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from .grid import FloatArray, Grid, IntArray
from .numerics.arrays import lengths
from .parallel import Nodes, empty

_JUMP, _JUMP_IN_EDGES = 0.5, 0.2
"""The grid jumps where its acceleration exceeds that of the walls by JUMP wall steps, and JUMP_IN_EDGES local edges."""

_AT_REST = 0.01
"""A step of the walls smaller than this fraction of the other one says little about how nodes follow."""
# Nodes per chunk, as a copy of the whole grid might not fit into memory.
_ROWS = 1 << 16


@dataclass(frozen=True)
class Smoothness:
    """How smoothly the nodes move at a level of a series.

    Attributes
    ----------
    velocity, acceleration : largest values of any node, times the interval and its square, relative to the largest step
        of the walls; ``None`` where nothing moves or earlier levels are not known
    acceleration_in_edges : largest acceleration relative to the shortest undeformed edge at the node
    wall : largest acceleration of the walls, in the same unit as ``acceleration``
    reach : largest ratio of a node's movement to that of the walls
    plain : whether the levels are those of the method alone
    """

    velocity: float | None
    acceleration: float | None
    acceleration_in_edges: float | None
    wall: float | None = None
    reach: float = 1.0
    plain: bool = True

    @property
    def beyond(self) -> float:
        """Excess of the acceleration over that of the walls; 0 where it is not known.

        Nodes that move v times as far as the walls may be accelerated v times as much, for example where a motion
        reverses.
        """
        if self.acceleration is None or self.wall is None:
            return 0.0
        return self.acceleration - max(1.0, self.reach) * self.wall

    @property
    def warning(self) -> str | None:
        """A warning if the grid jumps although the walls do not."""
        slight = self.beyond < _JUMP or (self.acceleration_in_edges or 0.0) < _JUMP_IN_EDGES
        if self.acceleration is None or self.plain or slight:
            return None
        steps = f"{self.acceleration:.3g} steps"
        steps = "1 step" if steps == "1 steps" else steps
        return (
            f"the grid jumps although its walls do not: a node is accelerated by {steps} of "
            f"the walls ({self.acceleration_in_edges:.3g} local edges) at this level, the walls by {self.wall:.3g}"
        )


class Moment(NamedTuple):
    """A level: its time and coordinates (n_nodes, 3); ``plain``: whether it was made in one step without a repair, and
    so is as smooth as its walls."""

    time: float
    points: FloatArray
    plain: bool


def shortest_edges(grid: Grid) -> FloatArray:
    """Length (n_nodes,) of the shortest edge at every node, ignoring zero lengths; infinite if none. If the grid is in
    parts, only at the nodes of this rank."""
    grid.hold_neighbours()
    low, high = grid.nodes.ends
    result: FloatArray = empty([high - low])
    for number, (ni, nj, nk) in enumerate(grid.shapes):
        own, start = grid.planes(number), int(grid.offsets[number])
        # A few layers at a time, with their neighbours.
        layers = max(1, _ROWS // (nj * nk))
        for first in range(own.start, own.stop, layers):
            last = min(first + layers, own.stop)
            begin, end = max(first - 1, 0), min(last + 1, ni)
            x = grid.points[start + begin * nj * nk : start + end * nj * nk].reshape(-1, nj, nk, 3)
            shortest = np.full(x.shape[:3], np.inf)
            for axis in range(3):
                length = np.moveaxis(np.linalg.norm(np.diff(x, axis=axis), axis=-1), axis, 0)
                length[length == 0.0] = np.inf
                ends = np.moveaxis(shortest, axis, 0)
                for some in (ends[:-1], ends[1:]):
                    np.minimum(some, length, out=some)
            rows = slice(start + first * nj * nk - low, start + last * nj * nk - low)
            result[rows] = shortest[first - begin : last - begin].ravel()
    return result


def smoothness(levels: list[Moment], walls: IntArray, edges: FloatArray) -> Smoothness:
    """Smoothness of the last of up to three consecutive levels; ``walls`` are block nodes on moving walls."""
    if len(levels) < 2:
        return Smoothness(None, None, None)
    at_walls = [float(length.max(initial=0.0)) for length in _movements(levels, walls)]
    step = max(at_walls[:2])
    if step == 0.0:
        return Smoothness(None, None, None)
    # Of all nodes; the last movement also in local edges.
    points = levels[-1].points
    low, high = Nodes.of(points).ends
    largest, in_edges = np.zeros(min(2 * len(levels) - 3, 3)), 0.0
    for first in range(low, high, _ROWS):
        some = slice(first, min(first + _ROWS, high))
        found = _movements(levels, some)
        largest = np.maximum(largest, [length.max() for length in found])
        in_edges = max(in_edges, float((found[-1] / edges[some.start - low : some.stop - low]).max()))
    every = Nodes.of(points).gather((largest, in_edges))
    largest, in_edges = np.max([each for each, _ in every], axis=0), max(each for _, each in every)
    speed = float(largest[0]) / step
    if len(levels) == 2:
        return Smoothness(speed, None, None)
    # A jump may lie in either of the last two movements.
    movements = zip(largest[:2].tolist(), at_walls[:2], strict=True)
    reach = min(moved / walled for moved, walled in movements if walled > _AT_REST * step)
    plain = all(level.plain for level in levels)
    return Smoothness(speed, float(largest[2]) / step, in_edges, at_walls[2] / step, reach, plain)


def _movements(levels: list[Moment], nodes: IntArray | slice) -> list[FloatArray]:
    """Movements of some nodes between levels: the last one, and with three levels the preceding one, scaled to the same
    interval, and the difference of the two."""
    last = levels[-1].points[nodes] - levels[-2].points[nodes]
    if len(levels) == 2:
        return [lengths(last)]
    before = levels[-2].points[nodes] - levels[-3].points[nodes]
    before *= (levels[-1].time - levels[-2].time) / (levels[-2].time - levels[-3].time)
    return [lengths(last), lengths(before), lengths(last - before)]
