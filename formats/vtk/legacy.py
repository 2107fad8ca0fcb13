"""Structured grids from legacy VTK files (.vtk), including RECTILINEAR_GRID and STRUCTURED_POINTS."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Shape
from meshdeform_core.parallel import require_undivided

from .dataset import DataSet, Values
from .lattice import lattice, require_plausible_lattice
from .legacy_attributes import Attributes
from .legacy_file import LegacyFile

_OTHER_KINDS = {"POLYDATA": "a polygon surface", "UNSTRUCTURED_GRID": "an unstructured grid", "FIELD": "field data"}

# Geometry keywords and the number of values on their line, or per entry of the run that follows.
_ON_THE_LINE = {"DIMENSIONS": 3, "EXTENT": 6, "ORIGIN": 3, "SPACING": 3, "ASPECT_RATIO": 3}
_IN_A_RUN = {"POINTS": 3, "X_COORDINATES": 1, "Y_COORDINATES": 1, "Z_COORDINATES": 1}


def read(path: Path) -> DataSet:
    """Read the structured data set of a legacy file.

    Raises
    ------
    FormatError
        When the file is truncated, contradicts its keywords, or contains another kind of data set.
    """
    with path.open("rb") as stream:
        file = LegacyFile(path, stream, later=True)
        if file.kind not in ("STRUCTURED_GRID", "RECTILINEAR_GRID", "STRUCTURED_POINTS"):
            other = _OTHER_KINDS.get(file.kind, "another kind of data set")
            raise FormatError(f"{path} is {other} (DATASET {file.kind}); expected a structured grid")
        if not file.binary or file.kind != "STRUCTURED_GRID":
            require_undivided(f"{path} is text, or has no coordinates of nodes")
        geometry, attributes = _sections(file)
        shape, origin = _extent(file, geometry)
        points = _points(file, geometry, shape)
        complete = file.binary or file.ends_in_a_line()
    notes = [] if file.kind == "STRUCTURED_GRID" else [f"{file.kind} is read as a structured grid"]
    if not complete:
        notes.append("the last line has no line end; if the file is truncated there, its last number is wrong")
    options = {"encoding": "binary" if file.binary else "ascii"}
    return DataSet(points, tuple(attributes.arrays), options, origin, file.title, (*notes, *attributes.notes))


def _sections(file: LegacyFile) -> tuple[dict[str, Any], Attributes]:
    geometry: dict[str, Any] = {}
    attributes = Attributes(file)
    while words := file.words():
        keyword = words[0].upper()
        if keyword in _ON_THE_LINE:
            geometry[keyword] = _line_numbers(file, words[1:], _ON_THE_LINE[keyword])
        elif keyword in _IN_A_RUN:
            if len(words) != 3:
                raise file.error(f"expected '{keyword} number type', found {' '.join(words)[:60]!r}")
            read = file.values_or_run if keyword == "POINTS" else file.values
            geometry[keyword] = read(_IN_A_RUN[keyword] * file.number(words[1]), words[2], keyword)
            file.component_names()
        else:
            attributes.read(words)
    return geometry, attributes


def _line_numbers(file: LegacyFile, words: Sequence[str], number: int) -> NDArray[np.float64]:
    try:
        numbers = np.array(words, dtype=float)
    except ValueError as error:
        raise file.error(f"expected {number} numbers, found {' '.join(words)[:60]!r}") from error
    if len(numbers) != number:
        raise file.error(f"expected {number} numbers, found {len(numbers)}")
    return numbers


def _extent(file: LegacyFile, geometry: dict[str, Any]) -> tuple[Shape, Shape]:
    """Shape in nodes, and index of the first node."""
    if "DIMENSIONS" in geometry:
        ni, nj, nk = _whole(file, geometry, "DIMENSIONS")
        i, j, k = 0, 0, 0
    elif "EXTENT" in geometry:
        i, last_i, j, last_j, k, last_k = _whole(file, geometry, "EXTENT")
        ni, nj, nk = last_i - i + 1, last_j - j + 1, last_k - k + 1
    else:
        raise FormatError(f"{file.path} has no DIMENSIONS; is the file truncated?")
    if min(ni, nj, nk) < 1:
        raise FormatError(f"{file.path} is an empty grid: {ni} x {nj} x {nk} nodes")
    return (ni, nj, nk), (i, j, k)


def _whole(file: LegacyFile, geometry: dict[str, Any], keyword: str) -> list[int]:
    numbers = geometry[keyword].tolist()
    if not all(abs(number) < 2**31 and number == int(number) for number in numbers):
        raise FormatError(f"{file.path}: {keyword} {' '.join(map(str, numbers))}; expected whole numbers")
    return [int(number) for number in numbers]


def _points(file: LegacyFile, geometry: dict[str, Any], shape: Shape) -> Values:
    """Coordinates, ``(nk, nj, ni, 3)``."""
    ni, nj, nk = shape
    if file.kind == "STRUCTURED_GRID":
        (run,) = _required(file, geometry, ["POINTS"])
        if len(run) != 3 * ni * nj * nk:
            raise FormatError(
                f"{file.path} has {len(run) // 3} points; its DIMENSIONS {ni} {nj} {nk} need {ni * nj * nk}"
            )
        return run.reshape(nk, nj, ni, 3)
    require_plausible_lattice(file.path, ni * nj * nk, file.size)
    if file.kind == "STRUCTURED_POINTS":
        geometry.setdefault("SPACING", geometry.get("ASPECT_RATIO", np.ones(3)))
        origin, spacing = _required(file, geometry, ["ORIGIN", "SPACING"])
        axes = [origin[a] + spacing[a] * np.arange(shape[a]) for a in range(3)]
    else:
        axes = _required(file, geometry, ["X_COORDINATES", "Y_COORDINATES", "Z_COORDINATES"])
        if tuple(map(len, axes)) != shape:
            raise FormatError(f"{file.path} has {tuple(map(len, axes))} coordinates along x, y, z; expected {shape}")
    return lattice(*axes)


def _required(file: LegacyFile, geometry: dict[str, Any], keywords: Sequence[str]) -> list[Any]:
    missing = [keyword for keyword in keywords if keyword not in geometry]
    if missing:
        raise FormatError(f"{file.path} has no {' and no '.join(missing)}; is the file truncated?")
    return [geometry[keyword] for keyword in keywords]
