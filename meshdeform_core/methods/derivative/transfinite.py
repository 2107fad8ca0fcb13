"""Derivative of transfinite interpolation, which is linear, so that only the transposes are new."""

from __future__ import annotations

import numpy as np

from ...grid import FloatArray
from ...numerics.transfinite.transposed import blend_transposed, faces_transposed, images_transposed, lines_transposed
from ...parallel import Part, apart, rows_of
from ..transfinite.edge_graph import PreparedEdgeGraph
from ..transfinite.faces import Faces
from ..transfinite.tfi import PreparedTFI


class TFIDerivative:
    """The filling of sub-blocks and its transpose."""

    def __init__(self, method: PreparedTFI) -> None:
        self._method, self._points = method, method.problem.grid.points
        # A rank passes on the gradients of all sub-blocks with nodes of its own, on their faces, too.
        self._touching = method.touching() if isinstance(self._points, Part) else method

    def push(self, change: FloatArray) -> None:
        """Fill sub-blocks from their faces, in place."""
        self._method.fill(change)

    def pull(self, gradient: FloatArray) -> None:
        """Pass gradients from inside sub-blocks on to their faces, in place."""
        method = self._touching
        if isinstance(gradient, Part):
            gradient.widen(*method.rows)
        gradient = rows_of(gradient)
        for number in range(method.n_groups):
            with apart(self._points):
                group, curved = method.group(number)
            if curved:
                found = np.empty((len(curved.subs), 3, 3))
                images_transposed(gradient, curved.deviation, curved.subs, found)
                corners = np.einsum("nac,nak->nkc", found, curved.bent.inverse)
                np.add.at(gradient, curved.bent.corners, corners)
            if group.faces:
                _pull_faces(gradient, group.faces)
            else:
                blend_transposed(gradient, group.arc, group.subs)


class EdgeGraphDerivative:
    """TFI of block interfaces from the sources, and its transpose."""

    def __init__(self, method: PreparedEdgeGraph) -> None:
        self._method = method

    def push(self, change: FloatArray, out: FloatArray) -> FloatArray:
        """Change (n_unique, 3) of all face nodes."""
        return self._method.move(change, out)

    def pull(self, face: FloatArray) -> FloatArray:
        """Gradient (n_sources, 3) from that of the face nodes (n_unique, 3), which is overwritten."""
        method = self._method
        _pull_faces(face, method._faces)
        lines = method._lines
        lines_transposed(face, lines.start, lines.nodes, lines.arc)
        if method._graph:
            graph = method._graph
            found = graph.harmonic(face[method._free])
            face[method._free] = 0.0
            np.add.at(face, graph.known, graph.weight[:, None] * found[graph.row])
        return face[method._problem.source_numbers]


def _pull_faces(gradient: FloatArray, faces: Faces) -> None:
    faces_transposed(gradient, faces.start, faces.width, faces.nodes, faces.wanted, faces.s, faces.t)
