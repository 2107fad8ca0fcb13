"""The variants of a Plot3D grid file and the options that select them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from meshdeform_core.errors import FormatError, suggestion
from meshdeform_core.grid import FileFormat

CHOICES: dict[str, tuple[Any, ...]] = {
    "encoding": ("ascii", "binary", "fortran"),
    "byte_order": ("little", "big"),
    "markers": (4, 8),
    "records": ("block", "array", "plane"),
    "precision": ("float32", "float64"),
    "multiblock": (True, False),
    "dimension": (3, 2),
    "iblank": (False, True),
}

# Options that apply only to some encodings, with their defaults.
_SPECIFIC: dict[str, dict[str, Any]] = {
    "ascii": {},
    "binary": {"byte_order": "little"},
    "fortran": {"byte_order": "little", "markers": 4, "records": "block"},
}


@dataclass(frozen=True)
class Variant:
    """A variant of the Plot3D format.

    ``encoding`` is ``ascii`` (list-directed text), ``binary`` (a C stream without markers) or ``fortran`` (unformatted
    sequential records between byte counts of ``markers`` bytes). ``records`` is the content of one Fortran record: a
    whole ``block``, one coordinate ``array`` of it, or one k ``plane``. ``byte_order``, ``markers`` and ``records``
    are ``None`` if they do not apply to the encoding.
    """

    encoding: str = "fortran"
    byte_order: str | None = "little"
    markers: int | None = 4
    records: str | None = "block"
    precision: str = "float64"
    multiblock: bool = True
    dimension: int = 3
    iblank: bool = False

    @property
    def real(self) -> np.dtype[Any]:
        """Type of a coordinate in the file."""
        return np.dtype(self.precision).newbyteorder(self._order)

    @property
    def integer(self) -> np.dtype[Any]:
        """Type of a dimension or IBLANK value in the file."""
        return np.dtype(np.int32).newbyteorder(self._order)

    @property
    def marker(self) -> np.dtype[Any]:
        """Type of a record marker in a Fortran file."""
        return np.dtype(f"i{self.markers}").newbyteorder(self._order)

    @property
    def _order(self) -> Any:
        return {"little": "<", "big": ">", None: "="}[self.byte_order]

    @property
    def encoding_label(self) -> str:
        """For messages, e.g. ``big-endian Fortran (4-byte markers)``."""
        if self.encoding == "ascii":
            return "ASCII"
        kind = "C binary" if self.encoding == "binary" else f"Fortran ({self.markers}-byte markers)"
        return f"{self.byte_order}-endian {kind}"

    @property
    def label(self) -> str:
        """For messages, e.g. ``big-endian Fortran (4-byte markers) float64 multi-block 3-D with IBLANK``."""
        words = [self.encoding_label]
        words += [self.precision] if self.encoding != "ascii" else []
        words += ["multi-block" if self.multiblock else "single-block", f"{self.dimension}-D"]
        words += [f"with one record per {self.records}"] if self.records in ("array", "plane") else []
        words += ["with IBLANK"] if self.iblank else []
        return " ".join(words)

    def matches(self, options: Mapping[str, Any]) -> bool:
        """Whether this variant satisfies (parsed) ``options``."""
        return all(getattr(self, key) == value for key, value in options.items())

    def changed(self, options: Mapping[str, Any]) -> Variant:
        """This variant changed by (parsed) ``options``; options that apply only to the new encoding get defaults."""
        values = {**asdict(self), **options}
        specific = _SPECIFIC[values["encoding"]]
        for key in ("byte_order", "markers", "records"):
            if key not in specific and key in options:
                usable = " or ".join(f"encoding={name}" for name, keys in _SPECIFIC.items() if key in keys)
                raise FormatError(f"{key} does not apply to encoding={values['encoding']}; omit it or use {usable}")
            values[key] = (values[key] or specific[key]) if key in specific else None
        return Variant(**values)

    @classmethod
    def of(cls, file_format: FileFormat) -> Variant:
        """The variant recorded in the file format of a grid."""
        return cls().changed({**file_format.options, "precision": file_format.precision})

    def file_format(self) -> FileFormat:
        """This variant as the file format of a grid."""
        options = {key: value for key, value in asdict(self).items() if value is not None and key != "precision"}
        return FileFormat("plot3d", self.precision, options)


def parse_options(options: Mapping[str, Any]) -> dict[str, Any]:
    """Check options given as text (from the command line) or as Python values.

    Raises FormatError for an unknown option or value; the message names the nearest known one.
    """
    found = {}
    for key, value in options.items():
        if key not in CHOICES:
            raise FormatError(f"unknown Plot3D option {key!r}{_nearest(key, list(CHOICES))}")
        words = {str(choice).lower(): choice for choice in CHOICES[key]}
        if str(value).lower() not in words:
            raise FormatError(f"Plot3D option {key}={value} is not known{_nearest(str(value), list(words))}")
        found[key] = words[str(value).lower()]
    return found


def _nearest(word: str, known: list[str]) -> str:
    return f"{suggestion(word.lower(), known)}; known are {', '.join(known)}"
