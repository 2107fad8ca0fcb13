"""Plane grids in OpenFOAM's form: one layer of cells between two sides of type ``empty``."""

from __future__ import annotations

import dataclasses

import numpy as np

from meshdeform_core.grid import Connection, FloatArray, Grid, Shape, Side, Window
from meshdeform_core.grid.planes import plane_normal
from meshdeform_core.grid.sides import end_planes
from meshdeform_core.grid.topology import Topology, side_nodes

_ALONG_AXIS = 1e-6
"""Deviation of the direction across the layer from an axis, relative to the thickness."""


def extruded(grid: Grid, thickness: float) -> Grid:
    """A 2-D grid as one layer of cells of this thickness along the normal of its plane; 3-D grids are unchanged."""
    normal = plane_normal(grid)
    if normal is None:
        return grid
    flat = [shape.index(1) for shape in grid.shapes]
    blocks = [extruded_points(grid.block(b), axis, normal, thickness) for b, axis in enumerate(flat)]
    patches = tuple(
        dataclasses.replace(patch, windows=tuple(_widened(w, flat[w.block]) for w in patch.windows))
        for patch in grid.patches
    )
    connections = tuple(_widened_connection(c, flat[c.block], flat[c.donor_block]) for c in grid.connections)
    return Grid.from_blocks(
        blocks, grid.names, patches=patches, connections=connections, format=grid.format, path=grid.path
    )


def extruded_points(block: FloatArray, axis: int, normal: FloatArray, thickness: float) -> FloatArray:
    """The nodes of a block (ni, nj, nk, 3) that is one plane, and the same shifted along ``normal``."""
    return np.concatenate([block, block + thickness * normal], axis=axis)


def _widened(window: Window, flat: int) -> Window:
    a, b = window.side.tangential
    high = (1 if a == flat else window.high[0], 1 if b == flat else window.high[1])
    return dataclasses.replace(window, high=high)


def _widened_connection(connection: Connection, flat: int, donor: int) -> Connection:
    transform = list(connection.transform)
    transform[flat] = donor + 1
    return dataclasses.replace(
        connection,
        end=_at(connection.end, flat),
        donor_end=_at(connection.donor_end, donor),
        transform=(transform[0], transform[1], transform[2]),
    )


def _at(index: Shape, axis: int) -> Shape:
    i, j, k = (1 if a == axis else n for a, n in enumerate(index))
    return i, j, k


def empty_sides(grid: Grid, topology: Topology) -> list[int]:
    """The block sides (``6 * block + side``) on both sides of one layer of cells across an axis of coordinates.

    Empty if the grid is not such a layer: OpenFOAM solves in a plane only where it is normal to an axis.
    """
    ends = end_planes(grid, topology)
    if not ends:
        return []
    sides = [grid.points[side_nodes(grid, end // 6, Side(end % 6)).ravel()] for end in ends]
    across = np.concatenate([far - near for near, far in zip(sides[::2], sides[1::2], strict=True)])
    axis = int(np.argmax(np.abs(across).sum(axis=0)))
    uneven = [float(np.abs(np.delete(across, axis, axis=1)).max()), *(float(np.ptp(x[:, axis])) for x in sides)]
    return ends if max(uneven) <= _ALONG_AXIS * float(np.abs(across[:, axis]).min()) else []
