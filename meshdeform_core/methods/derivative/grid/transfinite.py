"""Derivative of transfinite interpolation with respect to displacements and to the grid, through its arc lengths."""

from __future__ import annotations

import numpy as np

from ....grid import FloatArray, IntArray
from ....numerics.arrays import lengths, spans
from ....numerics.transfinite.box_tangents import pull_boxes, push_boxes
from ....numerics.transfinite.boxes import box_nodes, box_numbers
from ...transfinite.curved import THINNEST, arms, corners_of
from ...transfinite.edge_graph import PreparedEdgeGraph
from ...transfinite.tfi import PreparedTFI
from ..kinks import Kinks


class _Linear:
    """The gradient (m, 3, 3) of the displacement of sub-blocks, fitted to their corners."""

    def __init__(self, points: FloatArray, subs: IntArray, displacement: FloatArray) -> None:
        self.corners = corners_of(subs)
        self._arms, self._given = arms(points, self.corners), displacement[self.corners]
        self._inverse = np.linalg.pinv(self._arms, rcond=THINNEST)
        self.value = self._inverse @ self._given
        self._rest = self._given - self._arms @ self.value

    def push(self, dx: FloatArray, change: FloatArray) -> FloatArray:
        """Change (m, 3, 3) of the gradient for changes of coordinates and displacements (n_nodes, 3).

        The derivative of a pseudo-inverse of constant rank is that of Golub and Pereyra (SIAM J. Numer. Anal. 10, 413,
        1973).
        """
        moved, inverse = arms(dx, self.corners), self._inverse
        found = inverse @ (change[self.corners] - moved @ self.value)
        found += inverse @ inverse.transpose(0, 2, 1) @ moved.transpose(0, 2, 1) @ self._rest
        across = moved.transpose(0, 2, 1) @ inverse.transpose(0, 2, 1) @ self.value
        return np.asarray(found + across - inverse @ (self._arms @ across))

    def pull(self, gradient: FloatArray, of_x: FloatArray, of_change: FloatArray) -> None:
        """Transpose of :meth:`push`: add the gradients of coordinates and displacements."""
        inverse, value = self._inverse, self.value
        back = inverse.transpose(0, 2, 1) @ gradient
        np.add.at(of_change, self.corners, back)
        moved = -back @ value.transpose(0, 2, 1)
        moved += self._rest @ (gradient.transpose(0, 2, 1) @ inverse @ inverse.transpose(0, 2, 1))
        across = gradient - self._arms.transpose(0, 2, 1) @ back
        moved += inverse.transpose(0, 2, 1) @ value @ across.transpose(0, 2, 1)
        np.add.at(of_x, self.corners, moved - moved.mean(axis=1, keepdims=True))


class TFIGridDerivative:
    """The filling of sub-blocks for a displacement (n_nodes, 3), and its transpose."""

    def __init__(self, method: PreparedTFI, displacement: FloatArray) -> None:
        self._method, self._displacement, self._points = method, displacement, method._points

    def push(self, change: FloatArray, dx: FloatArray) -> None:
        """Fill sub-blocks from their faces, in place, for a change ``dx`` (n_nodes, 3) of the grid."""
        for number in range(self._method.n_groups):
            boxes, linear = self._boxes(number)
            value, moved = _values(linear, len(boxes[1]))
            if linear:
                moved = linear.push(dx, change)
            push_boxes(self._points, self._displacement, dx, *boxes, value, moved, change)

    def pull(self, gradient: FloatArray, of_grid: FloatArray) -> None:
        """Pass gradients from inside on to faces, in place, and add the gradient of the grid to ``of_grid``."""
        for number in range(self._method.n_groups):
            boxes, linear = self._boxes(number)
            value, of_linear = _values(linear, len(boxes[1]))
            pull_boxes(self._points, self._displacement, *boxes, value, gradient, of_grid, of_linear)
            if linear:
                linear.pull(of_linear, of_grid, gradient)

    def _boxes(self, number: int) -> tuple[tuple[IntArray, ...], _Linear | None]:
        first, last = self._method._groups[number]
        subs = self._method._subs[first:last]
        nodes, sizes = box_nodes(subs), box_numbers(subs)
        boxes = np.cumsum(sizes) - sizes, subs[:, 7:10] - subs[:, 4:7] + 1, nodes, np.ones(len(nodes), dtype=bool)
        linear = None if self._method._straight else _Linear(self._points, subs, self._displacement)
        return boxes, linear


def _values(linear: _Linear | None, n: int) -> tuple[FloatArray, FloatArray]:
    """The gradients (n, 3, 3) of sub-blocks, and zeros for their changes."""
    return linear.value if linear else np.zeros((n, 3, 3)), np.zeros((n, 3, 3))


