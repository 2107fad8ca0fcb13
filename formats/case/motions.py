"""The motions of a case file: what each table may contain, and the step of the core that it becomes.

To add a motion: a form with ``step``, a field of :class:`MotionStep` with the form as its type.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations, product
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import numpy as np
from msgspec import Meta

from meshdeform_core.boundary.motions.expression import Expression, expression
from meshdeform_core.boundary.motions.motion import Displace, Follow, History, Rotate, Step
from meshdeform_core.boundary.tables import Matching, SurfaceData
from meshdeform_core.errors import CaseError, FormatError
from meshdeform_core.grid import Grid, IntArray
from meshdeform_core.wording import literal

from .forms import File, Form, Formula, Three, ThreeNumbers, about, placed
from .tables import files_over_time, history, read_airfoil, read_beam, read_history, read_positions, sequence_files

_MOST_CONTROLS = 10_000
_SHIFT, _TURNS = ("x", "y", "z"), ("rx", "ry", "rz")
_QUATERNION = ("qx", "qy", "qz", "qw")
_ORDERS = [order for axes in permutations("xyz") for order in ("".join(axes), "".join(axes).upper())]
_FILE = "a file name: "
_LETTERS = "abcdefghijklmnopqrstuvwxyz_-"
_Whole = Annotated[int, Meta(ge=1)]
_TwoOrMore = Annotated[int, Meta(ge=2)]
_Index = int | Literal["*"]
_Files = Annotated[File | list[File] | None, about('a pattern like "surface_*.csv" or a list of file names')]
_Times = Annotated[str | list[float] | None, about('"START:STOP:STEP", like "0:1e-3:5e-5", or ascending numbers')]


@dataclass(frozen=True)
class Context:
    """What a motion needs beside its own table: names that its formulas may use, the folder of the case file, and how
    tables are matched."""

    names: tuple[str, ...]
    folder: Path
    matching: Matching

    def formula(self, value: Any, of_time: bool = False) -> Expression:
        """A formula of the names, or of those that are the same for all nodes."""
        return expression(value, [name for name in self.names if not (of_time and name in ("x", "y", "z"))])

    def three(self, values: Three, of_time: bool = False) -> tuple[Expression, Expression, Expression]:
        x, y, z = (self.formula(value, of_time) for value in values)
        return x, y, z


class RotateForm(Form):
    """Rotation about an axis."""

    angle: Annotated[float | str, about("degrees: a number or a formula in quotes")]
    axis: Annotated[ThreeNumbers, about("three values: the direction of the axis")] = (0.0, 0.0, 1.0)
    center: Annotated[Three, about("three values or formulas: a point on the axis")] = (0.0, 0.0, 0.0)

    def step(self, context: Context) -> Step:
        x, y, z = self.axis
        if not any(self.axis):
            raise CaseError("axis = [0, 0, 0] has no direction")
        return Rotate(context.formula(self.angle), (x, y, z), context.three(self.center))


class ControlForm(Form):
    """Control points and their displacement."""

    at: Annotated[tuple[_Index, _Index, _Index], about('three values: numbers from 1, or "*" for all')]
    by: Annotated[Three, about("three values or formulas of t: the displacement")]


class LatticeForm(Form):
    """Free-form deformation: a box of control points carries along the nodes inside it."""

    origin: Annotated[ThreeNumbers, about("three values: a corner of the box")]
    edges: Annotated[tuple[ThreeNumbers, ThreeNumbers, ThreeNumbers], about("three directions of three values")]
    points: Annotated[
        tuple[_TwoOrMore, _TwoOrMore, _TwoOrMore],
        about("three numbers of control points along the edges, at least 2"),
    ]
    move: Annotated[list[ControlForm], Meta(min_length=1), about('move = [{ at = [2, "*", 2], by = [0, 0, 0.1] }]')]

    def step(self, context: Context) -> Step:
        from meshdeform_core.boundary.motions.shapes import ControlMove, Lattice

        frame = np.array(self.edges)
        if not abs(np.linalg.det(frame)) > 1e-12 * float(np.prod(np.linalg.norm(frame, axis=1))):
            raise CaseError(f"edges = {literal(self.edges)} span no volume; expected three directions")
        ni, nj, nk = self.points
        if ni * nj * nk > _MOST_CONTROLS:
            raise CaseError(f"points = {literal(self.points)}; expected at most {_MOST_CONTROLS:,} control points")
        moves = []
        for number, move in enumerate(self.move, start=1):
            chosen = []
            for entry, count in zip(move.at, self.points, strict=True):
                if isinstance(entry, int) and not 1 <= entry <= count:
                    raise CaseError(
                        f'move {number}, at: found {entry}; expected a control point from 1 to {count}, or "*" for all'
                    )
                chosen.append(range(count) if isinstance(entry, str) else range(entry - 1, entry))
            points: IntArray = np.array(list(product(*chosen)), dtype=np.int64)
            moves.append(ControlMove(points, context.three(move.by, of_time=True)))
        return Lattice(np.array(self.origin), frame, (ni, nj, nk), tuple(moves))


class RigidForm(Form):
    """A rigid body with six degrees of freedom."""

    file: Annotated[File, about(_FILE + "a table with t, x y z, and rx ry rz (degrees) or qx qy qz qw")]
    order: Annotated[str, about('axes of the angles: "xyz" fixed, "XYZ" of the body', enum=["", *_ORDERS])] = ""
    center: Annotated[ThreeNumbers, about("three values: the point about which it turns")] = (0.0, 0.0, 0.0)

    def step(self, context: Context) -> Step:
        from meshdeform_core.boundary.motions.histories import RigidHistory

        path = context.folder / self.file
        table = read_history(path)
        if strange := [name for name in table if name not in ("t", *_SHIFT, *_TURNS, *_QUATERNION)]:
            raise CaseError(f"{path} has a column {strange[0]!r}; known are t x y z, rx ry rz and qx qy qz qw")
        shift, angles, quaternions = (history(table, wanted, path) for wanted in (_SHIFT, _TURNS, _QUATERNION))
        if angles is not None and quaternions is not None:
            raise CaseError(f"{path} has angles and quaternions; expected one of them")
        if (angles is not None) != bool(self.order) or (self.order and self.order not in _ORDERS):
            raise CaseError(
                f"order = {literal(self.order)}; expected, only for angles rx ry rz in degrees, the sequence of axes: "
                '"xyz" about the fixed axes, "XYZ" about those of the body'
            )
        if quaternions is not None:
            size = np.linalg.norm(quaternions.values, axis=1)
            if (off := np.flatnonzero(np.abs(size - 1) > 1e-3)).size:
                time, length = quaternions.times[off[0]], size[off[0]]
                raise FormatError(f"{path}: the quaternion at t = {time:g} has the length {length:.6g}; expected 1")
        if angles is not None:
            # The first angle belongs to the first axis of the order.
            places = ["xyz".index(axis) for axis in self.order.lower()]
            angles = History(angles.times, angles.values[:, places], angles.label)
        still = History(table["t"], np.zeros((len(table["t"]), 3)), str(path))
        x, y, z = self.center
        return RigidHistory(shift or still, angles if angles is not None else quaternions, self.order, (x, y, z))


class AmplitudesForm(Form):
    """A table of amplitudes."""

    file: Annotated[File, about(_FILE + "a table with t and a column for each shape, like q1")]


class ModesForm(Form):
    """A sum of shapes, each times its amplitude."""

    amplitudes: Annotated[list[Formula] | AmplitudesForm, about("formulas of t, one for each shape, or { file = ... }")]
    files: _Files = None
    file: Annotated[File | None, about(_FILE + "a result of CalculiX (.frd) with shapes")] = None
    shapes: Annotated[list[_Whole] | None, about("numbers of the shapes in the file")] = None

    def step(self, context: Context) -> Step:
        from meshdeform_core.boundary.motions.histories import Modes

        labels, shapes = self._shapes(context)
        if isinstance(self.amplitudes, list):
            if len(self.amplitudes) != len(shapes):
                raise CaseError(f"{len(self.amplitudes)} amplitudes for {len(shapes)} shapes; expected one for each")
            return Modes(shapes, tuple(context.formula(part, True) for part in self.amplitudes), context.matching)
        path = context.folder / self.amplitudes.file
        names, values = zip(*read_history(path).items(), strict=True)
        # A column is called like the file of its shape or by its number (q2, mode_2, 2); of one shape it is any.
        order = [1] if len(names) == 2 and len(labels) == 1 else list[int]()
        for number, name in labels if not order else ():
            numbered = [column for column in names[1:] if column.lstrip(_LETTERS) == str(number)]
            found = [column for column in names[1:] if name and column == name] or numbered
            if len(found) != 1:
                which = f"of which {len(found) or 'none'} belong to shape {number}"
                expected = f"expected one called q{number}{f' or {name}' if name else ''}"
                raise FormatError(f"{path} has the columns {' '.join(names)}, {which}; {expected}")
            order.append(names.index(found[0]))
        amplitudes = np.stack([values[column] for column in order], axis=1)
        return Modes(shapes, History(values[0], amplitudes, str(path)), context.matching)

    def _shapes(self, context: Context) -> tuple[list[tuple[int, str]], tuple[SurfaceData | Grid, ...]]:
        """Number and name of each shape, and the shapes: one per file, or some of those in a result file."""
        if (self.file is None) == (self.files is None) or (self.file is None and self.shapes is not None):
            raise CaseError(f"found {self.given()}; expected files, with one shape each, or file, with shapes")
        if self.files is not None:
            from ..displacement import read_displacement

            paths = sequence_files(self.files, context.folder)
            labels = [(number, path.stem.lower()) for number, path in enumerate(paths, start=1)]
            return labels, tuple(read_displacement(path) for path in paths)
        from ..displacement.frd import read_shapes

        found = read_shapes(path := context.folder / str(self.file))
        chosen = list(range(1, len(found) + 1)) if self.shapes is None else self.shapes
        if max(chosen) > len(found):
            raise CaseError(f"shapes = {literal(chosen)}; expected numbers from 1 to {len(found)}, which {path} has")
        return [(number, "") for number in chosen], tuple(found[number - 1] for number in chosen)


class AirfoilForm(Form):
    """A new shape of an airfoil."""

    file: Annotated[File, about(_FILE + "coordinates in Selig's or Lednicer's form")]
    plane: Annotated[
        Literal["xy", "xz", "yx", "yz", "zx", "zy"], about('the axes along the chord and upwards, like "xy" or "xz"')
    ] = "xy"
    fit: Annotated[Literal["chord", "none"], about('"chord" (leading and trailing edge stay) or "none"')] = "chord"

    def step(self, context: Context) -> Step:
        from meshdeform_core.boundary.motions.shapes import Airfoil

        path, (along, upwards) = context.folder / self.file, self.plane
        axes = ("xyz".index(along), "xyz".index(upwards))
        return Airfoil(read_airfoil(path), axes, self.fit == "chord", str(path))


class PositionsForm(Form):
    """New positions by the numbers of the points, like SU2's surface_positions.dat: one file, or several with times."""

    file: Annotated[File | None, about(_FILE + "lines of a number and coordinates")] = None
    files: _Files = None
    times: _Times = None

    def step(self, context: Context) -> Step:
        if self.given() not in (["file"], ["files", "times"]):
            raise CaseError(f"found {self.given()}; expected file, or files and times")
        if self.files is None:
            return Follow(read_positions(context.folder / str(self.file)), Matching("exact"))
        paths, times = files_over_time(self.files, self.times, context.folder)
        return Follow(lambda number: read_positions(paths[number]), Matching("exact"), times)


