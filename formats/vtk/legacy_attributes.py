"""The POINT_DATA and CELL_DATA of a legacy VTK file with any kind of data set."""

from __future__ import annotations

from urllib.parse import unquote

import numpy as np

from .dataset import DataArray, Values
from .legacy_file import LegacyFile

# Attributes with a fixed number of components, and the role of the array.
_FIXED = {
    "VECTORS": (3, "Vectors"),
    "NORMALS": (3, "Normals"),
    "TENSORS": (9, "Tensors"),
    "TENSORS6": (6, "Tensors"),
    "GLOBAL_IDS": (1, "GlobalIds"),
    "PEDIGREE_IDS": (1, "PedigreeIds"),
    "EDGE_FLAGS": (1, "EdgeFlag"),
}

_LOCATIONS = {"POINT_DATA": "node", "CELL_DATA": "cell"}


class Attributes:
    """Arrays gathered section by section, with notes on what is dropped."""

    def __init__(self, file: LegacyFile) -> None:
        self.file = file
        self.location = ""
        self.length = 0
        self.arrays: list[DataArray] = []
        self.notes: list[str] = []

    def read(self, words: list[str]) -> None:
        """Read the section that begins with the line ``words``."""
        keyword = words[0].upper()
        sizes = {"SCALARS": (3, 4), "COLOR_SCALARS": (3, 3), "TEXTURE_COORDINATES": (4, 4)}
        few, many = sizes.get(keyword, (2, 2) if keyword in _LOCATIONS else (3, 3))
        known = keyword in sizes or keyword in _FIXED or keyword in _LOCATIONS or keyword in ("FIELD", "LOOKUP_TABLE")
        if not known or not few <= len(words) <= many:
            raise self.file.error(f"expected a section of a VTK file, found {' '.join(words)[:60]!r}")
        if keyword in _LOCATIONS:
            self.location, self.length = _LOCATIONS[keyword], self.file.number(words[1])
        elif keyword == "FIELD":
            self._fields(self.file.number(words[2]))
        elif keyword == "LOOKUP_TABLE":
            self._lookup_table(words[1], self.file.number(words[2]))
        elif keyword == "SCALARS":
            self._scalars(words)
        elif keyword == "COLOR_SCALARS":
            self._colors(words[1], self.file.number(words[2]))
        elif keyword == "TEXTURE_COORDINATES":
            self._array(words[1], self.file.number(words[2]), words[3], "TCoords")
        else:
            components, role = _FIXED[keyword]
            self._array(words[1], components, words[2], role)

    def _array(self, name: str, components: int, type_name: str, role: str = "", length: int | None = None) -> None:
        length = self.length if length is None else length
        label = f"array {unquote(name)!r}"
        read = self.file.values_or_run if self.location else self.file.values
        values = read(components * length, type_name, label)
        self._add(name, values if components == 1 else values.reshape(length, components), role)

    def _add(self, name: str, values: Values, role: str) -> None:
        # VTK makes the first of several arrays of one kind the active one.
        taken = any(role in a.roles for a in self.arrays if a.location == self.location)
        roles = () if taken or not role else (role,)
        self.arrays.append(DataArray(unquote(name), self.location, values, roles, self.file.component_names()))

    def _scalars(self, words: list[str]) -> None:
        components = self.file.number(words[3]) if len(words) == 4 else 1
        table = self.file.words()
        if len(table) != 2 or table[0].upper() != "LOOKUP_TABLE":
            raise self.file.error(f"expected 'LOOKUP_TABLE name' after SCALARS, found {' '.join(table)[:60]!r}")
        self._array(words[1], components, words[2], "Scalars")

    def _colors(self, name: str, components: int) -> None:
        label = f"colours {unquote(name)!r}"
        values = self.file.values(components * self.length, "unsigned_char" if self.file.binary else "float", label)
        if not self.file.binary:
            values = np.rint(255 * np.clip(values, 0, 1)).astype(np.uint8)
        self._add(name, values if components == 1 else values.reshape(self.length, components), "Scalars")

    def _lookup_table(self, name: str, size: int) -> None:
        self.file.values(4 * size, "unsigned_char" if self.file.binary else "float", f"lookup table {name!r}")
        self.notes.append(f"the lookup table {name!r} is not kept")

    def _fields(self, number: int) -> None:
        for _ in range(number):
            words = self.file.words()
            if words[:1] == ["NULL_ARRAY"]:
                continue
            if len(words) != 4:
                raise self.file.error(f"expected 'name components tuples type' of an array, found {' '.join(words)!r}")
            components, length = self.file.number(words[1]), self.file.number(words[2])
            if words[3].lower() in ("string", "utf8_string"):
                self.file.skip_strings(components * length)
                self.notes.append(f"the text array {unquote(words[0])!r} is not kept")
            else:
                self._array(words[0], components, words[3], length=length)
