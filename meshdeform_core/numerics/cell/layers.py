"""Breadth-first search over the nodes of block-structured grids."""

from ..jit import kernel


@kernel("i2[::1], i8, i8[:, ::1], i8[:, ::1], i8[::1], i8[::1], i8[::1], i8[::1], i2[::1]")
def spread_layers(layers, most, planes, shapes, offsets, nodes, ends, classes, nearest):
    """Lower ``layers``, distances in cells, until every node is at most one farther than its neighbours; returns how
    often one was lowered.

    Within a block two passes suffice, one in each direction, as the nodes of a box are connected by straight ways.

    Parameters
    ----------
    layers : (n_nodes,) int16, more than ``most`` where a node is farther away or not yet reached
    planes : (n_blocks, 2) the planes first <= i < last of each block to look at
    shapes, offsets : (n_blocks, 3), (n_blocks + 1,) of the blocks
    nodes, ends, classes : (n_face,) block nodes on block faces, ascending, those of block b from ``ends[b]`` to
        ``ends[b + 1]``, and the number of the set of nodes that count as one
    nearest : (n_classes,) int16, the smallest distance of each set
    """
    lowered, again, first = 0, True, True
    while again:
        again = False
        for b in range(len(shapes)):
            low, high = planes[b, 0], planes[b, 1]
            if low >= high:
                continue
            size = shapes[b, 1] * shapes[b, 2]
            start, stop = offsets[b] + low * size, offsets[b] + high * size
            touched = first
            for n in range(ends[b], ends[b + 1]):
                if start <= nodes[n] < stop and nearest[classes[n]] < layers[nodes[n]]:
                    layers[nodes[n]] = nearest[classes[n]]
                    lowered += 1
                    touched = True
            if not touched:
                continue
            for way in (1, -1):
                lowered += _pass(layers, start, high - low, shapes[b, 1], shapes[b, 2], way, most)
            for n in range(ends[b], ends[b + 1]):
                if start <= nodes[n] < stop and layers[nodes[n]] < nearest[classes[n]]:
                    nearest[classes[n]] = layers[nodes[n]]
                    again = True
        first = False
    return lowered


@kernel
def _pass(layers, start, ni, nj, nk, way, most):
    """Lower the nodes of a box, from its first or, with ``way`` -1, from its last on, to one more than the neighbours
    that come before; returns how often."""
    lowered = 0
    for i in range(ni) if way > 0 else range(ni - 1, -1, -1):
        for j in range(nj) if way > 0 else range(nj - 1, -1, -1):
            for k in range(nk) if way > 0 else range(nk - 1, -1, -1):
                n = start + (i * nj + j) * nk + k
                near = here = layers[n]
                # The first thirteen of the 27 nodes around.
                for neighbour in range(13):
                    p = i + way * (neighbour // 9 - 1)
                    q = j + way * (neighbour // 3 % 3 - 1)
                    r = k + way * (neighbour % 3 - 1)
                    if 0 <= p < ni and 0 <= q < nj and 0 <= r < nk:
                        other = layers[start + (p * nj + q) * nk + r] + 1
                        if other < near:
                            near = other
                if near < here and near <= most:
                    layers[n] = near
                    lowered += 1
    return lowered
