"""Velocities of a moving grid: of its nodes, and of its faces such that they satisfy the geometric conservation law."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from .grid import Field, FloatArray, Grid
from .grid.planes import block_handedness, plane_normal
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

Faces = tuple[FloatArray, ...]
"""Values at the faces of a block across the index axes i, j, k: (ni, nj - 1, nk - 1), (ni - 1, nj, nk - 1) and
(ni - 1, nj - 1, nk); in a 2-D block one axis has a single node, and no faces across it: an empty array."""


def grid_velocity(times: Sequence[float], points: Sequence[FloatArray], order: str) -> FloatArray:
    """Velocity (n_nodes, 3) at the last of ``times`` by backward differences over levels of any spacing.

    ``second`` order falls back to first at the second level; at the first one, which has no past, the velocity is zero.
    Differences of first order are the velocity halfway between two levels, to second order.

    Parameters
    ----------
    points : coordinates at the last levels, the newest last
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
    change of a cell's volume is the sum over its faces. With a single interval it is of first order.

    Parameters
    ----------
    swept : volumes swept in the last one or two intervals, the newest last
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
