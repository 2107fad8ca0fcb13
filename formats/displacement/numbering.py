"""Numbers in text files of surfaces, and node numbers, by which values and cells refer to nodes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import IntArray


def text_numbers(data: bytes) -> NDArray[np.float64]:
    """The numbers of a text, separated by white space.

    Raises
    ------
    ValueError
        For anything else, including what only Python accepts as a number: 1_000 and digits of other scripts.
    """
    if b"_" in data or not data.isascii():
        raise ValueError("a word among its numbers is no number")
    return np.array(data.split(), dtype=np.float64)


def whole(values: NDArray[Any]) -> IntArray:
    """Numbers that must be whole, as integers.

    Raises
    ------
    ValueError
        For any other.
    """
    if not (np.abs(values) < 2.0**53).all() or (values != np.floor(values)).any():
        raise ValueError("a whole number was expected")
    return values.astype(np.int64)


def rows_of(path: Path, numbers: IntArray, wanted: IntArray) -> IntArray:
    """Rows of the nodes with the ``wanted`` numbers, in the shape of ``wanted``.

    Raises
    ------
    FormatError
        When two nodes have the same number, or a wanted one does not exist.
    """
    order = np.argsort(numbers, kind="stable")
    ascending = numbers[order]
    twice = np.flatnonzero(ascending[1:] == ascending[:-1])
    if twice.size:
        raise FormatError(f"{path}: two nodes have the number {ascending[twice[0]]}; the file is damaged")
    place = np.minimum(np.searchsorted(ascending, wanted), max(len(numbers) - 1, 0))
    missing = wanted.size and (not len(numbers) or (ascending[place] != wanted).any())
    if missing:
        unknown = wanted if not len(numbers) else wanted[ascending[place] != wanted]
        raise FormatError(f"{path} refers to the node {unknown.ravel()[0]}, which it does not have")
    rows: IntArray = order[place] if wanted.size else np.empty(wanted.shape, dtype=np.int64)
    return rows


def by_number(path: Path, name: str, numbers: IntArray, own: IntArray, values: NDArray[Any]) -> NDArray[Any]:
    """Values of the nodes ``own``, one row each, in the order of ``numbers``.

    Raises
    ------
    FormatError
        When a node has no value, or two.
    """
    if len(own) != len(numbers):
        raise FormatError(
            f"{path}: {name} has values for {len(own)} of {len(numbers)} nodes; expected one for each node"
        )
    rows = rows_of(path, numbers, own)
    if len(np.unique(rows)) != len(rows):
        raise FormatError(f"{path}: {name} has two values for one node; expected one for each")
    ordered = np.empty_like(values)
    ordered[rows] = values
    return ordered
