"""Breadth-first search over the nodes of block-structured grids."""

from __future__ import annotations

import numpy as np

from ..arrays import IntArray


def spread_layers(
    layers: np.ndarray,
    most: int,
    planes: IntArray,
    shapes: IntArray,
    offsets: IntArray,
    nodes: IntArray,
    ends: IntArray,
    classes: IntArray,
    nearest: np.ndarray,
) -> int:
    """Lower ``layers`` (n_nodes,) int16, distances in cells, until every node is at most one farther than its
    neighbours; returns how often one was lowered.

    Layers are more than ``most`` where a node is farther away or not yet reached. ``planes`` (n_blocks, 2) are those,
    first <= i < last, of each block to look at. ``nodes`` on block faces (n_face,) are ascending, those of block b from
    ``ends[b]`` to ``ends[b + 1]``; their ``classes`` number the sets of nodes that count as one, and ``nearest``
    (n_classes,) int16 is the smallest distance of each set.
    """
    lowered, first, again = 0, True, True
    sizes = shapes[:, 1] * shapes[:, 2]
    starts, stops = offsets[:-1] + planes[:, 0] * sizes, offsets[:-1] + planes[:, 1] * sizes
    while again:
        again = False
        for b in np.flatnonzero(starts < stops).tolist():
            on_faces = nodes[ends[b] : ends[b + 1]]
            low, high = np.searchsorted(on_faces, [starts[b], stops[b]]) + ends[b]
            own, kind = nodes[low:high], classes[low:high]
            closer = nearest[kind] < layers[own]
            layers[own[closer]] = nearest[kind[closer]]
            lowered += int(np.count_nonzero(closer))
            if not first and not closer.any():
                continue
            lowered += _spread_in_box(layers[starts[b] : stops[b]].reshape(-1, *shapes[b, 1:]), most)
            nearer = layers[own] < nearest[kind]
            np.minimum.at(nearest, kind[nearer], layers[own[nearer]])
            again |= bool(nearer.any())
        first = False
    return lowered


def _spread_in_box(layers: np.ndarray, most: int) -> int:
    """Lower the nodes (ni, nj, nk) of a box, layer by layer; returns how often."""
    total, lowered = 0, 1
    while lowered:
        near = layers
        for axis in range(3):
            around = np.moveaxis(near.copy(), axis, 0)
            along = np.moveaxis(near, axis, 0)
            np.minimum(around[1:], along[:-1], out=around[1:])
            np.minimum(around[:-1], along[1:], out=around[:-1])
            near = np.moveaxis(around, 0, axis)
        new = (near < layers - 1) & (near < most)
        layers[new] = near[new] + 1
        lowered = int(np.count_nonzero(new))
        total += lowered
    return total
