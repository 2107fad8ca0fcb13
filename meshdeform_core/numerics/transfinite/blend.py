"""Transfinite interpolation of displacements with arc-length coordinates (Sen et al. eqs. 1, 3-10).

Blocks are cut at index planes into sub-blocks whose faces are known; each interior is blended from its six faces. The
coordinates and the table ``subs`` of sub-blocks are those of :mod:`.arcs`.
"""

from __future__ import annotations

import numpy as np
from llvmlite import ir

from ..jit import fast_kernel
from ..lanes import Array, Lanes, components, lanes
from .arcs import TILE, padded, tile_start

# Number of neighbouring k lines that are filled together, so that the data they share stay in the cache.
_LINES = 64

# Rows of work arrays, three components each: coefficients of 1, y, x, x y.
_ONE, _BY_Y, _BY_X, _BY_XY, _ROWS = 0, 3, 6, 9, 12


@fast_kernel("f8[:, ::1], f8[::1], i8[:, ::1], i8[:, ::1]")
def blend_slabs(d, arc, subs, slabs):
    """Fill planes of the interior of sub-blocks from their faces, in place (eqs. 1, 3-9).

    With G the blending of the i and j faces at the node's arc coordinates x, y, z, the displacement is
    ``G + (1 - z) (d - G)(k low) + z (d - G)(k high)``. G is bilinear in x and y. Its coefficients along a k line follow
    from the i faces and are the same in all i planes; the j faces contribute to those of 1 and y. ``d`` (n_nodes, 3) of
    all blocks is known on the faces of the sub-blocks, ``arc`` are the coordinates, see :func:`.arcs.arc_numbers`, and
    room for a tile, ``slabs`` (m, 3) rows in ``subs`` with planes i0 <= i < i1 of the block.
    """
    # Of the coefficients along lines those at their low ends are left out, whose differences from those at the high
    # ends are ``slopes``.
    lines, slopes = np.empty(_LINES * _ROWS * TILE), np.empty((_LINES, _ROWS))
    sides, filled, low, ends = np.empty(_BY_X * TILE), np.empty(3 * TILE), np.empty(_ROWS), np.empty(15)
    for n in range(slabs.shape[0]):
        sub = subs[slabs[n, 0]]
        si, sj = sub[2] * sub[3], sub[3]
        corner = sub[0] + sub[4] * si + sub[5] * sj + sub[6]
        nj, nk = sub[8] - sub[5] - 1, sub[9] - sub[6] - 1
        up, end, high = (sub[7] - sub[4]) * si, (nj + 1) * sj, nk + 1
        for k0 in range(0, nk, TILE):
            count, width = min(TILE, nk - k0), padded(min(TILE, nk - k0))
            for j0 in range(0, nj, _LINES):
                j1 = min(j0 + _LINES, nj)
                for j in range(j0, j1):
                    row = corner + (j + 1) * sj
                    for at_end in range(2):
                        for c in range(3):
                            # At an end of the line, as in start_line.
                            node, first = row + at_end * high, corner + at_end * high
                            one, other = d[node, c] - d[first, c], d[node + up, c] - d[first + up, c]
                            along = d[first + end, c] - d[first, c]
                            across = d[first + end + up, c] - d[first + up, c]
                            slopes[j - j0, _ONE + c] = low[_ONE + c] - one
                            slopes[j - j0, _BY_Y + c] = low[_BY_Y + c] + along
                            slopes[j - j0, _BY_X + c] = low[_BY_X + c] - (other - one)
                            slopes[j - j0, _BY_XY + c] = low[_BY_XY + c] - (along - across)
                            if at_end == 0:
                                low[_ONE + c], low[_BY_Y + c] = one, -along
                                low[_BY_X + c], low[_BY_XY + c] = other - one, along - across
                    node, first = 3 * (row + k0 + 1), 3 * (corner + k0 + 1)
                    start_line(d, node, first, 3 * end, 3 * up, 3 * count, low, lines, (j - j0) * _ROWS * TILE)
                for i in range(slabs[n, 1] - sub[4], slabs[n, 2] - sub[4]):
                    plane, start = corner + i * si, sub[10] + tile_start(i - 1, j0, k0, nj, nk)
                    start_sides(d, 3 * plane, 3 * (k0 + 1), 3 * end, 3 * count, sides)
                    for j in range(j0, j1):
                        row = plane + (j + 1) * sj
                        for c in range(3):
                            # What the ends contribute to the coefficient of 1, and to those of z, y z, x z and x y z.
                            one, other = d[row, c] - d[plane, c], d[row + high, c] - d[plane + high, c]
                            by_yz = d[plane + high, c] - d[plane + end + high, c] - d[plane, c] + d[plane + end, c]
                            ends[5 * c], ends[5 * c + 1] = one, other - one + slopes[j - j0, _ONE + c]
                            ends[5 * c + 2] = by_yz + slopes[j - j0, _BY_Y + c]
                            ends[5 * c + 3], ends[5 * c + 4] = slopes[j - j0, _BY_X + c], slopes[j - j0, _BY_XY + c]
                        at = start + 3 * width * (j - j0)
                        fill_line(arc, at, width, lines, (j - j0) * _ROWS * TILE, sides, ends, filled)
                        # Masked vector stores would take longer than the rest on some processors.
                        out = d[row + k0 + 1 :]
                        for k in range(count):
                            out[k, 0], out[k, 1], out[k, 2] = filled[k], filled[TILE + k], filled[2 * TILE + k]


