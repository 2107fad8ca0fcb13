"""Files named in a case, and sequences of displacement files with their times."""

from __future__ import annotations

import glob
import math
import os
import re
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from meshdeform_core.errors import CaseError
from meshdeform_core.wording import literal

_EXPECTED = 'expected "START:STOP:STEP", like "0:1e-3:5e-5", or ascending numbers'
_MAXIMUM = 1_000_000


def parse_times(text: str, where: str) -> tuple[float, ...]:
    """``START:STOP:STEP`` (STOP included if the steps reach it) or numbers separated by commas.

    Raises CaseError for anything else, and for times that are not ascending.
    """
    parts = text.split(":")
    try:
        numbers = [float(part) for part in (parts if len(parts) > 1 else text.split(","))]
    except ValueError:
        raise CaseError(f"{where}: {text!r} is not a list of times; {_EXPECTED}") from None
    if len(parts) == 1:
        return _ascending(numbers, where)
    if len(parts) != 3 or not all(map(math.isfinite, numbers)) or numbers[2] <= 0 or numbers[1] < numbers[0]:
        raise CaseError(f"{where}: {text!r}; {_EXPECTED}, with STEP > 0 and STOP >= START")
    start, stop, step = numbers
    count = (stop - start) / step
    if count >= _MAXIMUM:
        raise CaseError(f"{where}: {text!r} gives {count:.3g} levels; expected at most {_MAXIMUM:,}")
    # A step like 0.1 does not divide 1 exactly.
    return tuple(start + step * n for n in range(math.floor(count * (1 + 1e-12) + 1e-9) + 1))


def _ascending(numbers: Sequence[float], where: str) -> tuple[float, ...]:
    if not all(map(math.isfinite, numbers)):
        raise CaseError(f"{where}: the times {list(numbers)[:6]} are not all finite; {_EXPECTED}")
    if not numbers or any(a >= b for a, b in pairwise(numbers)):
        raise CaseError(f"{where}: the times {list(numbers)[:6]} do not ascend; {_EXPECTED}")
    return tuple(float(n) for n in numbers)


def named_files(value: Any, folder: Path) -> Iterator[Path]:
    """Files named by ``file``, ``files``, ``beam`` and ``boundary_file`` anywhere in the tables of a case."""
    if isinstance(value, (dict, list)):
        for key, item in value.items() if isinstance(value, dict) else enumerate(value):
            if key in ("file", "beam", "boundary_file") and isinstance(item, str):
                yield folder / item
            elif key == "files":
                yield from sequence_files(item, folder, "files")
            else:
                yield from named_files(item, folder)


def sequence_files(value: str | list[str], folder: Path, where: str) -> list[Path]:
    """Files of a list of names, or of a pattern like ``surface_*.csv`` in the order of the numbers in their names."""
    if isinstance(value, str) and value and "\0" not in value:
        found = glob.glob(os.path.join(glob.escape(str(folder)), value))
        if not found:
            raise CaseError(f"{where}: no file matches {literal(value)} in {folder.absolute()}")
        return [Path(name) for name in sorted(found, key=_numerically)]
    if not value or "\0" in "".join(value):
        raise CaseError(
            f'{where}: files = {literal(value)}; expected a pattern like "surface_*.csv" or a list of file names'
        )
    return [folder / name for name in value]


def _numerically(name: str) -> list[tuple[int, str]]:
    """``step9`` before ``step10``."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", name)]


def files_over_time(
    files: str | list[str], times: str | list[float] | None, folder: Path, where: str
) -> tuple[list[Path], tuple[float, ...]]:
    """Files, which must exist, and their times, one for each file.

    Raises CaseError when files are missing, or their number differs from that of the times.
    """
    paths = sequence_files(files, folder, where)
    for path in paths:
        if not path.is_file():
            raise CaseError(f"{where}: {path} does not exist")
    if times is None:
        raise CaseError(f"{where}: times: there are none; {_EXPECTED}")
    when = parse_times(times, f"{where}: times") if isinstance(times, str) else _ascending(times, f"{where}: times")
    if len(when) != len(paths):
        raise CaseError(
            f"{where}: {len(paths)} files ({paths[0].name} to {paths[-1].name}) for {len(when)} times; "
            f"expected one time for each"
        )
    return paths, when
