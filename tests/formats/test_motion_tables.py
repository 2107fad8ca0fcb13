"""Tables of motions and motions of a case: columns by name; what is wrong is named, with its line."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from meshdeform_core.boundary.motions.expression import Expression
from meshdeform_core.boundary.motions.motion import History, Step
from meshdeform_core.boundary.tables import Matching, Positions, SurfaceData
from meshdeform_core.errors import CaseError, FormatError
from meshdeform_formats.case import case_of
from meshdeform_formats.case.tables import read_airfoil, read_beam, read_history, read_positions


def step_of(folder: Path, **motion: Any) -> Step:
    (spec,) = case_of({"constants": {"c": 2}, "boundary": [{"motion": motion}]}, folder).case.boundaries
    (step,) = spec.motion.steps
    return step


def test_bodies_take_their_columns_by_name(tmp_path):
    path = tmp_path / "m.csv"
    path.write_text('"T" RZ;rx, Y x z ry\n\n0 1 2 3 4 5 6\n% between\n+1 7 8 9 10 11 12\n')
    turns = {"x": [2, 8], "y": [6, 12], "z": [1, 7]}
    for order in ("zyx", "YXZ", "xzy"):
        found = step_of(tmp_path, rigid={"file": "m.csv", "order": order, "center": [1, 2, 3]})
        assert (found.order, found.center, found.translation.label) == (order, (1.0, 2.0, 3.0), str(path))
        np.testing.assert_array_equal(found.translation.times, [0, 1])
        np.testing.assert_array_equal(found.translation.values, [[4, 3, 5], [10, 9, 11]])
        np.testing.assert_array_equal(found.rotation.values, np.transpose([turns[axis] for axis in order.lower()]))
    path.write_text("t,qw,qx,qy,qz\n0,1,0,0,0\n1,0,.6,0.8,0\n")
    found = step_of(tmp_path, rigid={"file": "m.csv"})
    np.testing.assert_allclose(found.rotation.values, [[0, 0, 0, 1], [0.6, 0.8, 0, 0]], rtol=1e-14)


FILES = {
    "selig.dat": "name\n1 0\n.5 .2\n0 0\n.5 -.1\n1 .01\n", "backwards.dat": "1 .01\n.5 -.1\n0 0\n.5 .2\n1 0\n",
    "lednicer.dat": "name\n3. 3.\n\n0 0\n.5 .2\n1 0\n\n0 0\n.5 -.1\n1 .01\n", "p1.dat": "7 1 2 3\n2 4 5 6\n",
    "p2.dat": "7 3 2 1\n", "s1.csv": "0,0,0,1,0,0\n", "s2.csv": "0,0,0,2,0,0\n", "one.csv": "t,any\n0,1\n1,2\n",
    "a.csv": "t,s2,q1\n0,1,2\n1,3,4\n",
}  # fmt: skip


def plain(value: Any) -> Any:
    """Formulas as texts, arrays as lists, tables by what they hold, functions by two of their values."""
    for kind, name in ((Expression, "text"), (SurfaceData, "displacement"), (History, "values")):
        value = getattr(value, name) if isinstance(value, kind) else value
    if isinstance(value, Positions):
        return dict(zip(value.numbers.tolist(), value.positions.tolist(), strict=True))
    if dataclasses.is_dataclass(value) and not isinstance(value, Matching):
        return {field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, list | tuple) or callable(value):
        return [plain(each) for each in (map(value, (0, 1)) if callable(value) else value)]
    return getattr(value, "tolist", lambda: value)()


FOIL = {"outline": [[1, 0], [0.5, 0.2], [0, 0], [0.5, -0.1], [1, 0.01]], "axes": [0, 1], "fitted": True}
LATTICE = {"origin": [1, 2, 3], "edges": [[1, 0, 0], [0, 0, 2], [0, 1, 0]]}
MOVES = [{"at": [2, "*", 1], "by": ["t", 0, "c"]}, {"at": [3, 4, 2], "by": [1, 2, 3]}]
MOVED = [{"points": [[1, n, 0] for n in range(4)], "vector": ["t", "0.0", "c"]},
         {"points": [[2, 3, 1]], "vector": ["1.0", "2.0", "3.0"]}]  # fmt: skip
EXACT, FIRST = Matching("exact"), {7: [1, 2, 3], 2: [4, 5, 6]}
SHAPES, TWO = {"files": ["s1.csv", "s2.csv"]}, [[[1, 0, 0]], [[2, 0, 0]]]
BECOME = [
    ({"rotate": {"angle": "c*t", "axis": [0, 1, 2], "center": [0, "c", 1]}},
     {"angle": "c*t", "axis": [0, 1, 2], "center": ["0.0", "c", "1.0"]}),
    ({"displace": ["x", "c", 1]}, {"vector": ["x", "c", "1.0"]}),
    *(({"airfoil": {"file": f"{name}.dat"}}, FOIL) for name in ("selig", "backwards", "lednicer")),
    ({"airfoil": {"file": "selig.dat", "plane": "zx", "fit": "none"}}, FOIL | {"axes": [2, 0], "fitted": False}),
    # The edges are left-handed.
    ({"ffd": LATTICE | {"points": [3, 4, 2], "move": MOVES}}, LATTICE | {"counts": [3, 4, 2], "moves": MOVED}),
    ({"positions": {"file": "p1.dat"}}, {"times": [], "matching": EXACT, "data": FIRST}),
    ({"positions": {"files": "p*.dat", "times": "1:2:1"}},
     {"times": [1, 2], "matching": EXACT, "data": [FIRST, {7: [3, 2, 1]}]}),
    ({"modes": SHAPES | {"amplitudes": ["c*t", 2]}},
     {"shapes": TWO, "amplitudes": ["c*t", "2.0"], "matching": Matching("nearest")}),
    ({"modes": SHAPES | {"amplitudes": {"file": "a.csv"}}, "match": "exact", "tolerance": 0.5},
     {"shapes": TWO, "matching": Matching("exact", 0.5), "amplitudes": [[2, 1], [4, 3]]}),
    ({"modes": {"files": "s1.*", "amplitudes": {"file": "one.csv"}}}, {"amplitudes": [[1], [2]]}),
]  # fmt: skip


@pytest.mark.parametrize(("motion", "expected"), BECOME)
def test_what_motions_become(motion, expected, tmp_path):
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    found = plain(step_of(tmp_path, **motion))
    assert {name: found[name] for name in expected} == expected


@pytest.mark.parametrize("names", ["rx,ry,rz", "cx,cy,cz"])
def test_a_beam_has_its_stations_at_every_time(names, tmp_path):
    """Rows sorted by station, not by time; the first station turns about none, so that the others are as given."""
    turns = np.array([[[0, 0, 0], [0.3, 0, 0]], [[0, 0, 0], [0.4, -0.5, 0.7]], [[0, 0, 0], [0, 0, 0]]])
    moves = np.arange(18.0).reshape(3, 2, 3)
    size = np.linalg.norm(turns, axis=2, keepdims=True)
    given = np.degrees(turns) if names[0] == "r" else 4 * np.tan(size / 4) * turns / np.where(size > 0, size, 1)
    rows = [[t, 0, 0, 2 * s, *moves[t, s], *given[t, s]] for s in (0, 1) for t in (2, 0, 1)]
    np.savetxt(tmp_path / "b.csv", rows, "%.17g", delimiter=",", header=f"t,x,y,z,dx,dy,dz,{names}", comments="")
    found = step_of(tmp_path, beam="b.csv")
    np.testing.assert_array_equal(found.stations, [[0, 0, 0], [0, 0, 2]])
    np.testing.assert_array_equal(found.first.translation.values, moves[:, 0])
    seen = np.concatenate([moves - moves[:, :1], turns], axis=2).reshape(3, 12)
    np.testing.assert_allclose(found.shape.values, seen, rtol=0, atol=1e-14)
    assert (found.shape.times.tolist(), found.shape.timed) == ([0, 1, 2], True)


READERS = {"history": read_history, "beam": read_beam, "positions": read_positions, "airfoil": read_airfoil}
BEAM = "x,y,z,dx,dy,dz,rx,ry,rz"
ZEROS = ",0,0,0,0,0,0"
BAD_TABLES = [
    ("history", "", "FILE is empty; expected a header like t,x,y,z"),
    ("history", "time,x\n0,0\n", "FILE, line 1: found 'time,x'; expected a header"),
    ("history", "t,x\n\n1,0,0\n", "FILE, line 3: found 3 numbers; expected 2"),
    ("history", "t,x\n0,0\n# a\n1,0,0\n", "FILE, line 4: found '1,0,0'; expected 2 finite numbers up to 1e+30"),
    ("history", "t,x\n0,nan\n", "line 2: found '0,nan'"), ("history", "t,x\n0,-1.1e30\n", "line 2: found '0,-1.1e30'"),
    ("history", "t,x\n0,0\n2,0\n2,0\n1,0\n", "FILE: the times do not ascend: 2 before 2"),
    ("beam", f"{BEAM[:-9]}\n0,0,0,0,0,0\n", "has the columns x y z dx dy dz; expected x y z, dx dy dz, either rx"),
    ("beam", f"{BEAM},cx,cy,cz\n0,0,0,0,0,0{ZEROS}\n", "rx ry rz cx cy cz; expected"),
    ("beam", f"t,{BEAM}\n0,0,0,0{ZEROS}\n0,0,0,1{ZEROS}\n1,0,0,0{ZEROS}\n", "1 station at t = 1 but 2 at 0"),
    ("beam", f"t,{BEAM}\n0,0,0,0{ZEROS}\n1,0,0,0{ZEROS}\n1,0,0,1{ZEROS}\n", "2 stations at t = 1 but 1 at 0"),
    ("beam", f"t,{BEAM}\n" + "".join(f"{t},0,0,{s + t * s}{ZEROS}\n" for t in (0, 3) for s in (0, 1)),
     "FILE: station 2 is (0, 0, 4) at t = 3 and (0, 0, 1) at 0; expected its undeformed position"),
    ("positions", "x\n0 0 0 0 0\n", "FILE, line 2: found 5 columns; expected number x y z (or x y)"),
    ("positions", "2 0 0\n\n1.5 0 0\n2.5 0 0\n", "FILE, line 3: 1.5 is not the number of a point"),
    ("positions", "0 0 0\n5 0 0\n5 0 1\n6 0 0\n6 1 0\n", "FILE: point 5 has two positions"),
    ("airfoil", "3 3\n0 0\n1 1\n2 0\n0 .1\n1 -1\n2 0\n", "its sides begin at (0, 0) and (0, 0.1); expected one nose"),
]  # fmt: skip


@pytest.mark.parametrize(("reader", "text", "message"), BAD_TABLES)
def test_tables_are_checked(reader, text, message, tmp_path):
    path = tmp_path / "table.dat"
    path.write_text(text)
    with pytest.raises(FormatError) as error:
        READERS[reader](path)
    assert message in str(error.value).replace(str(path), "FILE")


BOX = {"origin": [0, 0, 0], "edges": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "points": [3, 4, 2]}
MOVE = [{"at": [1, 1, 1], "by": [0, 0, 0]}]
ORDER = "order = '{}'; expected, only for angles rx ry rz in degrees"
TURNED = "t,qx,qy,qz,qw\n0,0,0,0,1\n1,0,0,0,1.0009\n2,0,0,0,1.0011\n3,0,0,0,4\n"
RIGID = {"file": "m.csv"}
BAD_MOTIONS = [
    ({"rotate": {"angle": 1, "axis": [0, 0, 0]}}, "", "motion step 1: rotate: axis = [0, 0, 0] has no direction"),
    *(({"ffd": BOX | {"move": MOVE} | change}, "", f"boundary 'boundary 1': motion{message}") for change, message in (
        ({"edges": [[1, 0, 0], [2, 0, 0], [0, 0, 1]]}, " step 1: ffd: edges = [[1.0, 0.0, 0.0], [2.0, 0.0, 0.0]"),
        ({"points": [1, 2, 2]}, ".ffd.points = [1, 2, 2]; expected"), ({"move": []}, ".ffd.move = []; expected move"),
        ({"origin": [0, 0]}, ".ffd.origin = [0, 0]; expected three values: a corner of the box"),
    )),
    *(({"ffd": BOX | {"move": [*MOVE, {"at": at, "by": [0, 0, 0]}]}}, "", f"move 2{message}") for at, message in (
        ([1, True, 1], ": at = [1, true, 1]; expected three values: numbers from 1"),
        ([4, 1, 1], ", at: found 4; expected a control point from 1 to 3"), ([1, 0, "*"], ", at: found 0; expected a "),
    )),
    ({"rigid": RIGID}, "t,x,y,z,w\n0,0,0,0,0\n", "rigid: FILE has a column 'w'; known are t x y z"),
    ({"rigid": RIGID}, "t,rx,ry,rz,qx,qy,qz,qw\n0,0,0,0,0,0,0,0\n", "has angles and quaternions; expected one"),
    ({"rigid": RIGID}, "t,rx,ry,rz\n0,0,0,0\n", ORDER.format("")),
    ({"rigid": RIGID}, "t,x,y\n0,0,0\n", "FILE has the columns x, y; expected all of x, y, z"),
    ({"rigid": RIGID | {"order": "xYz"}}, "t,rx,ry,rz\n0,0,0,0\n", ORDER.format("xYz")),
    ({"rigid": RIGID | {"order": "xyz"}}, TURNED, ORDER.format("xyz")),
    *(({"rigid": RIGID}, TURNED.replace("1.0011", size), f"the quaternion at t = 2 has the length {size}; expected 1")
      for size in ("1.0011", "0.9989")),
    *(({"modes": {"amplitudes": [1]} | keys}, "", f"modes: found {found}; expected files, with") for keys, found in (
        ({"file": "a.frd", "files": "m.csv"}, ["amplitudes", "file", "files"]), ({}, ["amplitudes"]),
        ({"files": ["m.csv"], "shapes": [1]}, ["amplitudes", "files", "shapes"]),
    )),
    ({"modes": {"files": ["m.csv"], "amplitudes": [1, "t"]}}, "0,0,0,1,1,1\n", "2 amplitudes for 1 shapes; expected"),
    ({"translate": [0, 0, 0], "times": [0]}, "", "motion step 1: translate takes no times"),
]  # fmt: skip


@pytest.mark.parametrize(("motion", "text", "message"), BAD_MOTIONS)
def test_motions_are_checked(motion, text, message, tmp_path):
    path = tmp_path / "m.csv"
    path.write_text(text)
    with pytest.raises((CaseError, FormatError)) as error:
        step_of(tmp_path, **motion)
    assert message in str(error.value).replace(str(path), "FILE")
