"""Velocities of a moving grid, of its nodes and of its faces such that they satisfy the geometric conservation law; and
how smoothly its nodes move from level to level."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from .grid import Field, FloatArray, Grid, IntArray
from .grid.planes import block_handedness, plane_normal
from .numerics.arrays import lengths
from .numerics.geometry.vectors import cross, dot
from .parallel import Nodes, empty, for_chunks
from .quality.cells import positive_side

VELOCITIES = ("none", "first", "second", "swept")
"""Orders of backward differences at the nodes, or ``swept``: first order, with the volumes swept by the faces."""
PAST = {"none": 0, "first": 1, "second": 2, "swept": 2}
"""Number of earlier levels that each order needs."""
SWEPT, FLUX = "SweptVolume", "VolumeFlux"
"""Names of the fields at the faces."""
_TOGETHER = 1 << 13
"""Nodes whose faces are measured at a time, which bounds the memory."""
FACES = ("iface", "jface", "kface")
"""Locations of fields at the faces across each index axis."""

_JUMP, _JUMP_IN_EDGES = 0.5, 0.2
"""The grid jumps where its acceleration exceeds that of the walls by JUMP wall steps, and JUMP_IN_EDGES local edges."""

_AT_REST = 0.01
"""A step of the walls smaller than this fraction of the other one says little about how nodes follow."""
# Nodes per chunk, as a copy of the whole grid might not fit into memory.
_ROWS = 1 << 16

Faces = tuple[FloatArray, ...]
"""Values at the faces of a block across the index axes i, j, k: (ni, nj - 1, nk - 1), (ni - 1, nj, nk - 1) and
(ni - 1, nj - 1, nk); in a 2-D block one axis has a single node, and no faces across it: an empty array."""


def grid_velocity(times: Sequence[float], points: Sequence[FloatArray], order: str) -> FloatArray:
    """Velocity (n_nodes, 3) at the last of ``times`` by backward differences over levels of any spacing.

    ``second`` order falls back to first at the second level; at the first one, which has no past, the velocity is zero.
    Differences of first order are the velocity halfway between two levels, to second order. ``points`` are the
    coordinates at the last levels, the newest last.
    """
    velocity: FloatArray = Nodes.of(points[-1]).like(3)
    own = Nodes.of(velocity).rows
    known = min(len(times), len(points), 3 if order == "second" else 2)
    rates = _rates(times[-known:])

    def fill(rows: slice) -> None:
        own[rows] = 0.0
        for rate, one, other in zip(rates, points[-1:-known:-1], points[-2::-1], strict=False):
            own[rows] += rate * (one[rows] - other[rows])

    Nodes.of(velocity).each(fill)
    return velocity


def _rates(times: Sequence[float]) -> list[float]:
    """Factors of the differences between successive levels in the rate at the newest of two or three ``times``.

    With three levels, it is the derivative of the parabola through them.
    """
    steps = np.diff(times)[::-1].tolist()
    if len(steps) < 2:
        return [1.0 / step for step in steps]
    share = steps[0] / (steps[0] + steps[1])
    return [(1.0 + share) / steps[0], -share / steps[1]]


def swept_volumes(grid: Grid, before: FloatArray, after: FloatArray) -> list[Faces]:
    """Volumes (2-D: areas) that the faces of every block sweep from ``before`` to ``after``, both (n_nodes, 3).

    Positive where a face moves towards the larger index. The volume of a cell, positive where it is valid, changes by
    the sum over its faces, those at the far end added and those at the near end subtracted: exactly for straight paths
    of the nodes, up to round-off.

    ``grid`` is the undeformed grid, which provides the blocks and their handedness. Of a grid in parts every rank gets
    the faces of its part; all ranks must call this.
    """
    normal, handedness = plane_normal(grid), block_handedness(grid)
    for points in (before, after):
        grid.hold_neighbours(points)
    one, two = Nodes.of(before).rows, Nodes.of(after).rows
    faces = _at_faces(grid, empty)

    def work(index: int, _: int) -> None:
        block, axis = divmod(index, 3)
        shape, out = grid.shapes[block], faces[block][axis]
        if not out.size:
            return
        size, others = shape[1] * shape[2], [other for other in ((axis + 1) % 3, (axis + 2) % 3) if shape[other] > 1]
        sign, begin = float(handedness[block]), int(grid.offsets[block]) + grid.planes(block).start * size
        thin = 3 - axis - others[0]
        side = positive_side(thin == 1, sign if normal is None or others[0] < axis else -sign, normal)
        step = max(1, _TOGETHER // size)
        for lo in range(0, len(out), step):
            # Faces along i also need the next plane. By components, as numpy is slow on axes of length 3.
            rows = slice(begin + lo * size, begin + min(lo + step, len(out)) * size + (size if 0 in others else 0))
            x, y = (np.moveaxis(p[rows].reshape(-1, *shape[1:], 3), -1, 0).copy() for p in (one, two))
            out[lo : lo + step] = _swept(x, y, others, side)

    for_chunks(work, 3 * grid.n_blocks, 1)
    return faces


def _swept(before: FloatArray, after: FloatArray, axes: Sequence[int], side: Any) -> FloatArray:
    """Volumes swept by faces between nodes (3, ni, nj, nk) that extend along two index ``axes``, or in 2-D along one;
    ``side`` is the sign of the volume, in 2-D the normal along which areas are seen.

    The nodes of a face before and after span a trilinear hexahedron, whose volume is computed exactly (Grandy 1997).
    """

    def corners_of_faces(x: FloatArray) -> list[FloatArray]:
        found = [x]
        for axis in axes:
            ends = [(*[slice(None)] * (axis + 1), end) for end in (slice(-1), slice(1, None))]
            found = [part[end] for part in found for end in ends]
        return found

    if len(axes) == 1:
        (a0, b0), (a1, b1) = corners_of_faces(before), corners_of_faces(after)
        return 0.5 * dot(side, cross(b1 - a0, a1 - b0))
    (a0, b0, c0, d0), (a1, b1, c1, d1) = corners_of_faces(before), corners_of_faces(after)
    # Diagonals of the hexahedron and of its faces, towards its last corner and from its first one.
    a, b, c, d, e, f = d1 - c0, d1 - b0, d1 - a1, b1 - a0, c1 - a0, d0 - a0
    return np.asarray(side / 12.0 * (dot(cross(a + d, b), f) + dot(cross(d, b + e), c) + dot(cross(a, e), c + f)))


def volume_flux(times: Sequence[float], swept: Sequence[list[Faces]]) -> list[Faces]:
    """Volume per time (2-D: area) that the faces sweep at the last of ``times``, by differences of second order.

    Together with backward differences of volumes over the same levels it keeps a uniform flow uniform: the rate of
    change of a cell's volume is the sum over its faces. ``swept`` are the volumes of the last one or two intervals, the
    newest last; with one it is of first order.
    """
    rates = _rates(times[-len(swept) - 1 :])

    def flux(*parts: FloatArray) -> FloatArray:
        return np.asarray(sum(rate * part for rate, part in zip(rates, parts[::-1], strict=True)))

    return [tuple(map(flux, *of_block)) for of_block in zip(*swept, strict=True)]


def face_fields(grid: Grid, times: Sequence[float], points: Sequence[FloatArray]) -> tuple[Field, ...]:
    """Fields ``SweptVolume`` and ``VolumeFlux`` at the faces of the last level; zero at the first one.

    ``times`` and ``points`` are those of the last levels, at most three, the newest last.
    """
    parts = [swept_volumes(grid, one, other) for one, other in itertools.pairwise(points)]
    swept, flux = (parts[-1], volume_flux(times, parts)) if parts else 2 * (_at_faces(grid, np.zeros),)
    return tuple(
        Field(name, FACES[axis], block, grid.spread(part, _face_shape(shape, axis)[0]))
        for name, values in ((SWEPT, swept), (FLUX, flux))
        for block, (shape, faces) in enumerate(zip(grid.shapes, values, strict=True))
        for axis, part in enumerate(faces)
        if shape[axis] > 1
    )


def _at_faces(grid: Grid, make: Callable[[tuple[int, int, int]], FloatArray]) -> list[Faces]:
    """What ``make`` makes of the shapes of the faces of every block; of a grid in parts, of those of this rank."""
    return [
        tuple(make(grid.own_shape(block, _face_shape(shape, axis))) for axis in range(3))
        for block, shape in enumerate(grid.shapes)
    ]


def _face_shape(shape: tuple[int, int, int], axis: int) -> tuple[int, int, int]:
    i, j, k = (n if a == axis else max(n - 1, 1) for a, n in enumerate(shape))
    return (i, j, k) if shape[axis] > 1 else (0, 0, 0)


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
