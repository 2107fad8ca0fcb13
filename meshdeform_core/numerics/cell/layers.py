"""Breadth-first search over the nodes of block-structured grids; cells that touch given nodes."""

import numpy as np

from ..jit import kernel


@kernel
def layers_from(seeds, layers, shapes, offsets, classes, start, copies):
    """Distance (n_nodes,) int16 of every block node from ``seeds``, in cells; -1 where it exceeds ``layers``.

    Parameters
    ----------
    seeds : (s,) block nodes
    shapes, offsets : (n_blocks, 3), (n_blocks + 1,) of the blocks
    classes : (n_nodes,) number of the class of coincident nodes that a node belongs to, or -1
    start, copies : the nodes of class c are ``copies[start[c] : start[c + 1]]``
    """
    reached = np.full(classes.size, -1, dtype=np.int16)
    queue = np.empty(1 << 12, dtype=np.int64)
    # int64, not plain zeros: numba would compile ``_visit`` a second time for literals.
    count, nearest = np.int64(0), np.int64(0)
    for node in seeds:
        queue, count = _visit(node, nearest, reached, queue, count, classes, start, copies)
    first = 0
    for layer in range(layers):
        last = count
        for at in range(first, last):
            node = queue[at]
            block = np.searchsorted(offsets, node, side="right") - 1
            nj, nk = shapes[block, 1], shapes[block, 2]
            i, j, k = (
                (node - offsets[block]) // (nj * nk),
                (node - offsets[block]) // nk % nj,
                (node - offsets[block]) % nk,
            )
            for di in range(-1 if i else 0, 2 if i + 1 < shapes[block, 0] else 1):
                for dj in range(-1 if j else 0, 2 if j + 1 < nj else 1):
                    for dk in range(-1 if k else 0, 2 if k + 1 < nk else 1):
                        other = node + (di * nj + dj) * nk + dk
                        if reached[other] < 0:
                            queue, count = _visit(other, layer + 1, reached, queue, count, classes, start, copies)
        first = last
        if first == count:
            break
    return reached


@kernel
def _visit(node, layer, reached, queue, count, classes, start, copies):
    """Append a node that was not reached yet, and all nodes of its class, to the queue."""
    if reached[node] >= 0:
        return queue, count
    one = classes[node]
    size = 1 if one < 0 else start[one + 1] - start[one]
    if count + size > queue.size:
        longer = np.empty(2 * queue.size + size, dtype=np.int64)
        longer[:count] = queue[:count]
        queue = longer
    if one < 0:
        queue[count] = node
        reached[node] = layer
    else:
        for n in range(size):
            queue[count + n] = copies[start[one] + n]
            reached[queue[count + n]] = layer
    return queue, count + size


@kernel
def cells_at(nodes, shapes, offsets, n_cells):
    """Numbers of all cells that touch one of the block ``nodes``, ascending; a flat axis has one layer of cells."""
    touched = np.zeros(n_cells, dtype=np.bool_)
    starts = np.zeros(offsets.size, dtype=np.int64)
    for b in range(offsets.size - 1):
        size = 1
        for axis in range(3):
            size *= max(shapes[b, axis] - 1, 1)
        starts[b + 1] = starts[b] + size
    for node in nodes:
        b = np.searchsorted(offsets, node, side="right") - 1
        nj, nk = shapes[b, 1], shapes[b, 2]
        ci, cj, ck = max(shapes[b, 0] - 1, 1), max(nj - 1, 1), max(nk - 1, 1)
        i, j, k = (node - offsets[b]) // (nj * nk), (node - offsets[b]) // nk % nj, (node - offsets[b]) % nk
        for ii in range(max(i - 1, 0), min(i + 1, ci)):
            for jj in range(max(j - 1, 0), min(j + 1, cj)):
                for kk in range(max(k - 1, 0), min(k + 1, ck)):
                    touched[starts[b] + (ii * cj + jj) * ck + kk] = True
    return np.flatnonzero(touched)