def _components_of(d: Array, at: ir.Value, count: ir.Value) -> list[Lanes]:
    """Components of at most sixteen displacements, ``count`` numbers; the others are zero."""
    return components(d.load_some_points(at, count))


@lanes
def start_line(
    d: Array, node: ir.Value, corner: ir.Value, end: ir.Value, up: ir.Value, count: ir.Value, low: Array, lines: Array,
    line: ir.Value,
) -> None:  # fmt: skip
    """Coefficients along a line minus those at its low end; arguments as of the loops, in numbers instead of nodes."""
    add = d.builder.add
    here, there = _components_of(d, node, count), _components_of(d, add(node, up), count)
    first, last = (_components_of(d, add(corner, step), count) for step in (up.type(0), end))
    above, beyond = (_components_of(d, add(corner, step), count) for step in (up, add(end, up)))
    zero = node.type(0)
    for c in range(3):
        one, other = here[c] - first[c], there[c] - above[c]
        along, across = last[c] - first[c], beyond[c] - above[c]
        for row, value in ((_ONE, one), (_BY_Y, first[c] - last[c]), (_BY_X, other - one), (_BY_XY, along - across)):
            lines.store(line, value - low.every(zero, row + c), (row + c) * TILE)


@lanes
def start_sides(d: Array, plane: ir.Value, at: ir.Value, end: ir.Value, count: ir.Value, sides: Array) -> None:
    """Contributions of the two j sides of an i plane to the coefficients of 1 and y."""
    add, zero = d.builder.add, at.type(0)
    low = _components_of(d, add(plane, at), count)
    high = _components_of(d, add(add(plane, at), end), count)
    for c in range(3):
        edge = d.every(plane, c) - d.every(add(plane, end), c)
        sides.store(zero, low[c], (_ONE + c) * TILE)
        sides.store(zero, high[c] - low[c] + edge, (_BY_Y + c) * TILE)


@lanes
def fill_line(
    arc: Array, at: ir.Value, width: ir.Value, lines: Array, line: ir.Value, sides: Array, ends: Array, filled: Array
) -> None:
    """Displacements of sixteen nodes of a line by components; those beyond its end are not used."""
    add, zero = arc.builder.add, at.type(0)
    x, y, z = (arc.load(start) for start in (at, add(at, width), add(add(at, width), width)))
    for c in range(3):
        one, by_z, by_yz, by_xz, by_xyz = (ends.every(zero, 5 * c + n) for n in range(5))
        p, q, r, s = (lines.load(line, (row + c) * TILE) for row in (_ONE, _BY_Y, _BY_X, _BY_XY))
        p = p + sides.load(zero, (_ONE + c) * TILE) + one + z * by_z
        q = q + sides.load(zero, (_BY_Y + c) * TILE) + z * by_yz
        filled.store(zero, p + y * q + x * (r + z * by_xz + y * (s + z * by_xyz)), c * TILE)