class EdgeGraphGridDerivative:
    """TFI of block interfaces for one displacement (n_sources, 3) of the sources, and its transpose."""

    def __init__(self, method: PreparedEdgeGraph, displacement: FloatArray) -> None:
        self._method, problem, self.kinks = method, method._problem, Kinks()
        self._sources = problem.source_numbers
        self._first, self._shape = problem.topology.first, (problem.grid.n_nodes, 3)
        self._points = problem.grid.points[self._first]
        self._face = method.move(displacement, np.empty((0, 3)))
        lines, faces = method._lines, method._faces
        sizes, areas = np.diff(lines.start), np.diff(faces.start)
        one, two = np.ones_like(sizes), np.ones_like(areas)
        long, wide = np.stack([sizes, one, one], axis=1), np.stack([areas // faces.width, faces.width, two], axis=1)
        self._lines = lines.start, long, lines.nodes, np.ones(len(lines.nodes), dtype=bool)
        self._faces = faces.start, wide, faces.nodes, faces.wanted
        self._flat = np.zeros((max(len(long), len(wide)), 3, 3))

    def push(self, change: FloatArray, dx: FloatArray, out: FloatArray) -> FloatArray:
        """Change (n_unique, 3) of all face nodes for changes of the sources and of the grid (n_nodes, 3)."""
        method, face, own = self._method, np.zeros_like(self._face), dx[self._first]
        face[self._sources] = change
        if method._graph:
            graph, free = method._graph, method._free
            right = np.zeros_like(face)
            np.add.at(right, free[graph.row], graph.weight[:, None] * face[graph.known])
            one, two, apart, weight = self._edges()
            total = (weight * self._longer(own))[:, None] * apart
            np.add.at(right, one, total)
            np.subtract.at(right, two, total)
            face[free] = graph.harmonic(right[free])
        for boxes in (self._lines, self._faces):
            flat = self._flat[: len(boxes[1])]
            push_boxes(self._points, self._face, own, *boxes, flat, flat, face)
        return face

    def pull(self, face: FloatArray, g: FloatArray, of_grid: FloatArray) -> FloatArray:
        """Gradient (n_sources, 3) from that of the face nodes (n_unique, 3), which is overwritten; adds that of the
        grid."""
        method, own = self._method, np.zeros_like(self._points)
        for boxes in (self._faces, self._lines):
            flat = self._flat[: len(boxes[1])]
            pull_boxes(self._points, self._face, *boxes, flat, face, own, np.zeros_like(flat))
        if method._graph:
            graph, found = method._graph, np.zeros_like(face)
            found[method._free] = graph.harmonic(face[method._free])
            face[method._free] = 0.0
            np.add.at(face, graph.known, graph.weight[:, None] * found[method._free[graph.row]])
            one, two, apart, weight = self._edges()
            self._add_longer(weight * np.einsum("ei,ei->e", found[one] - found[two], apart), own)
        np.add.at(of_grid, self._first, own)
        return face[self._sources]

    def _edges(self) -> tuple[IntArray, IntArray, FloatArray, FloatArray]:
        """Ends of the graph's edges, difference of displacement between them, and the inverse squared lengths.

        The longer an edge, the weaker the coupling of its ends.
        """
        assert self._method._graph
        segments = self._method._graph.segments
        one, two = segments.rows.ends().T
        return one, two, self._face[one] - self._face[two], segments.length**-2.0

    def _parts(self) -> tuple[IntArray, IntArray, IntArray, FloatArray]:
        """Edge number, both nodes and direction of every segment of an edge between neighbouring nodes."""
        assert self._method._graph
        rows = self._method._graph.segments.rows
        row, place = spans(np.diff(rows.start))
        at = np.flatnonzero(place > 0)
        here, there = rows.nodes[at - 1], rows.nodes[at]
        along = self._points[there] - self._points[here]
        size = lengths(along)[:, None]
        return row[at], here, there, np.divide(along, size, out=np.zeros_like(along), where=size > 0.0)

    def _longer(self, dx: FloatArray) -> FloatArray:
        """Change of the lengths of edges."""
        row, here, there, direction = self._parts()
        part = np.einsum("ei,ei->e", direction, dx[there] - dx[here])
        return np.asarray(np.bincount(row, part, len(self._edges()[0])))

    def _add_longer(self, gradient: FloatArray, of_x: FloatArray) -> None:
        """Transpose of :meth:`_longer`."""
        row, here, there, direction = self._parts()
        part = gradient[row, None] * direction
        np.add.at(of_x, there, part)
        np.subtract.at(of_x, here, part)
