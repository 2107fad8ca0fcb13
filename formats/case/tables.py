"""Files that a case names: sequences of displacement files with their times, and the text files of motions: histories,
beams, airfoil coordinates, positions.
"""

from __future__ import annotations

import glob
import math
import os
import re
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from meshdeform_core.boundary.motions.histories import Beam
from meshdeform_core.boundary.motions.motion import History
from meshdeform_core.boundary.tables import Positions
from meshdeform_core.errors import CaseError, FormatError
from meshdeform_core.grid import FloatArray
from meshdeform_core.wording import counted, literal, vector

from ..files import LARGEST, require_regular

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
        # step9 before step10
        parts = {name: re.split(r"(\d+)", name) for name in found}
        numbers = {name: [(int(p), "") if p.isdigit() else (-1, p) for p in own] for name, own in parts.items()}
        return [Path(name) for name in sorted(found, key=numbers.__getitem__)]
    if not value or "\0" in "".join(value):
        raise CaseError(
            f'{where}: files = {literal(value)}; expected a pattern like "surface_*.csv" or a list of file names'
        )
    return [folder / name for name in value]


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


_ROTATION_VECTOR = ("rx", "ry", "rz")
_WIENER_MILENKOVIC = ("cx", "cy", "cz")
_SAME_STATION = 1e-6
_LARGEST = 256 * 2**20
_MOST_POINTS = 100_000


def read_columns(path: Path, header: str) -> tuple[list[str], FloatArray]:
    """Column names, in lower case, and rows (n, m) of a table; ``header`` is an example of its first line.

    Raises FormatError with the line, for anything but a header and rows of finite numbers.
    """
    lines = _lines_of_text(path)
    if not lines:
        raise FormatError(f"{path} is empty; expected a header like {header} and rows of numbers")
    names = [name.strip().strip('"').lower() for name in re.split(r"[,;\s]+", lines[0][1].lstrip("# ").strip())]
    if names[0] not in header.split(",") or len(set(names)) < len(names) or len(names) < 2:
        raise FormatError(f"{path}, line {lines[0][0]}: found {lines[0][1][:60]!r}; expected a header like {header}")
    rows = [_row(path, number, text, len(names)) for number, text in lines[1:] if not text.startswith("#")]
    if not rows:
        raise FormatError(f"{path} has no rows of numbers below its header")
    return names, np.array(rows, dtype=np.float64)


def read_history(path: Path) -> tuple[list[str], FloatArray]:
    """Column names and rows (n, m) of a table whose first column is the time ``t``, which ascends.

    Raises FormatError As :func:`read_columns`, and for times that do not ascend.
    """
    names, values = read_columns(path, "t,x,y,z")
    if names[0] != "t":
        raise FormatError(f"{path} has the columns {' '.join(names)[:60]}; expected a header like t,x,y,z")
    back = np.flatnonzero(np.diff(values[:, 0]) <= 0)
    if back.size:
        raise FormatError(f"{path}: the times do not ascend: {values[back[0], 0]:g} before {values[back[0] + 1, 0]:g}")
    return names, values


def read_beam(path: Path) -> Beam:
    """Stations of a beam, undeformed, with displacement and rotation, in their order along the beam; for several times,
    column ``t``, the same stations at each.

    Raises
    ------
    FormatError
        For columns that are missing or unknown, and stations that differ between times.
    MotionError
        As :meth:`.Beam.of`.
    """
    names, values = read_columns(path, "t,x,y,z,dx,dy,dz,rx,ry,rz")
    found = [kind for kind in (_ROTATION_VECTOR, _WIENER_MILENKOVIC) if set(kind) & set(names)]
    wanted = {"x", "y", "z", "dx", "dy", "dz", *(found[0] if len(found) == 1 else ())}
    if len(found) != 1 or set(names) - {"t"} != wanted:
        raise FormatError(
            f"{path} has the columns {' '.join(names)}; expected x y z, dx dy dz, either rx ry rz (rotation vector, "
            "degrees) or cx cy cz (Wiener-Milenkovic parameters), and t if there are several times"
        )
    timed = "t" in names
    time = values[:, names.index("t")] if timed else np.zeros(len(values))
    times, count = np.unique(time, return_counts=True)
    if (count != count[0]).any():
        odd = int(np.argmax(count != count[0]))
        raise FormatError(
            f"{path} has {counted(int(count[odd]), 'station')} at t = {times[odd]:g} but {count[0]} at {times[0]:g}; "
            "expected the same stations at all times"
        )
    rows = values[np.argsort(time, kind="stable")]
    point, displacement, turns = (
        rows[:, [names.index(name) for name in kind]].reshape(len(times), -1, 3)
        for kind in (("x", "y", "z"), ("dx", "dy", "dz"), found[0])
    )
    apart = np.abs(point - point[0]).max(axis=2)
    if apart.max() > _SAME_STATION * float(np.ptp(point[0], axis=0).max()):
        level, n = np.unravel_index(int(apart.argmax()), apart.shape)
        raise FormatError(
            f"{path}: station {n + 1} is {vector(point[level, n])} at t = {times[level]:g} and {vector(point[0, n])} "
            f"at {times[0]:g}; expected its undeformed position at every time"
        )
    if found[0] == _ROTATION_VECTOR:
        turns = np.radians(turns)
    else:
        size = np.linalg.norm(turns, axis=2, keepdims=True)
        turns = turns * np.divide(4 * np.arctan(size / 4), size, out=np.ones_like(size), where=size > 0)
    moved = History(times, displacement.reshape(len(times), -1), str(path), timed)
    return Beam.of(point[0], moved, turns)


