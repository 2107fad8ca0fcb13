"""Derivative of transfinite interpolation with respect to the grid: through arc lengths, and through the deviations of
curved grid lines.

Lines, faces and sub-blocks are all *boxes* here: a list of nodes in C order with a shape (ni, nj, nk), which is one
node thick in missing directions. The displacement of an inner node is the sum over faces minus edges plus corners, each
times a product of arc-length coordinates, plus the image of the node's deviation D under the gradient G of the box, see
:mod:`...methods.transfinite.curved`.
"""

from __future__ import annotations

import math

import numpy as np

from ..jit import inlined, kernel


@inlined
def _arcs(x, nodes, first, step, count, arc, slot):
    """Arc coordinates of ``count`` nodes of a line, every ``step``-th of ``nodes`` from ``first`` on; returns length.

    They are stored in ``arc`` from ``slot`` on, ``step`` apart; uniform if the length is zero.
    """
    total = 0.0
    arc[slot] = 0.0
    for m in range(1, count):
        p, q = nodes[first + m * step], nodes[first + (m - 1) * step]
        a, b, c = x[p, 0] - x[q, 0], x[p, 1] - x[q, 1], x[p, 2] - x[q, 2]
        total += math.sqrt(a * a + b * b + c * c)
        arc[slot + m * step] = total
    for m in range(1, count):
        arc[slot + m * step] = arc[slot + m * step] / total if total > 0.0 else m / (count - 1)
    return total


@inlined
def _arc_tangents(x, dx, nodes, first, step, count, total, arc, change, slot):
    """Changes of the coordinates of :func:`_arcs` for changes ``dx`` of the nodes."""
    sum_ = 0.0
    change[slot] = 0.0
    for m in range(1, count):
        p, q = nodes[first + m * step], nodes[first + (m - 1) * step]
        a, b, c = x[p, 0] - x[q, 0], x[p, 1] - x[q, 1], x[p, 2] - x[q, 2]
        size = math.sqrt(a * a + b * b + c * c)
        if size > 0.0:
            sum_ += (a * (dx[p, 0] - dx[q, 0]) + b * (dx[p, 1] - dx[q, 1]) + c * (dx[p, 2] - dx[q, 2])) / size
        change[slot + m * step] = sum_
    for m in range(1, count):
        at = slot + m * step
        change[at] = (change[at] - arc[at] * sum_) / total if total > 0.0 else 0.0


@inlined
def _arc_gradients(x, nodes, first, step, count, total, arc, gradient, slot, out):
    """Transpose of :func:`_arc_tangents`: add to ``out`` the gradients of the nodes from those of the coordinates."""
    if total == 0.0:
        return
    mean = 0.0
    for m in range(1, count):
        mean += arc[slot + m * step] * gradient[slot + m * step]
    rest = 0.0
    for m in range(count - 1, 0, -1):
        rest += gradient[slot + m * step]
        p, q = nodes[first + m * step], nodes[first + (m - 1) * step]
        a, b, c = x[p, 0] - x[q, 0], x[p, 1] - x[q, 1], x[p, 2] - x[q, 2]
        size = math.sqrt(a * a + b * b + c * c)
        if size > 0.0:
            part = (rest - mean) / (total * size)
            out[p, 0], out[p, 1], out[p, 2] = out[p, 0] + part * a, out[p, 1] + part * b, out[p, 2] + part * c
            out[q, 0], out[q, 1], out[q, 2] = out[q, 0] - part * a, out[q, 1] - part * b, out[q, 2] - part * c


@inlined
def _weight(s, place, low, thick):
    """Factor of one direction, its derivative, and the index of the node that it belongs to.

    ``place`` 0, 1, 2: the inner node itself, the low end, the high end.
    """
    if place == 0:
        return 1.0, 0.0, low
    if place == 1:
        return 1.0 - s, -1.0, 0
    return s, 1.0, thick - 1


