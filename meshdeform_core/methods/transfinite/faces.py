"""Lines and faces of nodes, blended from their ends and edges, in flat arrays for the compiled loops."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...grid import BoolArray, FloatArray, IntArray
from ...numerics.transfinite.faces import blend_faces, blend_lines, face_coordinates
from ...numerics.transfinite.transposed import faces_transposed, lines_transposed


@dataclass(frozen=True)
class Lines:
    """Lines of nodes with their arc coordinates.

    Attributes
    ----------
    start : (n + 1,) index at which each line begins in the other arrays
    nodes, arc : node numbers and coordinates from 0 to 1, ends included
    """

    start: IntArray
    nodes: IntArray
    arc: FloatArray

    @classmethod
    def on(cls, points: FloatArray, start: IntArray, nodes: IntArray) -> Lines:
        """Lines from ``start`` and ``nodes``, with their arc coordinates."""
        arc, across = np.empty(len(nodes)), np.empty(len(nodes))
        face_coordinates(points, start, np.ones(len(start) - 1, dtype=np.int64), nodes, arc, across)
        return cls(start, nodes, arc)

    def blend(self, displacement: FloatArray) -> None:
        """Compute the displacement inside the lines from that of their ends, in place, line by line."""
        blend_lines(displacement, self.start, self.nodes, self.arc)

    def pull(self, gradient: FloatArray) -> None:
        """Transpose of :meth:`blend`: pass gradients on from inside the lines to their ends, in place."""
        lines_transposed(gradient, self.start, self.nodes, self.arc)


@dataclass(frozen=True)
class Faces:
    """Rectangles of nodes with their arc coordinates.

    Attributes
    ----------
    start : (n + 1,) index at which each rectangle begins in the other arrays
    width : (n,) nodes along its second index
    nodes : node numbers, C-ordered
    wanted : which interior nodes are to be moved
    s, t : coordinates from 0 to 1 along the first and second index
    """

    start: IntArray
    width: IntArray
    nodes: IntArray
    wanted: BoolArray
    s: FloatArray
    t: FloatArray

    @classmethod
    def of(cls, points: FloatArray, nodes: Sequence[IntArray], wanted: Sequence[BoolArray]) -> Faces:
        """Faces from one array (na, nb) of node numbers (rows of ``points``) per rectangle."""
        width = np.array([part.shape[1] for part in nodes], dtype=np.int64)
        return cls.on(points, _starts(nodes), width, _joined(nodes, np.int64), _joined(wanted, np.bool_))

    @classmethod
    def on(cls, points: FloatArray, start: IntArray, width: IntArray, nodes: IntArray, wanted: BoolArray) -> Faces:
        """Faces from ``start``, ``width`` and ``nodes``, with their arc coordinates."""
        s, t = np.empty(len(nodes)), np.empty(len(nodes))
        face_coordinates(points, start, width, nodes, s, t)
        return cls(start, width, nodes, wanted, s, t)

    def blend(self, displacement: FloatArray) -> None:
        """Compute the displacement inside the rectangles from that of their edges, in place, one by one."""
        blend_faces(displacement, self.start, self.width, self.nodes, self.wanted, self.s, self.t)

    def pull(self, gradient: FloatArray) -> None:
        """Transpose of :meth:`blend`: pass gradients on from inside the rectangles to their edges, in place."""
        faces_transposed(gradient, self.start, self.width, self.nodes, self.wanted, self.s, self.t)


def _starts(parts: Sequence[np.ndarray]) -> IntArray:
    return np.cumsum([0] + [part.size for part in parts], dtype=np.int64)


def _joined(parts: Sequence[np.ndarray], kind: type) -> np.ndarray:
    return np.concatenate([np.empty(0, dtype=kind), *(part.ravel() for part in parts)])