_How = Literal["exact", "nearest", "interpolate"]
_ALSO = {"file": ("match", "tolerance"), "files": ("times", "match", "tolerance"), "modes": ("match", "tolerance")}


class MotionStep(Form):
    """One motion; a table has match and tolerance, several tables their times."""

    rotate: Annotated[RotateForm | None, about("{ angle = degrees, axis = [..], center = [..] }")] = None
    translate: Annotated[Three | None, about("three values: numbers or formulas")] = None
    displace: Annotated[Three | None, about("three values: numbers or formulas of x, y, z, t")] = None
    file: Annotated[Any, about(_FILE + "a displacement table", type="string")] = None
    files: _Files = None
    ffd: LatticeForm | None = None
    rigid: RigidForm | None = None
    modes: ModesForm | None = None
    airfoil: AirfoilForm | None = None
    positions: PositionsForm | None = None
    beam: Annotated[File | None, about(_FILE + "stations with x y z, dx dy dz, and rx ry rz or cx cy cz")] = None
    times: _Times = None
    match: Annotated[_How | None, about(f"one of {', '.join(get_args(_How))}")] = None
    tolerance: Annotated[float | None, about("a finite number: the largest distance of a match")] = None

    def step(self, names: tuple[str, ...], folder: Path) -> Step:
        """The step of the core; ``names`` may be used in formulas."""
        given = self.given()
        kinds = [name for name in given if name in KINDS]
        if len(kinds) != 1:
            raise CaseError(f"found {given}; expected exactly one of {', '.join(KINDS)}")
        (kind,) = kinds
        if beside := [name for name in given if name not in (kind, *_ALSO.get(kind, ()))]:
            raise CaseError(f"{kind} takes no {beside[0]}")
        value, context = getattr(self, kind), Context(names, folder, Matching(self.match or "nearest", self.tolerance))
        if isinstance(value, Form):
            with placed(kind):
                return value.step(context)  # type: ignore[attr-defined]
        if kind == "displace" or kind == "translate":
            return Displace(context.three(value))
        if kind == "beam":
            return read_beam(folder / value)
        from ..displacement import read_displacement

        if kind == "files":
            paths, times = files_over_time(value, self.times, folder)
            return Follow(lambda number: read_displacement(paths[number]), context.matching, times)
        if not isinstance(value, SurfaceData | str) or value == "" or "\0" in str(value):
            raise CaseError(f"file: expected a file name, found {literal(value)}")
        data = value if isinstance(value, SurfaceData) else read_displacement(folder / value)
        return Follow(data, context.matching)


KINDS = tuple(name for name in MotionStep.__struct_fields__ if name not in ("times", "match", "tolerance"))
"""The motions by name; each step has exactly one."""
