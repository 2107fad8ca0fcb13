"""Breadth-first search over the nodes of block-structured grids."""

from ..jit import inlined, kernel


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
            box = layers[start:stop].reshape(high - low, shapes[b, 1], shapes[b, 2])
            lowered += _pass(box, most)
            lowered += _pass(box[::-1, ::-1, ::-1], most)
            for n in range(ends[b], ends[b + 1]):
                if start <= nodes[n] < stop and layers[nodes[n]] < nearest[classes[n]]:
                    nearest[classes[n]] = layers[nodes[n]]
                    again = True
        first = False
    return lowered


@inlined
def _pass(box, most):
    """Lower ``box`` (ni, nj, nk) to one more than the neighbours that come before; returns how often."""
    ni, nj, nk = box.shape
    lowered = 0
    for i in range(ni):
        for j in range(nj):
            for k in range(nk):
                near = box[i, j, k]
                for p in range(max(i - 1, 0), i + 1):
                    for q in range(max(j - 1, 0), min(j + 2, nj) if p < i else j + 1):
                        for r in range(max(k - 1, 0), min(k + 2, nk) if p < i or q < j else k):
                            near = min(near, box[p, q, r] + 1)
                if near < box[i, j, k] and near <= most:
                    box[i, j, k] = near
                    lowered += 1
    return lowered
