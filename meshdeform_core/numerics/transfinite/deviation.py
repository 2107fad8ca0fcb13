"""Deviations of curved grid lines from transfinite interpolation, see :mod:`..methods.transfinite.curved`.

A table ``subs`` (n, 11) lists sub-blocks as in :mod:`.arcs`; its last column is the row of the first inner node in
arrays that have a row for every node inside a sub-block (:func:`.boxes.inner_numbers`).
"""

from __future__ import annotations

from ..jit import kernel
from .boxes import inner


@kernel
def deviations(points, blended, subs, first, last, out, largest):
    """Deviations of the nodes inside sub-blocks from where TFI would place them.

    Parameters
    ----------
    points, blended : (n_nodes, 3) coordinates, and those blended from the faces of the sub-blocks
    first, last : range of rows of ``subs``
    out : (n_inner, 3), filled: a row for every inner node
    largest : filled: largest absolute component in each sub-block
    """
    for n in range(first, last):
        i0, i1 = inner(subs[n, 4], subs[n, 7])
        j0, j1 = inner(subs[n, 5], subs[n, 8])
        k0, k1 = inner(subs[n, 6], subs[n, 9])
        row, most = subs[n, 10], 0.0
        for i in range(i0, i1):
            for j in range(j0, j1):
                node = subs[n, 0] + (i * subs[n, 2] + j) * subs[n, 3]
                for k in range(k0, k1):
                    for c in range(3):
                        value = points[node + k, c] - blended[node + k, c]
                        out[row, c] = value
                        most = max(most, abs(value))
                    row += 1
        largest[n] = most


@kernel
def add_images(d, deviation, subs, first, last, gradient):
    """Add to the displacement ``d`` of the nodes inside sub-blocks the images of their deviations.

    ``gradient`` (n, 3, 3) of each sub-block: derivative along the first index of the displacement component given by
    the second.
    """
    for n in range(first, last):
        i0, i1 = inner(subs[n, 4], subs[n, 7])
        j0, j1 = inner(subs[n, 5], subs[n, 8])
        k0, k1 = inner(subs[n, 6], subs[n, 9])
        row = subs[n, 10]
        for i in range(i0, i1):
            for j in range(j0, j1):
                node = subs[n, 0] + (i * subs[n, 2] + j) * subs[n, 3]
                for k in range(k0, k1):
                    x, y, z = deviation[row, 0], deviation[row, 1], deviation[row, 2]
                    for c in range(3):
                        d[node + k, c] += x * gradient[n, 0, c] + y * gradient[n, 1, c] + z * gradient[n, 2, c]
                    row += 1
