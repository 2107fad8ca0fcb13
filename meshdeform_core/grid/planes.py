"""Planes of 2-D grids and of slip and symmetry boundaries; the extent and handedness of blocks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import GridError
from ..numerics.arrays import batches, extent, spread
from ..numerics.geometry.coincidence import ascending
from ..parallel import for_items
from ..wording import vector
from .blocks import FloatArray, Grid, IntArray
from .parts import strides_of

_SMALLEST, _FLAT = 1e-100, 1e-14
_SAMPLE, _TOGETHER = 100_000, 100_000
_SAMPLED_CELLS = 8
FLATNESS = 1e-6
"""Nodes that deviate from their mean plane by less than this fraction of their extent lie in a plane."""


@dataclass(frozen=True)
class Plane:
    """A plane through ``point`` with unit ``normal``; normals along an axis are exact unit vectors."""

    point: FloatArray
    normal: FloatArray


def plane_of(points: FloatArray, plane_normal: FloatArray | None) -> Plane | None:
    """The plane that contains all ``points`` (n, 3), or ``None`` if there is none.

    In a 2-D grid (``plane_normal`` given) the "plane" is the straight line through the points.
    """
    return planes_of(points[None], plane_normal)[0]


def planes_of(points: FloatArray, plane_normal: FloatArray | None) -> list[Plane | None]:
    """:func:`plane_of` for each of several sets of equally many points (m, n, 3)."""
    center = points.mean(axis=1)
    arms = points - center[:, None]
    size = np.abs(arms).max(axis=(1, 2), initial=0.0)
    found: list[Plane | None] = [None] * len(points)
    some = np.flatnonzero(size)
    # Principal directions, the longest extent first.
    axes = np.asarray(np.linalg.svd(arms[some], full_matrices=False)[2])
    normal = axes[:, -1] if plane_normal is None else np.cross(plane_normal, axes[:, 0])
    normal = snapped(normal / np.linalg.norm(normal, axis=1, keepdims=True))
    flat = np.abs((arms[some] @ normal[..., None])[..., 0]).max(axis=1, initial=0.0) <= FLATNESS * size[some]
    for number, one in zip(some[flat].tolist(), normal[flat], strict=True):
        found[number] = Plane(center[number], one)
    return found


def snapped(normal: FloatArray) -> FloatArray:
    """Unit normals (m, 3) with a positive largest component; those along an axis up to round-off become exact."""
    unit = np.eye(3)[np.argmax(np.abs(normal), axis=1)]
    positive = normal * np.sign((normal * unit).sum(axis=1, keepdims=True))
    near = np.linalg.norm(positive - unit, axis=1) < FLATNESS
    return np.asarray(np.where(near[:, None], unit, positive))


def plane_normal(grid: Grid) -> FloatArray | None:
    """Unit normal of the plane of a 2-D grid, ``None`` for a 3-D grid. Raises GridError when a 2-D grid is not flat."""
    if grid.dimension == 3:
        return None
    low, high = extent(grid.points)
    constant = np.flatnonzero(low == high)
    if constant.size == 1:
        # Nearly all 2-D grids: the singular value decomposition of all nodes takes much longer.
        return np.asarray(np.eye(3)[constant[0]])
    plane = plane_of(grid.points, None)
    if plane is None:
        raise GridError("the grid is one layer of nodes but not a plane; surface grids cannot be deformed")
    return plane.normal


def plane_axes(normal: FloatArray) -> FloatArray:
    """Two unit vectors (2, 3) that form a right-handed frame with the unit ``normal``; exact if it is an axis."""
    axis = int(np.argmax(np.abs(normal)))
    near = np.zeros(3)
    near[(axis + 1) % 3] = 1.0
    one = near - (near @ normal) * normal
    one /= np.linalg.norm(one)
    return np.stack([one, np.cross(normal, one)])


def block_extents(grid: Grid) -> tuple[FloatArray, FloatArray]:
    """Smallest and largest coordinates (n_blocks, 3) of every block."""
    low, high = np.full((grid.n_blocks, 3), np.inf), np.full((grid.n_blocks, 3), -np.inf)
    ends = np.clip(grid.offsets, *grid.nodes.ends)
    together = batches(np.diff(ends), _TOGETHER)

    def find(number: int) -> None:
        first, last = together[number]
        rows, held = grid.points[ends[first] : ends[last]], first + np.flatnonzero(np.diff(ends[first : last + 1]))
        if len(held) == 1:
            low[held[0]], high[held[0]] = extent(rows)
        elif held.size:
            low[held] = np.minimum.reduceat(rows, ends[held] - ends[first], axis=0)
            high[held] = np.maximum.reduceat(rows, ends[held] - ends[first], axis=0)

    for_items(find, len(together))
    lows, highs = zip(*grid.nodes.gather((low, high)), strict=True)
    return np.min(lows, axis=0), np.max(highs, axis=0)


def block_handedness(grid: Grid) -> IntArray:
    """+1 or -1 per block, from the majority of a regular sample of at most 8 cells per direction."""
    shapes = np.array(grid.shapes, dtype=np.int64)
    taken = np.clip(shapes - 1, 1, _SAMPLED_CELLS)
    # Blocks of the same kind together.
    kind = np.ravel_multi_index((*taken.T, *(shapes == 1).T.astype(int)), (_SAMPLED_CELLS + 1,) * 3 + (2,) * 3)
    sign = np.empty(grid.n_blocks, dtype=np.int64)
    for one in ascending(kind):
        alike = np.flatnonzero(kind == one)
        for lo, hi in batches(np.full(len(alike), 8 * taken[alike[0]].prod()), _TOGETHER):
            sign[alike[lo:hi]] = _handedness(grid, alike[lo:hi])
    return sign


def _handedness(grid: Grid, blocks: IntArray) -> IntArray:
    """Handedness of ``blocks`` with the same number of sampled cells and, in 2-D, the same axis of one node."""
    shapes = np.array([grid.shapes[block] for block in blocks])
    axes = [axis for axis in range(3) if shapes[0, axis] > 1]
    # Mean edge vectors (n_blocks, n_cells, 3) of every sampled cell along each of the ``axes``.
    strides = strides_of(shapes)
    first = grid.offsets[blocks][:, None]
    for axis in range(3):
        picks = spread(np.maximum(shapes[:, axis] - 1, 1), _SAMPLED_CELLS)[1].reshape(len(blocks), -1)
        first = (first[..., None] + (picks * strides[:, axis, None])[:, None]).reshape(len(blocks), -1)
    corners = np.empty((*(2,) * len(axes), *first.shape, 3))
    for corner in np.ndindex(*(2,) * len(axes)):
        corners[corner] = grid.nodes.at(first + (strides[:, axes] @ np.array(corner))[:, None])
    others = [tuple(a for a in range(len(axes)) if a != own) for own in range(len(axes))]
    means = [corners.mean(axis=other) for other in others]
    edges = [mean[1] - mean[0] for mean in means]
    if len(axes) == 3:
        volume = np.einsum("...i,...i->...", edges[0], np.cross(edges[1], edges[2]))
        return np.where(np.sign(volume).sum(axis=1) < 0, -1, 1)
    # A 2-D block is treated as one layer of cells extruded along +x, +y or +z, whichever is normal to its plane.
    normal = np.cross(edges[0], edges[1])
    main = np.argmax(np.abs(normal).sum(axis=1), axis=1)
    total = np.sign(np.take_along_axis(normal, main[:, None, None], axis=2)).sum(axis=(1, 2))
    # Index order (a, b) is cyclic for a flat i or k axis and reversed for a flat j axis.
    return np.where((total < 0) != (axes[1] - axes[0] == 2), -1, 1)


def require_extent(grid: Grid) -> None:
    """Refuse a grid whose nodes are all at one point, on one line or, in 3-D, in one plane. Raises GridError stating
    the extent of the nodes."""
    some = grid.sample(_SAMPLE)
    low, high = extent(grid.points)
    size = float((high - low).max())
    if not size > _SMALLEST:
        raise GridError(f"all nodes lie within {size:.3g} of {vector(low)}; expected a grid with a larger extent")
    spread = np.linalg.svd((some - 0.5 * (low + high)) / size, compute_uv=False)
    rank = int((spread > _FLAT * spread[0]).sum())
    if rank < grid.dimension:
        shape = {1: "on a line", 2: "in a plane"}[rank]
        raise GridError(f"all nodes of the {grid.dimension}-D grid lie {shape}; expected cells with a volume")
