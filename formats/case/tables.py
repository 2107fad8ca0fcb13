"""Text files that motions refer to: histories over time, beams, airfoil coordinates, positions."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from meshdeform_core.boundary.motions.histories import Beam, History
from meshdeform_core.boundary.motions.motion import Positions
from meshdeform_core.errors import FormatError
from meshdeform_core.grid import FloatArray
from meshdeform_core.wording import counted, vector

from ..files import require_regular
from ..plausible import LARGEST

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
    moved = History(times, displacement.reshape(len(times), -1), str(path))
    return Beam.of(point[0], moved, turns, timed)


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
    order = np.argsort(numbers, kind="stable")
    numbers, rows = numbers[order], rows[order]
    twice = np.flatnonzero((np.diff(numbers) == 0) & (np.diff(rows, axis=0) != 0).any(axis=1))
    if twice.size:
        raise FormatError(f"{path}: point {numbers[twice[0]]} has two positions")
    first = np.concatenate([[True], np.diff(numbers) > 0])
    return Positions(numbers[first], rows[first, 1:], str(path))


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
