"""The variants of a Plot3D grid file, their options, and detection: of all readings of a file exactly one must fit.

A Plot3D file does not declare its variant, but its header and exact size determine it: for every variant the header
gives the block shapes, and these give the size that the file must have (bytes, or numbers in a text). A reading fits if
the size and, in Fortran files, every record agree. File names are ignored. (Texts and C streams written plane by plane
have the same size as whole blocks and cannot be distinguished from them; only records show it.)
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.errors import FormatError, GridError
from meshdeform_core.grid import FileFormat, Grid, Shape
from meshdeform_core.parallel import Nodes

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


MOST_BLOCKS = 100_000
LONGEST_HEADER = 1 + 3 * MOST_BLOCKS
# Integers that require this many times the size of the file are not a header.
ABSURD = 1000
# Nodes judged at a time.
_TOGETHER = 1 << 16


@dataclass(frozen=True)
class Reading:
    """One way to read a file.

    ``size`` is that of a file of this variant with these blocks: bytes, or numbers in a text. ``segments`` are the
    (offset, length) of the data after the header, in the same unit. ``defect`` describes any disagreement other than
    the size, ``evidence`` the extent of agreement: (1, good records) in Fortran files, else (0, plausible header
    integers).
    """

    variant: Variant
    shapes: tuple[Shape, ...]
    size: int
    segments: tuple[tuple[int, int], ...]
    evidence: tuple[int, int]
    defect: str = ""

    def agrees(self, size: int) -> bool:
        """Whether this reading is of a file of exactly this size."""
        return self.size == size and not self.defect

    @property
    def label(self) -> str:
        """For messages: the variant and its blocks."""
        if not self.shapes:
            return self.variant.encoding_label
        sizes = ", ".join("x".join(str(n) for n in shape[: self.variant.dimension]) for shape in self.shapes[:3])
        count = "1 block" if len(self.shapes) == 1 else f"{len(self.shapes)} blocks"
        return f"{self.variant.label} with {count} ({sizes}{', ...' if len(self.shapes) > 3 else ''})"


def header_variants(**fixed: Any) -> Iterator[Variant]:
    """The variants of one encoding that differ in the contents of header and nodes."""
    for multiblock, dimension, iblank in product((True, False), (3, 2), (False, True)):
        yield Variant().changed({**fixed, "multiblock": multiblock, "dimension": dimension, "iblank": iblank})


def header_shapes(integers: NDArray[np.int64], multiblock: bool, dimension: int, size: int) -> tuple[Shape, ...] | None:
    """Block shapes given by the leading integers of a file of ``size``, ``None`` if they cannot be a header."""
    n_blocks = int(integers[0]) if multiblock and integers.size else 1
    if not 1 <= n_blocks <= MOST_BLOCKS:
        return None
    sizes = integers[int(multiblock) : int(multiblock) + n_blocks * dimension]
    if sizes.size < n_blocks * dimension or sizes.min() < 1:
        return None
    blocks = np.ones((n_blocks, 3), np.int64)
    blocks[:, :dimension] = sizes.reshape(n_blocks, dimension)
    shapes = tuple((int(ni), int(nj), int(nk)) for ni, nj, nk in blocks)
    return shapes if sum(map(math.prod, shapes)) <= ABSURD * size else None


def stream_readings(variants: Iterable[Variant], integers: NDArray[np.int64], size: int) -> Iterator[Reading]:
    """Readings of a text or C binary file of ``size`` whose header may be ``integers``."""
    for variant in variants:
        shapes = header_shapes(integers, variant.multiblock, variant.dimension, size)
        if shapes is None:
            continue
        integer, real = (1, 1) if variant.encoding == "ascii" else (4, variant.real.itemsize)
        header = int(variant.multiblock) + variant.dimension * len(shapes)
        data = (variant.dimension * real + variant.iblank * integer) * sum(map(math.prod, shapes))
        segments = ((integer * header, data),)
        yield Reading(variant, shapes, integer * header + data, segments, (0, header))


@dataclass(frozen=True)
class UnknownFile:
    """A file of unknown variant: its size in ``unit``, the options given, how to load it in a reading, and which of
    several readings something else than its size shows."""

    path: Path
    size: int
    unit: str
    options: Mapping[str, Any]
    load: Callable[[Reading], Grid]
    shown: Callable[[list[Reading]], list[Reading]] = list


def choose(readings: Iterable[Reading], file: UnknownFile) -> Grid:
    """Load the one reading that fits and that the options allow.

    If the size allows several, those with implausible content are excluded (IBLANK values that are not small integers,
    denormal coordinates), and those that the notation of numbers rules out. The remaining one must be plausible
    overall, unless its encoding was requested.
    """
    tried = list(readings)
    allowed = [reading for reading in tried if reading.variant.matches(file.options)]
    fitting = [reading for reading in allowed if reading.agrees(file.size)]
    if not fitting:
        raise FormatError(_nothing_fits(tried, allowed, file))
    if len(fitting) > 1:
        shown = file.shown(fitting) or fitting
        fitting = [reading for reading in shown if _makes_sense(reading, file)] or fitting
    if len(fitting) > 1:
        raise FormatError(_ambiguous(fitting, file.path))
    grid = file.load(fitting[0])
    if fitting[0].variant.encoding != "ascii" and "encoding" not in file.options:
        # Other data may happen to have the right size: a sample of nodes is judged.
        share = _senseless_share(grid, fitting[0].variant, max(grid.n_nodes // 10_000, 1))
        if share > 0.01:
            raise FormatError(
                f"{file.path} has the size of {fitting[0].label}, but {share:.0%} of the numbers would be implausible "
                f"(coordinates denormal or beyond 1e30, IBLANK beyond {MOST_BLOCKS}); if they are correct, confirm "
                f"with the option encoding={fitting[0].variant.encoding}"
            )
    return grid


def _makes_sense(reading: Reading, file: UnknownFile) -> bool:
    """Whether a reading gives plausible numbers."""
    try:
        grid = file.load(reading)
    except (FormatError, GridError):
        return False
    has_nan = _found(grid.nodes.rows, range(*grid.nodes.ends), np.isnan)[0] > 0
    found = grid.nodes.gather((any(field.own.any() for field in grid.fields), has_nan))
    all_blanked = reading.variant.iblank and not any(shown for shown, _ in found)
    return not all_blanked and not any(nan for _, nan in found) and _senseless_share(grid, reading.variant) == 0


def _senseless_share(grid: Grid, variant: Variant, step: int = 1) -> float:
    """Fraction of implausible coordinates or IBLANK values, among every ``step``-th node."""
    tiny = np.finfo(variant.precision).tiny

    def implausible(coordinates: NDArray[Any]) -> NDArray[np.bool_]:
        size = np.abs(coordinates)
        return ((size < tiny) & (size > 0)) | (size > 1e30)

    low, high = grid.nodes.ends
    own = [_found(grid.nodes.rows, range(low + -low % step, high, step), implausible)]
    for field in grid.fields:
        _, nj, nk = grid.shapes[field.block]
        first = grid.planes(field.block).start * nj * nk
        flags = field.own.reshape(-1)
        # Negative IBLANK values are numbers of neighbouring blocks.
        own.append(_found(flags, range(-first % step, flags.size, step), lambda x: abs(x.astype("i8")) > MOST_BLOCKS))
    wrong, all_values = np.sum(grid.nodes.gather(own), axis=0).T
    return float((wrong / all_values).max())


def _found(values: NDArray[Any], rows: range, judge: Callable[[NDArray[Any]], NDArray[np.bool_]]) -> tuple[int, int]:
    """How many numbers in some ``rows`` of an array, which may be in a file, are as ``judge`` says, and of how many."""
    found = count = 0
    for lo in range(0, len(rows), _TOGETHER):
        some = rows[lo : lo + _TOGETHER]
        judged = judge(Nodes.of(values).at(np.arange(some.start, some.stop, some.step)))
        found, count = found + int(judged.sum()), count + judged.size
    return found, count


def _nothing_fits(tried: list[Reading], allowed: list[Reading], file: UnknownFile) -> str:
    wanted = "".join(f" with {key}={value}" for key, value in file.options.items())
    excluded = [reading.label for reading in tried if reading.agrees(file.size)]
    if excluded:
        return f"{file.path} fits no variant of Plot3D{wanted}; without these options it is {' or '.join(excluded)}"
    if not allowed:
        return (
            f"{file.path} is not a Plot3D grid{wanted}: its first numbers are not a block count and block sizes in any "
            f"encoding (text, C binary, Fortran records with 4- or 8-byte markers; either byte order)"
        )
    nearest = max(allowed, key=lambda reading: (reading.evidence, -abs(reading.size - file.size)))
    missing = nearest.size - file.size
    verdict = f"truncated by {missing}" if missing > 0 else f"{-missing} too many"
    lacks = [f"the file should have {nearest.size} {file.unit} but has {file.size}: {verdict}"] if missing else []
    lacks += [nearest.defect] if nearest.defect else []
    count = f"{len(allowed)} tried"
    return f"{file.path} fits no variant of Plot3D{wanted} ({count}); nearest is {nearest.label}: {'; '.join(lacks)}"


def _ambiguous(readings: list[Reading], path: Path) -> str:
    telling = [key for key in CHOICES if len({getattr(reading.variant, key) for reading in readings}) > 1]
    ways = []
    for reading in readings:
        values = {key: getattr(reading.variant, key) for key in telling}
        words = ", ".join(f"{key}={str(value).lower()}" for key, value in values.items() if value is not None)
        ways.append(f"{words} ({reading.label})")
    return (
        f"{path} can be read in {len(readings)} ways and its content does not decide between them; choose by options: "
        f"{' or '.join(ways)}"
    )
