"""How smoothly the nodes of a grid move from level to level of a series."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from .grid import FloatArray, Grid, IntArray
from .numerics.arrays import lengths

_JUMP, _JUMP_IN_EDGES = 0.5, 0.2
"""The grid jumps where its acceleration exceeds that of the walls by JUMP wall steps, and JUMP_IN_EDGES local edges."""

_AT_REST = 0.01
"""Of two steps of the walls, one that is smaller than this share of the other tells little of how nodes follow."""


@dataclass(frozen=True)
class Smoothness:
    """Largest node ``velocity`` and ``acceleration``, times the interval and its square, relative to the largest step
    of the walls, and the acceleration relative to the shortest undeformed edge at the node; ``None`` where nothing
    moves or the levels before are not known. ``wall`` is the acceleration of the walls in the same measure, ``reach``
    how many times as far as the walls a node moves, ``plain`` whether the levels are those of the method alone,
    ``ways`` how the level and the one before were made, if that differs."""

    velocity: float | None
    acceleration: float | None
    acceleration_in_edges: float | None
    wall: float | None = None
    reach: float = 1.0
    plain: bool = True
    ways: tuple[str, str] | None = None

    @property
    def beyond(self) -> float:
        """By how much the acceleration exceeds that of the walls; 0 where it is not known.

        Nodes that move v times as far as the walls may be accelerated v times as much: where a motion turns back.
        """
        if self.acceleration is None or self.wall is None:
            return 0.0
        return self.acceleration - max(1.0, self.reach) * self.wall

    @property
    def warning(self) -> str | None:
        """A warning if the grid jumps although the walls do not, or was made in another way than before."""
        if self.ways:
            return (
                f"the grid is made in another way from this level on: {self.ways[1]}, before {self.ways[0]}{self._jump}"
            )
        if self.plain or self.beyond < _JUMP or (self.acceleration_in_edges or 0.0) < _JUMP_IN_EDGES:
            return None
        return (
            f"the grid jumps although its walls do not: a node is accelerated by {self.acceleration:.3g} steps of the "
            f"walls ({self.acceleration_in_edges:.3g} local edges) at this level, the walls by {self.wall:.3g}"
        )

    @property
    def _jump(self) -> str:
        if self.acceleration is not None and self.wall is not None and self.acceleration_in_edges is not None:
            return (
                f". Its nodes are accelerated by up to {self.acceleration:.3g} steps of the walls "
                f"({self.acceleration_in_edges:.3g} local edges), the walls by {self.wall:.3g}"
            )
        return "" if self.velocity is None else f". Its nodes move by up to {self.velocity:.3g} steps of the walls"


class Moment(NamedTuple):
    """A level: its time and coordinates (n_nodes, 3), whether it is a method's grid in one step, without a repair, and
    so as smooth as its walls, and the way in which it was made."""

    time: float
    points: FloatArray
    plain: bool
    way: str = ""


def shortest_edges(grid: Grid) -> FloatArray:
    """(n_nodes,) the shortest edge of any length at every node, infinite where there is none."""
    result = np.full(grid.n_nodes, np.inf)
    for b, shape in enumerate(grid.shapes):
        block, mine = grid.block(b), result[grid.offsets[b] : grid.offsets[b + 1]].reshape(shape)
        for axis in range(3):
            if shape[axis] < 2:
                continue
            length = np.linalg.norm(np.diff(block, axis=axis), axis=-1)
            length[length == 0.0] = np.inf
            low, high = np.moveaxis(mine, axis, 0)[:-1], np.moveaxis(mine, axis, 0)[1:]
            np.minimum(low, np.moveaxis(length, axis, 0), out=low)
            np.minimum(high, np.moveaxis(length, axis, 0), out=high)
    return result


def smoothness(levels: list[Moment], walls: IntArray, edges: FloatArray) -> Smoothness:
    """Of the last of up to three consecutive levels; ``walls`` are block nodes on moving walls."""
    if len(levels) < 2:
        return Smoothness(None, None, None)
    ways = (levels[-2].way, levels[-1].way) if levels[-2].way != levels[-1].way else None
    last = levels[-1].points - levels[-2].points
    moved, step = _largest(last, walls)
    if len(levels) == 2:
        return Smoothness(moved / step if step else None, None, None, ways=ways)
    before = levels[-2].points - levels[-3].points
    before *= (levels[-1].time - levels[-2].time) / (levels[-2].time - levels[-3].time)
    largest = max(step, _largest(before, walls)[1])
    if largest == 0.0:
        return Smoothness(None, None, None, ways=ways)
    # A jump is in one of the two.
    reach = min(m / s for m, s in (_largest(last, walls), _largest(before, walls)) if s > _AT_REST * largest)
    last -= before
    change = lengths(last)
    wall = float(change[walls].max(initial=0.0)) / largest
    plain = all(level.plain for level in levels)
    relative = float(change.max()) / largest, float((change / edges).max())
    return Smoothness(moved / largest, *relative, wall, reach, plain, ways)


def _largest(change: FloatArray, walls: IntArray) -> tuple[float, float]:
    """How far nodes, and those of the walls, move at most."""
    distance = lengths(change)
    return float(distance.max()), float(distance[walls].max(initial=0.0))
