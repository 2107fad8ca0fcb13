"""The nodes near block faces, and values kept for them, found by arithmetic instead of a search table.

Block b has rows from ``offsets[b]`` on and ``shapes[b]`` nodes; ``inside[b]`` (3, 2) are the first and one past the
last index, along each direction, of its nodes that are not near, and ``start[b]`` near nodes come before its own.
"""

from .jit import kernel


@kernel("i8[:, ::1], i8[::1], i8[:, :, ::1], i8[::1]")
def near_rows(shapes, offsets, inside, out):
    """The rows (n,) of all nodes near block faces, ascending."""
    n = 0
    for b in range(shapes.shape[0]):
        row, box = offsets[b], inside[b]
        for i in range(shapes[b, 0]):
            for j in range(shapes[b, 1]):
                through = box[0, 0] <= i < box[0, 1] and box[1, 0] <= j < box[1, 1]
                # Across the middle of a block, a line is near at its ends only.
                low, high = (box[2, 0], box[2, 1]) if through else (0, 0)
                for k in range(low):
                    out[n + k] = row + k
                for k in range(high, shapes[b, 2]):
                    out[n + low + k - high] = row + k
                n += low + shapes[b, 2] - high
                row += shapes[b, 2]


@kernel("i8[::1], i8[:, ::1], i8[::1], i8[:, :, ::1], i8[::1], f8[:, ::1], f8[:, ::1]")
def near_values(rows, shapes, offsets, inside, start, values, out):
    """Store the ``values`` (m, 3), kept for all near rows, of each row (n,); return False if any is not near."""
    block = 0
    for r in range(rows.size):
        row = rows[r]
        if row < offsets[block] or row >= offsets[block + 1]:
            block, last = 0, shapes.shape[0] - 1
            while block < last:
                middle = (block + last + 1) // 2
                if offsets[middle] <= row:
                    block = middle
                else:
                    last = middle - 1
        local = row - offsets[block]
        nj, nk = shapes[block, 1], shapes[block, 2]
        line = local // nk
        place = _place(inside[block], line // nj, line % nj, local - line * nk, local)
        if place < 0:
            return False
        for c in range(3):
            out[r, c] = values[start[block] + place, c]
    return True


@kernel
def _place(inside, i, j, k, local):
    """Position of node i, j, k, the ``local``-th of its block, among the block's near nodes; -1 if it is not near."""
    low, high = inside[0, 0], inside[0, 1]
    lines, depth = inside[1, 1] - inside[1, 0], inside[2, 1] - inside[2, 0]
    local -= (min(max(i, low), high) - low) * lines * depth
    if low <= i < high:
        low, high = inside[1, 0], inside[1, 1]
        local -= (min(max(j, low), high) - low) * depth
        if low <= j < high:
            low, high = inside[2, 0], inside[2, 1]
            local -= min(max(k, low), high) - low
            if low <= k < high:
                return -1
    return local
