"""The displacements of a structural model, at the nodes of its surface."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import FloatArray, IntArray

from ..cells import split_cells
from ..numbering import rows_of
from ..table import NO_TRIANGLES

SHELLS = (3, 4)
"""Numbers of corners of shell elements."""
SOLIDS: Mapping[int, tuple[tuple[int, ...], ...]] = {
    4: ((0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)),
    5: ((0, 3, 2, 1), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)),
    6: ((0, 2, 1), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
    8: ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
}
"""Corners of the faces of solids, by the number of corners of the solid, in the order of CalculiX and Nastran."""


@dataclass(frozen=True)
class Results:
    """Displacements of one model.

    Attributes
    ----------
    points : (n, 3) of the surface
    triangles : (m, 3) rows of ``points``; none for models without shells and solids
    shapes : (n, 3) each
    labels : label of each, like ``12.5 Hz``
    """

    points: FloatArray
    triangles: IntArray
    shapes: tuple[FloatArray, ...]
    labels: tuple[str, ...]


@dataclass(frozen=True)
class Displacements:
    """Displacements (n, 3) of the nodes ``numbers`` (n,)."""

    label: str
    numbers: IntArray
    values: FloatArray


def surface_results(
    path: Path,
    numbers: IntArray,
    points: FloatArray,
    faces: Sequence[IntArray],
    found: Sequence[Displacements],
) -> Results:
    """Results at the nodes of the surface of a model.

    Parameters
    ----------
    numbers, points : (n,), (n, 3) of all nodes
    faces : node numbers of the corners of shells, and of solids' outer faces, (m, 3) or (m, 4)

    Raises
    ------
    FormatError
        When there is no displacement, or a node of the surface has none.
    """
    if not found:
        raise FormatError(f"{path} has no displacements of nodes")
    triangles = np.concatenate([NO_TRIANGLES, *(split_cells(face, face.shape[1]) for face in faces)])
    used = np.unique(triangles) if len(triangles) else np.unique(numbers)
    # This also covers nodes without coordinates, or with two of them.
    rows_of(path, numbers, used)
    shapes = []
    for each in found:
        missing = used[~np.isin(used, each.numbers)]
        if missing.size and len(triangles):
            raise FormatError(
                f"{path}: {each.label} has no displacement at {missing.size} nodes of the surface, first {missing[0]}"
            )
        used = used[np.isin(used, each.numbers)]
    for each in found:
        shapes.append(each.values[rows_of(path, each.numbers, used)])
    return Results(
        points[rows_of(path, numbers, used)],
        np.searchsorted(used, triangles),
        tuple(shapes),
        tuple(each.label for each in found),
    )


def outer_faces(solids: Sequence[NDArray[Any]]) -> list[IntArray]:
    """Faces (m, 3) and (m, 4) that belong to one solid only; ``solids`` (k, corners) for each kind of element."""
    faces: dict[int, list[IntArray]] = {3: [], 4: []}
    for cells in solids:
        for face in SOLIDS[cells.shape[1]]:
            faces[len(face)].append(cells[:, face].astype(np.int64))
    return [_single(np.concatenate(parts)) for parts in faces.values() if parts]


def _single(faces: IntArray) -> IntArray:
    _, where, count = np.unique(np.sort(faces, axis=1), axis=0, return_inverse=True, return_counts=True)
    return faces[count[where.ravel()] == 1]