@inlined
def _all_arcs(task, x, dx, nodes, first, ni, nj, nk, arc, change, out):
    """Coordinates of all lines of a box; with ``task`` 1 also their changes, with 2 the gradients that they pass on."""
    n = ni * nj * nk
    for axis in range(3):
        count = ni if axis == 0 else (nj if axis == 1 else nk)
        if count < 3:
            continue
        step = nj * nk if axis == 0 else (nk if axis == 1 else 1)
        for line in range(n // count):
            if axis == 0:
                start = line
            elif axis == 1:
                start = line // nk * nj * nk + line % nk
            else:
                start = line * nk
            total = _arcs(x, nodes, first + start, step, count, arc[axis], start)
            if task == 1:
                _arc_tangents(x, dx, nodes, first + start, step, count, total, arc[axis], change[axis], start)
            elif task == 2:
                _arc_gradients(x, nodes, first + start, step, count, total, arc[axis], change[axis], start, out)


@inlined
def _largest(shape):
    largest = 0
    for box in range(shape.shape[0]):
        largest = max(largest, shape[box, 0] * shape[box, 1] * shape[box, 2])
    return largest


@inlined
def _push_node(to, w, dw, x, d, dx, linear, out, here, deviation):
    """Add the contribution of node ``to``, whose weight ``w`` changes by ``dw``, to the change of an inner node."""
    for c in range(3):
        u, v = d[to, c], out[to, c]
        for a in range(3):
            u -= x[to, a] * linear[a, c]
            v -= dx[to, a] * linear[a, c]
        here[c] += w * v + dw * u
        deviation[c] -= w * x[to, c]


@kernel
def push_boxes(x, d, dx, start, shape, nodes, wanted, linear, d_linear, out):
    """Fill the inner nodes of boxes, box by box, with the change of their displacement, in place in ``out``.

    Parameters
    ----------
    x, d, dx : (n, 3) coordinates, displacements, changes of the coordinates
    start, shape : (m,) first entry of each box in ``nodes``; (m, 3) nodes of each box along i, j, k
    nodes : rows of ``x``
    wanted : which inner nodes are filled
    linear, d_linear : (m, 3, 3) gradient of each box, derivative along the first index of the component of the second;
        its change
    out : (n, 3) change of the displacement, known at the faces of the first box
    """
    size = _largest(shape)
    arc, change, here, deviation = np.empty((3, size)), np.empty((3, size)), np.empty(3), np.empty(3)
    for box in range(shape.shape[0]):
        ni, nj, nk, first = shape[box, 0], shape[box, 1], shape[box, 2], start[box]
        _all_arcs(1, x, dx, nodes, first, ni, nj, nk, arc, change, out)
        for i in range(1 if ni > 1 else 0, ni - 1 if ni > 1 else 1):
            for j in range(1 if nj > 1 else 0, nj - 1 if nj > 1 else 1):
                for k in range(1 if nk > 1 else 0, nk - 1 if nk > 1 else 1):
                    at = (i * nj + j) * nk + k
                    node = nodes[first + at]
                    if not wanted[first + at]:
                        continue
                    for c in range(3):
                        here[c], deviation[c] = 0.0, x[node, c]
                    for p in range(3 if ni > 1 else 1):
                        wp, vp, ip = _weight(arc[0, at], p, i, ni)
                        for q in range(3 if nj > 1 else 1):
                            wq, vq, iq = _weight(arc[1, at], q, j, nj)
                            for r in range(3 if nk > 1 else 1):
                                sides = (p > 0) + (q > 0) + (r > 0)
                                if sides == 0:
                                    continue
                                wr, vr, ir = _weight(arc[2, at], r, k, nk)
                                sign = -1.0 if sides == 2 else 1.0
                                w, dw = sign * wp * wq * wr, 0.0
                                if p > 0:
                                    dw += sign * vp * wq * wr * change[0, at]
                                if q > 0:
                                    dw += sign * wp * vq * wr * change[1, at]
                                if r > 0:
                                    dw += sign * wp * wq * vr * change[2, at]
                                to = nodes[first + (ip * nj + iq) * nk + ir]
                                _push_node(to, w, dw, x, d, dx, linear[box], out, here, deviation)
                    for c in range(3):
                        for a in range(3):
                            here[c] += dx[node, a] * linear[box, a, c] + deviation[a] * d_linear[box, a, c]
                        out[node, c] = here[c]


@inlined
def _pull_node(to, w, own, x, d, linear, g, of_x, deviation):
    """Pass the gradient ``own`` of an inner node on to node ``to`` with weight ``w``; return the gradient of ``w``."""
    along = 0.0
    for c in range(3):
        u = d[to, c]
        for a in range(3):
            u -= x[to, a] * linear[a, c]
            of_x[to, a] -= w * own[c] * linear[a, c]
        along += own[c] * u
        g[to, c] += w * own[c]
        deviation[c] -= w * x[to, c]
    return along


@kernel
def pull_boxes(x, d, start, shape, nodes, wanted, linear, g, of_x, of_linear):
    """Transpose of :func:`push_boxes`, last box first: pass the gradients ``g`` (n, 3) of inner nodes on to faces, and
    set them to zero.

    Adds to ``of_x`` (n, 3) and ``of_linear`` (m, 3, 3), the gradients of coordinates and of the gradients of boxes.
    """
    size = _largest(shape)
    arc, slope, own, deviation = np.empty((3, size)), np.empty((3, size)), np.empty(3), np.empty(3)
    for box in range(shape.shape[0] - 1, -1, -1):
        ni, nj, nk, first = shape[box, 0], shape[box, 1], shape[box, 2], start[box]
        _all_arcs(0, x, x, nodes, first, ni, nj, nk, arc, slope, of_x)
        for at in range(ni * nj * nk):
            slope[0, at] = slope[1, at] = slope[2, at] = 0.0
        for i in range(1 if ni > 1 else 0, ni - 1 if ni > 1 else 1):
            for j in range(1 if nj > 1 else 0, nj - 1 if nj > 1 else 1):
                for k in range(1 if nk > 1 else 0, nk - 1 if nk > 1 else 1):
                    at = (i * nj + j) * nk + k
                    node = nodes[first + at]
                    if not wanted[first + at]:
                        continue
                    for c in range(3):
                        own[c], deviation[c] = g[node, c], x[node, c]
                        g[node, c] = 0.0
                    for p in range(3 if ni > 1 else 1):
                        wp, vp, ip = _weight(arc[0, at], p, i, ni)
                        for q in range(3 if nj > 1 else 1):
                            wq, vq, iq = _weight(arc[1, at], q, j, nj)
                            for r in range(3 if nk > 1 else 1):
                                sides = (p > 0) + (q > 0) + (r > 0)
                                if sides == 0:
                                    continue
                                wr, vr, ir = _weight(arc[2, at], r, k, nk)
                                sign = -1.0 if sides == 2 else 1.0
                                w = sign * wp * wq * wr
                                to = nodes[first + (ip * nj + iq) * nk + ir]
                                along = _pull_node(to, w, own, x, d, linear[box], g, of_x, deviation)
                                if p > 0:
                                    slope[0, at] += sign * vp * wq * wr * along
                                if q > 0:
                                    slope[1, at] += sign * wp * vq * wr * along
                                if r > 0:
                                    slope[2, at] += sign * wp * wq * vr * along
                    for c in range(3):
                        for a in range(3):
                            of_x[node, a] += linear[box, a, c] * own[c]
                            of_linear[box, a, c] += deviation[a] * own[c]
        _all_arcs(2, x, x, nodes, first, ni, nj, nk, arc, slope, of_x)
