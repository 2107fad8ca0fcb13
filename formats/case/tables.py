"""Files that a case names: sequences of displacement files with their times, and the text files of motions: histories,
beams, airfoil coordinates, positions.
"""

from __future__ import annotations

import glob
import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from meshdeform_core.boundary.motions.motion import History, Step
from meshdeform_core.boundary.tables import Positions
from meshdeform_core.errors import CaseError, FormatError
from meshdeform_core.grid import FloatArray
from meshdeform_core.wording import counted, literal, vector

from ..files import LARGEST, require_regular

_EXPECTED = 'expected "START:STOP:STEP", like "0:1e-3:5e-5", or ascending numbers'
_MAXIMUM = 1_000_000


def parse_times(text: str, where: str) -> tuple[float, ...]:
    """``START:STOP:STEP`` (STOP included if the steps reach it) or numbers separated by commas."""
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
                yield from sequence_files(item, folder)
            else:
                yield from named_files(item, folder)


def sequence_files(value: str | list[str], folder: Path) -> list[Path]:
    """Files of a list of names, or of a pattern like ``surface_*.csv`` in the order of the numbers in their names."""
    if isinstance(value, str) and value and "\0" not in value:
        found = glob.glob(os.path.join(glob.escape(str(folder)), value))
        if not found:
            raise CaseError(f"no file matches {literal(value)} in {folder.absolute()}")
        # step9 before step10
        parts = {name: re.split(r"(\d+)", name) for name in found}
        numbers = {name: [(int(p), "") if p.isdigit() else (-1, p) for p in own] for name, own in parts.items()}
        return [Path(name) for name in sorted(found, key=numbers.__getitem__)]
    if not value or "\0" in "".join(value):
        raise CaseError(f'files = {literal(value)}; expected a pattern like "surface_*.csv" or a list of file names')
    return [folder / name for name in value]


def files_over_time(
    files: str | list[str], times: str | list[float] | None, folder: Path
) -> tuple[list[Path], tuple[float, ...]]:
    """Files, which must exist, and their times, one for each file."""
    paths = sequence_files(files, folder)
    for path in paths:
        if not path.is_file():
            raise CaseError(f"{path} does not exist")
    if times is None:
        raise CaseError(f"times: there are none; {_EXPECTED}")
    when = parse_times(times, "times") if isinstance(times, str) else _ascending(times, "times")
    if len(when) != len(paths):
        found = f"{len(paths)} files ({paths[0].name} to {paths[-1].name}) for {len(when)} times"
        raise CaseError(f"{found}; expected one time for each")
    return paths, when


_ROTATION_VECTOR = ("rx", "ry", "rz")
_WIENER_MILENKOVIC = ("cx", "cy", "cz")
_SAME_STATION = 1e-6
_LARGEST = 256 * 2**20
_MOST_POINTS = 100_000


def read_columns(path: Path, header: str) -> dict[str, FloatArray]:
    """Columns (n,) of a table by their names, in lower case; ``header`` is an example of its first line."""
    head, lines, rows = _read_rows(path)
    if not head and not lines:
        raise FormatError(f"{path} is empty; expected a header like {header} and rows of numbers")
    number, text = head[0] if head else (lines[0], " ".join(f"{value:g}" for value in rows[0]))
    names = [name.strip('"').lower() for name in _words(text.lstrip("# "))]
    if names[0] not in header.split(",") or len(set(names)) < len(names) or len(names) < 2:
        raise FormatError(f"{path}, line {number}: found {text[:60]!r}; expected a header like {header}")
    if not lines:
        raise FormatError(f"{path} has no rows of numbers below its header")
    if rows.shape[1] != len(names):
        raise FormatError(f"{path}, line {lines[0]}: found {rows.shape[1]} numbers; expected {len(names)}")
    return dict(zip(names, rows.T, strict=True))


def read_history(path: Path) -> dict[str, FloatArray]:
    """Columns (n,) by name of a table whose first column is the time ``t``, which ascends."""
    table = read_columns(path, "t,x,y,z")
    if next(iter(table)) != "t":
        raise FormatError(f"{path} has the columns {' '.join(table)[:60]}; expected a header like t,x,y,z")
    time = table["t"]
    back = np.flatnonzero(np.diff(time) <= 0)
    if back.size:
        raise FormatError(f"{path}: the times do not ascend: {time[back[0]]:g} before {time[back[0] + 1]:g}")
    return table


def history(table: Mapping[str, FloatArray], wanted: Sequence[str], path: Path) -> History | None:
    """The history of some columns; ``None`` if there are none of them."""
    found = [name for name in wanted if name in table]
    if not found:
        return None
    if len(found) < len(wanted):
        raise FormatError(f"{path} has the columns {', '.join(found)}; expected all of {', '.join(wanted)}")
    return History(table["t"], np.stack([table[name] for name in wanted], axis=1), str(path))


