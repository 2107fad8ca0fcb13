"""Tables of motions and motions of a case: columns by name; what is wrong is named, with its line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from meshdeform_core.boundary.motions.motion import Step
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
MOVES = [{"at": [1, 1, 1], "by": [0, 0, 0]}]
ORDER = "order = '{}'; expected, only for angles rx ry rz in degrees"
TURNED = "t,qx,qy,qz,qw\n0,0,0,0,1\n1,0,0,0,1.0009\n2,0,0,0,1.0011\n3,0,0,0,4\n"
RIGID = {"file": "m.csv"}
BAD_MOTIONS = [
    ({"rotate": {"angle": 1, "axis": [0, 0, 0]}}, "", "motion step 1: rotate: axis = [0, 0, 0] has no direction"),
    *(({"ffd": BOX | {"move": MOVES} | change}, "", f"boundary 'boundary 1': motion{message}") for change, message in (
        ({"edges": [[1, 0, 0], [2, 0, 0], [0, 0, 1]]}, " step 1: ffd: edges = [[1.0, 0.0, 0.0], [2.0, 0.0, 0.0]"),
        ({"points": [1, 2, 2]}, ".ffd.points = [1, 2, 2]; expected"), ({"move": []}, ".ffd.move = []; expected move"),
        ({"origin": [0, 0]}, ".ffd.origin = [0, 0]; expected three values: a corner of the box"),
    )),
    *(({"ffd": BOX | {"move": [*MOVES, {"at": at, "by": [0, 0, 0]}]}}, "", f"move 2{message}") for at, message in (
        ([1, True, 1], ": at = [1, true, 1]; expected three values: numbers from 1"),
        ([4, 1, 1], ", at: found 4; expected a control point from 1 to 3"), ([1, 0, "*"], ", at: found 0; expected a "),
    )),
    ({"rigid": RIGID}, "t,x,y,z,w\n0,0,0,0,0\n", "rigid: FILE has a column 'w'; known are t x y z"),
    ({"rigid": RIGID}, "t,rx,ry,rz,qx,qy,qz,qw\n0,0,0,0,0,0,0,0\n", "has angles and quaternions; expected one"),
    ({"rigid": RIGID}, "t,rx,ry,rz\n0,0,0,0\n", ORDER.format("")),
    ({"rigid": RIGID}, "t,x,y\n0,0,0\n", "FILE has the columns x, y; expected all of x, y, z"),
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