def columns(names: Sequence[str], values: FloatArray, wanted: Sequence[str], label: str) -> History | None:
    """The history of some columns; ``None`` if there are none of them."""
    found = [name for name in wanted if name in names]
    if not found:
        return None
    if len(found) < len(wanted):
        raise FormatError(f"{label} has the columns {', '.join(found)}; expected all of {', '.join(wanted)}")
    return History(values[:, 0], values[:, [names.index(name) for name in wanted]], label)


def read_airfoil(path: Path) -> FloatArray:
    """Coordinates (n, 2) from the trailing edge over the upper side to the leading edge, and back.

    Selig's form has the points in this order; Lednicer's has the numbers of points of both sides first, and each side
    from the leading edge. Lines of text at the beginning are the name.

    Raises FormatError with the line.
    """
    rows: list[list[float]] = []
    for number, text in _lines_of_text(path):
        if not rows and not re.match(r"[-+.\d]", text):
            continue
        rows.append(_row(path, number, text, 2))
        if len(rows) > _MOST_POINTS:
            raise FormatError(f"{path} has more than {_MOST_POINTS} points")
    points = np.array(rows, dtype=np.float64).reshape(-1, 2)
    if len(points) < 5:
        raise FormatError(f"{path} has {len(points)} points; expected an airfoil: x and y from the trailing edge on")
    counts = points[0]
    if (counts > 2).all() and (counts == np.round(counts)).all():
        upper, lower = (int(n) for n in counts)
        if upper + lower != len(points) - 1:
            raise FormatError(f"{path} announces {upper} and {lower} points, but has {len(points) - 1}")
        over, under = points[1 : upper + 1], points[upper + 1 :]
        if np.abs(over[0] - under[0]).max() > 1e-6:
            raise FormatError(f"{path}: its sides begin at {vector(over[0])} and {vector(under[0])}; expected one nose")
        points = np.concatenate([over[::-1], under[1:]])
    x, y = points.T
    if x @ np.roll(y, -1) - y @ np.roll(x, -1) < 0:
        points = points[::-1]
    return points


def read_positions(path: Path) -> Positions:
    """SU2's ``surface_positions.dat``: the number and the new coordinates of a point in each line.

    Raises FormatError with the line; and for a number with two positions.
    """
    lines = [(number, text) for number, text in _lines_of_text(path) if not text.startswith(("#", "%"))]
    if not lines:
        raise FormatError(f"{path} has no positions; expected lines of a number and coordinates")
    width = len(re.split(r"[,;\s]+", lines[0][1]))
    if width not in (3, 4):
        raise FormatError(f"{path}, line {lines[0][0]}: found {width} columns; expected a number and x y z (or x y)")
    rows = np.array([_row(path, number, text, width) for number, text in lines])
    numbers = rows[:, 0].astype(np.int64)
    if (numbers != rows[:, 0]).any():
        at = int(np.argmax(numbers != rows[:, 0]))
        raise FormatError(f"{path}, line {lines[at][0]}: {rows[at, 0]:g} is not the number of a point")
    points, first, which = np.unique(numbers, return_index=True, return_inverse=True)
    differs = (rows != rows[first[which.ravel()]]).any(axis=1)
    if differs.any():
        raise FormatError(f"{path}: point {numbers[np.argmax(differs)]} has two positions")
    return Positions(points, rows[first, 1:], str(path))


def _lines_of_text(path: Path) -> list[tuple[int, str]]:
    """Numbers and text of the lines that are not blank."""
    require_regular(path)
    if path.stat().st_size > _LARGEST:
        raise FormatError(f"{path} is larger than any such table ({_LARGEST >> 20} MiB)")
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise FormatError(f"{path} is not UTF-8 text: {error}") from error
    return [(number, line.strip()) for number, line in enumerate(text.splitlines(), start=1) if line.strip()]


def _row(path: Path, number: int, text: str, width: int) -> list[float]:
    words = [word for word in re.split(r"[,;\s]+", text) if word]
    try:
        values = [float(word) for word in words]
    except ValueError as error:
        raise FormatError(f"{path}, line {number}: {error}") from None
    if len(values) != width or not (np.abs(values) <= LARGEST).all():
        raise FormatError(
            f"{path}, line {number}: found {text[:60]!r}; expected {width} finite numbers up to {LARGEST:g}"
        )
    return values
