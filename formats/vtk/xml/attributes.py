"""The node, cell and field data of a VTK XML file with any kind of data set."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..dataset import DataArray, Values, native
from .arrays import ArrayReader
from .tags import Element

# VTK's attribute types of an array, in its order.
ROLES = (
    "Scalars",
    "Vectors",
    "Normals",
    "TCoords",
    "Tensors",
    "GlobalIds",
    "PedigreeIds",
    "EdgeFlag",
    "Tangents",
    "RationalWeights",
    "HigherOrderDegrees",
    "ProcessIds",
)
ID_ROLES = ("GlobalIds", "PedigreeIds")

SECTIONS = {"PointData": "node", "CellData": "cell", "FieldData": ""}


def read_section(
    reader: ArrayReader, above: Element, tag: str, tuples: int, notes: list[str], later: bool = False
) -> list[DataArray]:
    """The arrays of all ``tag`` elements (a key of :data:`SECTIONS`) in ``above``.

    ``tuples`` is the number of nodes or cells; a line for each array that is not kept is added to ``notes``. With
    ``later``, values that are stored as they are remain to be read.

    Raises
    ------
    FormatError
        When an array is damaged or does not have the expected number of values.
    """
    found: dict[str, DataArray] = {}
    for section in above.all(tag):
        for index, element in enumerate(section.arrays()):
            name = element.get("Name") or f"array{index}"
            if element.tag != "DataArray":
                notes.append(f"the text array {name!r} is not kept")
                continue
            if name in found:
                notes.append(f"{SECTIONS[tag] or 'field'} array {name!r} exists twice; the last one is kept")
            count = tuples if SECTIONS[tag] else reader.number(element, "NumberOfTuples")
            values = reader.values_or_run(element, count) if later else reader.values(element, count)
            roles = tuple(role for role in ROLES if element.get("Name") and section.get(role) == name)
            found[name] = DataArray(name, SECTIONS[tag], values, roles, _component_names(element, values))
    return list(found.values())


def read_field_data(reader: ArrayReader, data_set: Element, notes: list[str]) -> list[DataArray]:
    """The arrays that do not belong to nodes or cells, in the byte order of this machine."""
    arrays = read_section(reader, data_set, "FieldData", 0, notes)
    return [array._replace(values=native(array.values)) for array in arrays]


def _component_names(element: Element, values: Values) -> tuple[str, ...]:
    count = values.shape[1] if values.ndim == 2 else 1
    names = tuple(element.get(f"ComponentName{index}") for index in range(count))
    return names if any(names) else ()


def joined(parts: list[list[DataArray]]) -> Iterator[tuple[DataArray, list[NDArray[Any]]]]:
    """Each array of the first piece with its values in all pieces.

    Raises
    ------
    ValueError
        With the array that one of the pieces lacks or has in another type.
    """
    by_name = [{array.name: array for array in arrays} for arrays in parts]
    for number, arrays in enumerate(by_name[1:], start=2):
        different = sorted(by_name[0].keys() ^ arrays.keys())
        if different:
            raise ValueError(f"array {different[0]!r} is in only one of Piece 1 and Piece {number}")
    for name, first in by_name[0].items():
        values = [arrays[name].values for arrays in by_name]
        if len({(part.dtype, part.shape[1:]) for part in values}) > 1:
            raise ValueError(f"array {name!r} does not have the same type and number of components in all pieces")
        yield first, values


def put_together(parts: list[NDArray[Any]]) -> NDArray[Any]:
    """The values of consecutive pieces as one array."""
    return parts[0] if len(parts) == 1 else np.concatenate(parts)
