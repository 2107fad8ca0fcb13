"""Motions defined by TOML tables: free-form deformation, rigid bodies from files, modes, airfoils, positions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import permutations, product
from pathlib import Path
from typing import Any

import numpy as np

from meshdeform_core.boundary.motions.histories import History, Modes, RigidHistory
from meshdeform_core.boundary.motions.lattice import ControlMove, Lattice
from meshdeform_core.boundary.motions.motion import Step
from meshdeform_core.boundary.motions.numbered import FollowNumbers
from meshdeform_core.boundary.motions.section import Airfoil
from meshdeform_core.boundary.tables.matching import Matching, SurfaceData
from meshdeform_core.errors import FormatError
from meshdeform_core.grid import FloatArray, Grid, IntArray
from meshdeform_core.wording import literal

from ..displacement import read_displacement
from ..displacement.structural import read_shapes
from .sequences import files_over_time, sequence_files
from .tables import columns, read_airfoil, read_history, read_positions
from .values import Table, check_keys, fail, file_of, formula_of, number_of, three_of

_MOST_CONTROLS = 10_000
_TURNS = ("rx", "ry", "rz")
_QUATERNION = ("qx", "qy", "qz", "qw")
_EULER = {"".join(axes) for axes in permutations("xyz")}


def _ffd(value: Any, known: Sequence[str], folder: Path, where: str) -> Step:
    where = f"{where}, ffd"
    table = _table(value, ("origin", "edges", "points", "move"), where)
    origin, edges = _vector(table.get("origin"), f"{where}: origin"), table.get("edges")
    frame = np.array([_vector(edge, f"{where}: edges") for edge in three_of(edges, f"{where}: edges")])
    if not abs(np.linalg.det(frame)) > 1e-12 * float(np.prod(np.linalg.norm(frame, axis=1))):
        raise fail(
            where, f"edges = {literal(edges)} span no volume; expected three directions, like [[1,0,0],[0,1,0],[0,0,1]]"
        )
    counts = three_of(table.get("points"), f"{where}: points")
    if any(not isinstance(n, int) or isinstance(n, bool) or n < 2 for n in counts) or np.prod(counts) > _MOST_CONTROLS:
        raise fail(
            where, f"points = {literal(counts)}; expected three numbers of control points of at least 2 along each edge"
        )
    moves = table.get("move")
    if not isinstance(moves, list) or not moves:
        raise fail(where, 'expected move = [{ at = [2, "*", 2], by = [0, 0, 0.1] }, ...]')
    ni, nj, nk = counts
    parts = tuple(_control(move, (ni, nj, nk), known, f"{where}, move {n}") for n, move in enumerate(moves, start=1))
    return Lattice(origin, frame, (ni, nj, nk), parts)


def _control(value: Any, counts: tuple[int, int, int], known: Sequence[str], where: str) -> ControlMove:
    table = _table(value, ("at", "by"), where)
    choices = [
        _numbers(entry, count, where) for entry, count in zip(three_of(table.get("at"), where), counts, strict=True)
    ]
    formulas = [name for name in known if name not in ("x", "y", "z")]
    x, y, z = (formula_of(part, formulas, f"{where}: by") for part in three_of(table.get("by"), f"{where}: by"))
    points: IntArray = np.array(list(product(*choices)), dtype=np.int64)
    return ControlMove(points, (x, y, z))


def _numbers(entry: Any, count: int, where: str) -> range:
    if entry == "*":
        return range(count)
    if not isinstance(entry, int) or isinstance(entry, bool) or not 1 <= entry <= count:
        raise fail(where, f'at: found {literal(entry)}; expected a control point from 1 to {count}, or "*" for all')
    return range(entry - 1, entry)


def _rigid(value: Any, known: Sequence[str], folder: Path, where: str) -> Step:
    """A table with t, x y z (translation) and rx ry rz (angles) or qx qy qz qw (quaternion)."""
    where = f"{where}, rigid"
    table = _table(value, ("file", "order", "center"), where)
    path = file_of(table.get("file"), folder, f"{where}: file")
    names, values = read_history(path)
    strange = [name for name in names if name not in ("t", "x", "y", "z", *_TURNS, *_QUATERNION)]
    if strange:
        raise fail(where, f"{path} has a column {strange[0]!r}; known are t x y z, rx ry rz and qx qy qz qw")
    angles, quaternions = (columns(names, values, wanted, str(path)) for wanted in (_TURNS, _QUATERNION))
    order = table.get("order", "")
    if angles is not None and quaternions is not None:
        raise fail(where, f"{path} has angles and quaternions; expected one of them")
    if (
        (angles is not None) != bool(order)
        or not isinstance(order, str)
        or (order and order.lower() not in _EULER)
        or (order not in (order.lower(), order.upper()))
    ):
        raise fail(
            where,
            f"order = {literal(order)}; expected, only for angles rx ry rz in degrees, the sequence of axes: "
            '"xyz" about the fixed axes, "XYZ" about those of the body',
        )
    if quaternions is not None:
        _require_turns(quaternions, path)
    shift = columns(names, values, ("x", "y", "z"), str(path))
    if angles is not None:
        # The first angle belongs to the first axis of the order.
        at = ["xyz".index(axis) for axis in order.lower()]
        angles = History(angles.times, angles.values[:, at], angles.label)
    center = _vector(table.get("center", [0, 0, 0]), f"{where}: center")
    still = History(values[:, 0], np.zeros((len(values), 3)), str(path))
    return RigidHistory(shift or still, angles if angles is not None else quaternions, order, tuple(center.tolist()))


def _require_turns(quaternions: History, path: Path) -> None:
    size = np.linalg.norm(quaternions.values, axis=1)
    off = np.flatnonzero(np.abs(size - 1) > 1e-3)
    if off.size:
        raise FormatError(
            f"{path}: the quaternion at t = {quaternions.times[off[0]]:g} has the length {size[off[0]]:.6g}; expected 1"
        )


def modes_of(value: Any, matching: Matching, known: Sequence[str], folder: Path, where: str) -> Step:
    """Shapes from displacement tables, amplitudes as formulas or from a table with t and a column for each shape."""
    where = f"{where}, modes"
    table = _table(value, ("files", "file", "geometry", "shapes", "amplitudes"), where)
    shapes = _shapes(table, folder, where)
    given = table.get("amplitudes")
    if isinstance(given, list):
        if len(given) != len(shapes):
            raise fail(where, f"{len(given)} amplitudes for {len(shapes)} shapes; expected one for each")
        formulas = [name for name in known if name not in ("x", "y", "z")]
        return Modes(shapes, tuple(formula_of(part, formulas, f"{where}: amplitudes") for part in given), matching)
    path = file_of(_table(given, ("file",), f"{where}: amplitudes").get("file"), folder, f"{where}: amplitudes")
    names, values = read_history(path)
    if len(names) != len(shapes) + 1:
        raise fail(
            where, f"{path} has {len(names) - 1} columns beside t for {len(shapes)} shapes; expected one for each"
        )
    return Modes(shapes, History(values[:, 0], values[:, 1:], str(path)), matching)


def _shapes(table: Table, folder: Path, where: str) -> tuple[SurfaceData | Grid, ...]:
    """One shape per file, or some of those in a result file of a structural solver."""
    if ("file" in table) == ("files" in table) or ("files" in table and {"geometry", "shapes"} & set(table)):
        raise fail(
            where, f"found {sorted(table)}; expected files, with one shape each, or file, with shapes and geometry"
        )
    if "files" in table:
        return tuple(read_displacement(path) for path in sequence_files(table["files"], folder, where))
    geometry = file_of(table["geometry"], folder, f"{where}: geometry") if "geometry" in table else None
    path = file_of(table["file"], folder, f"{where}: file")
    found = read_shapes(path, geometry)
    chosen = table.get("shapes", list(range(1, len(found) + 1)))
    known = range(1, len(found) + 1)
    if not isinstance(chosen, list) or not chosen or any(isinstance(n, bool) or n not in known for n in chosen):
        raise fail(where, f"shapes = {literal(chosen)}; expected numbers from 1 to {len(found)}, which {path} has")
    return tuple(found[int(n) - 1] for n in chosen)


def _airfoil(value: Any, known: Sequence[str], folder: Path, where: str) -> Step:
    where = f"{where}, airfoil"
    table = _table(value, ("file", "plane", "fit"), where)
    plane, fit = table.get("plane", "xy"), table.get("fit", "chord")
    if not isinstance(plane, str) or sorted(plane) not in (["x", "y"], ["x", "z"], ["y", "z"]):
        raise fail(where, f'plane = {literal(plane)}; expected the axes along the chord and upwards, like "xy" or "xz"')
    if fit not in ("chord", "none"):
        raise fail(
            where, f'fit = {literal(fit)}; expected "chord" (leading and trailing edge stay) or "none" (as in the file)'
        )
    path = file_of(table.get("file"), folder, f"{where}: file")
    axes = ("xyz".index(plane[0]), "xyz".index(plane[1]))
    return Airfoil(read_airfoil(path), axes, fit == "chord", str(path))


def _positions(value: Any, known: Sequence[str], folder: Path, where: str) -> Step:
    """Positions by number: one file, or several with their times."""
    where = f"{where}, positions"
    table = _table(value, ("file", "files", "times"), where)
    if ("file" in table) == ("files" in table) or ("files" in table) != ("times" in table):
        raise fail(where, f"found {sorted(table)}; expected file, or files and times")
    if "file" in table:
        data = read_positions(file_of(table["file"], folder, f"{where}: file"))
        return FollowNumbers((), lambda number: data)
    paths, times = files_over_time(table["files"], table["times"], folder, where)
    return FollowNumbers(times, lambda number: read_positions(paths[number]))


def _table(value: Any, known: Sequence[str], where: str) -> Table:
    if not isinstance(value, dict):
        raise fail(where, f"found {literal(value)}; expected a table with {', '.join(known)}")
    check_keys(value, known, where)
    return value


def _vector(value: Any, where: str) -> FloatArray:
    return np.array([number_of(part, where) for part in three_of(value, where)])


WITHOUT_MATCHING: dict[str, Callable[[Any, Sequence[str], Path, str], Step]] = {
    "ffd": _ffd, "rigid": _rigid, "airfoil": _airfoil, "positions": _positions,
}  # fmt: skip
"""Readers of the motions that need no matching, by name."""