def read_beam(path: Path) -> Step:
    """Stations of a beam, undeformed, with displacement and rotation, in their order along the beam; for several times,
    column ``t``, the same stations at each."""
    from meshdeform_core.boundary.motions.histories import Beam

    table = read_columns(path, "t,x,y,z,dx,dy,dz,rx,ry,rz")
    found = [kind for kind in (_ROTATION_VECTOR, _WIENER_MILENKOVIC) if set(kind) & set(table)]
    wanted = {"x", "y", "z", "dx", "dy", "dz", *(found[0] if len(found) == 1 else ())}
    if len(found) != 1 or set(table) - {"t"} != wanted:
        raise FormatError(
            f"{path} has the columns {' '.join(table)}; expected x y z, dx dy dz, either rx ry rz (rotation vector, "
            "degrees) or cx cy cz (Wiener-Milenkovic parameters), and t if there are several times"
        )
    time = table.get("t", np.zeros(len(table["x"])))
    times, count = np.unique(time, return_counts=True)
    if (count != count[0]).any():
        odd = int(np.argmax(count != count[0]))
        raise FormatError(
            f"{path} has {counted(int(count[odd]), 'station')} at t = {times[odd]:g} but {count[0]} at {times[0]:g}; "
            "expected the same stations at all times"
        )
    order = np.argsort(time, kind="stable")
    point, displacement, turns = (
        np.stack([table[name][order] for name in kind], axis=1).reshape(len(times), -1, 3)
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
    moved = History(times, displacement.reshape(len(times), -1), str(path), "t" in table)
    return Beam.of(point[0], moved, turns)


def read_airfoil(path: Path) -> FloatArray:
    """Coordinates (n, 2) from the trailing edge over the upper side to the leading edge, and back.

    Selig's form has the points in this order; Lednicer's has the numbers of points of both sides first, and each side
    from the leading edge. Lines of text at the beginning are the name.
    """
    _, lines, points = _read_rows(path)
    if not 5 <= len(lines) <= _MOST_POINTS or points.shape[1] != 2:
        found = f"{len(lines)} rows" + (f" of {points.shape[1]} numbers" if lines else "")
        raise FormatError(f"{path} has {found}; expected an airfoil: x and y from the trailing edge on")
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
    """SU2's ``surface_positions.dat``: the number and the new coordinates of a point in each line."""
    _, lines, rows = _read_rows(path)
    if not lines:
        raise FormatError(f"{path} has no positions; expected lines of a number and coordinates")
    if rows.shape[1] not in (3, 4):
        raise FormatError(f"{path}, line {lines[0]}: found {rows.shape[1]} columns; expected number x y z (or x y)")
    numbers = rows[:, 0].astype(np.int64)
    if (numbers != rows[:, 0]).any():
        at = int(np.argmax(numbers != rows[:, 0]))
        raise FormatError(f"{path}, line {lines[at]}: {rows[at, 0]:g} is not the number of a point")
    points, first, which = np.unique(numbers, return_index=True, return_inverse=True)
    differs = (rows != rows[first[which.ravel()]]).any(axis=1)
    if differs.any():
        raise FormatError(f"{path}: point {numbers[np.argmax(differs)]} has two positions")
    return Positions(points, rows[first, 1:], str(path))


def _read_rows(path: Path) -> tuple[list[tuple[int, str]], list[int], FloatArray]:
    """Number and text of the lines of text at the beginning of a file; then its rows of numbers (n, m), and the line of
    each. Comments between rows are skipped."""
    require_regular(path)
    if path.stat().st_size > _LARGEST:
        raise FormatError(f"{path} is larger than any such table ({_LARGEST >> 20} MiB)")
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise FormatError(f"{path} is not UTF-8 text: {error}") from error
    head, lines, rows = list[tuple[int, str]](), list[int](), list[list[float]]()
    for number, line in enumerate(map(str.strip, text.splitlines()), start=1):
        if not line or (rows and line.startswith(("#", "%"))):
            continue
        if not rows and not re.match(r"[-+.\d]", line):
            head.append((number, line))
            continue
        try:
            rows.append([float(word) for word in _words(line)])
        except ValueError as error:
            raise FormatError(f"{path}, line {number}: {error}") from None
        lines.append(number)
        if len(rows[-1]) != len(rows[0]) or not all(abs(value) <= LARGEST for value in rows[-1]):
            expected = f"{len(rows[0])} finite numbers up to {LARGEST:g}"
            raise FormatError(f"{path}, line {number}: found {line[:60]!r}; expected {expected}")
    return head, lines, np.array(rows, dtype=np.float64)


def _words(line: str) -> list[str]:
    return [word for word in re.split(r"[,;\s]+", line) if word]
