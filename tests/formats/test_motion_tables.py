"""Tables of motions, and the steps of the core that the motions of a case become; what is wrong is named exactly."""

from __future__ import annotations

import dataclasses
import os
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from expected import entries

from meshdeform_core.boundary.motions.expression import Expression, expression
from meshdeform_core.boundary.motions.histories import Beam, RigidHistory
from meshdeform_core.boundary.motions.motion import Displace, Follow, History, Rotate, Step
from meshdeform_core.boundary.motions.shapes import Airfoil, ControlMove, Lattice
from meshdeform_core.boundary.tables import Matching, Positions, SurfaceData
from meshdeform_core.errors import CaseError, FormatError
from meshdeform_formats.case import case_of
from meshdeform_formats.case.tables import read_airfoil, read_beam, read_history, read_positions

NUMBERS = {"x", "y", "z", "t", "c"}


def step_of(folder: Path, **motion: Any) -> Step:
    (spec,) = case_of({"constants": {"c": 2}, "boundary": [{"motion": motion}]}, folder).case.boundaries
    (step,) = spec.motion.steps
    return step


def formulas(*texts: float | str) -> tuple[Expression, ...]:
    return tuple(expression(text, NUMBERS) for text in texts)


def same(found: Any, expected: Any) -> None:
    """Whether two steps have the same fields, numbers up to round-off."""
    if isinstance(expected, np.ndarray):
        np.testing.assert_allclose(found, expected, rtol=1e-14, atol=1e-13)
    elif isinstance(expected, Expression):
        assert found.text == expected.text
    elif dataclasses.is_dataclass(expected):
        assert type(found) is type(expected)
        for field in dataclasses.fields(expected):
            same(getattr(found, field.name), getattr(expected, field.name))
    elif isinstance(expected, tuple):
        assert len(found) == len(expected)
        for pair in zip(found, expected, strict=True):
            same(*pair)
    else:
        assert found == expected


def test_formulas_become_steps(tmp_path):
    spin = {"angle": "c*t", "axis": [0, 2, 0], "center": [1, "c", 0]}
    same(step_of(tmp_path, rotate=spin), Rotate(*formulas("c*t"), (0, 2, 0), formulas(1.0, "c", 0.0)))
    same(step_of(tmp_path, rotate={"angle": 1}), Rotate(*formulas(1.0), (0, 0, 1), formulas(0.0, 0.0, 0.0)))
    for name in ("translate", "displace"):
        same(step_of(tmp_path, **{name: ["x*t", 2, "c"]}), Displace(formulas("x*t", 2.0, "c")))


def test_boxes_count_control_points_from_one(tmp_path):
    edges = [[1, 0, 0], [0, 2, 0.5], [0, 0, 3]]
    move = [{"at": [2, "*", 1], "by": [0, "c*t", 1]}, {"at": ["*", 3, 2], "by": [1, 0, 0]}]
    found = step_of(tmp_path, ffd={"origin": [1, 2, 3], "edges": edges, "points": [2, 3, 2], "move": move})
    first = ControlMove(np.array([[1, j, 0] for j in range(3)]), formulas(0.0, "c*t", 1.0))
    second = ControlMove(np.array([[0, 2, 1], [1, 2, 1]]), formulas(1.0, 0.0, 0.0))
    same(found, Lattice(np.array([1.0, 2, 3]), np.array(edges), (2, 3, 2), (first, second)))


def test_bodies_take_their_columns_by_name(tmp_path):
    path = tmp_path / "m.csv"
    path.write_text('# a comment of the header\n"T" RZ rx Y x z ry\n\n0 1 2 3 4 5 6\n% between\n1 7 8 9 10 11 12\n')
    with pytest.raises(FormatError, match="line 1: found '# a comment of the header'; expected a header like t,x,y,z"):
        read_history(path)
    path.write_text('"T" RZ;rx, Y x z ry\n\n0 1 2 3 4 5 6\n% between\n+1 7 8 9 10 11 12\n')
    time, label = np.array([0.0, 1]), str(path)
    shift = History(time, np.array([[4.0, 3, 5], [10, 9, 11]]), label)
    turns = {"x": [2, 8], "y": [6, 12], "z": [1, 7]}
    for order in ("zyx", "YXZ", "xzy"):
        angles = History(time, np.array([turns[axis] for axis in order.lower()], dtype=float).T, label)
        found = step_of(tmp_path, rigid={"file": "m.csv", "order": order, "center": [1, 2, 3]})
        same(found, RigidHistory(shift, angles, order, (1.0, 2.0, 3.0)))
    path.write_text("t,x,y,z\n0,1,2,3\n.5,4,5,6\n")
    shift = History(np.array([0, 0.5]), np.array([[1.0, 2, 3], [4, 5, 6]]), label)
    same(step_of(tmp_path, rigid={"file": "m.csv"}), RigidHistory(shift, None, "", (0.0, 0.0, 0.0)))
    path.write_text("t,qw,qx,qy,qz\n0,1,0,0,0\n1,0,.6,0.8,0\n")
    turn = History(time, np.array([[0.0, 0, 0, 1], [0.6, 0.8, 0, 0]]), label)
    same(
        step_of(tmp_path, rigid={"file": "m.csv"}),
        RigidHistory(History(time, np.zeros((2, 3)), label), turn, "", (0.0, 0.0, 0.0)),
    )


def test_beams_are_read_in_any_order_of_times_and_with_both_rotations(tmp_path):
    path, rng = tmp_path / "b.csv", np.random.default_rng(5)
    line = np.array([[0, 0, 0], [100, 0, 1000], [0, 0, 2500.0]])
    moved, turns = rng.normal(size=(2, 3, 3)), 0.3 * rng.normal(size=(2, 3, 3))
    turns[0, 1] = 0
    size = np.linalg.norm(turns, axis=2, keepdims=True)
    for letters, values in (("r", np.degrees(turns)), ("c", 4 * np.tan(size / 4) * turns / np.maximum(size, 1e-300))):
        header = f"dz,dx,dy,{letters}z,{letters}x,{letters}y,t,x,y,z"
        rows = [
            # Stations differ by rounding, up to a millionth of the length.
            np.hstack([moved[t][:, [2, 0, 1]], values[t][:, [2, 0, 1]], np.full((3, 1), 2.0 * t), line + t * 2.4e-3])
            for t in (1, 0)
        ]
        np.savetxt(path, np.concatenate(rows), "%.17g", delimiter=",", header=header, comments="")
        history = History(np.array([0.0, 2]), moved.reshape(2, -1), str(path))
        same(step_of(tmp_path, beam="b.csv"), Beam.of(line, history, turns))
        np.savetxt(path, np.delete(rows[1], 6, 1), "%.17g", delimiter=",", header=header.replace("t,", ""), comments="")
        history = History(np.array([0.0]), moved[:1].reshape(1, -1), str(path), False)
        same(read_beam(path), Beam.of(line, history, turns[:1]))


def test_amplitudes_belong_to_shapes_by_name_or_number(tmp_path):
    shapes = []
    for n in (1, 2, 3):
        rows = np.arange(12.0).reshape(2, 6) + n
        np.savetxt(tmp_path / f"mode{n}.csv", rows, delimiter=",")
        shapes.append(SurfaceData(rows[:, :3], rows[:, 3:], np.zeros((0, 3), int), str(tmp_path / f"mode{n}.csv")))
    found = step_of(tmp_path, modes={"files": "mode?.csv", "amplitudes": ["t", "c", 1]}, match="exact", tolerance=0.5)
    same(found.amplitudes, formulas("t", "c", 1.0))
    assert found.matching == Matching("exact", 0.5)
    for shape, exact in zip(found.shapes, shapes, strict=True):
        np.testing.assert_array_equal(
            np.hstack([shape.points, shape.displacement]), np.hstack([exact.points, exact.displacement])
        )
    files = ["mode2.csv", "mode1.csv"]
    # A name counts before a number: mode1 is the second file, the first shape is called mode2.
    for header, want in (
        ("q2,q1", [2, 1]),
        ("Mode1,mode2", [2, 1]),
        ("2,other,1", [3, 1]),
        ("mode_2,q3,mode-1", [3, 1]),
    ):
        rows = np.arange(2.0 * header.count(",") + 4).reshape(2, -1)
        np.savetxt(tmp_path / "q.csv", rows, delimiter=",", header=f"t,{header}", comments="")
        found = step_of(tmp_path, modes={"files": files, "amplitudes": {"file": "q.csv"}})
        same(found.amplitudes, History(rows[:, 0], rows[:, want], str(tmp_path / "q.csv")))
        assert [Path(shape.label).name for shape in found.shapes] == files
    (tmp_path / "q.csv").write_text("t,anything\n0,1\n1,5\n")
    found = step_of(tmp_path, modes={"files": "mode3.csv", "amplitudes": {"file": "q.csv"}})
    same(found.amplitudes, History(np.array([0.0, 1]), np.array([[1.0], [5]]), str(tmp_path / "q.csv")))


def test_positions_are_sorted_by_number(tmp_path):
    path = tmp_path / "s.dat"
    path.write_text("PointID x y\n7 0.5 1\n3 2 3\n7 0.5 1\n")
    positions = Positions(np.array([3, 7]), np.array([[2.0, 3], [0.5, 1]]), str(path))
    same(step_of(tmp_path, positions={"file": "s.dat"}), Follow(positions, Matching("exact")))
    (tmp_path / "s_10.dat").write_text("1 2 3 4\n")
    path.rename(tmp_path / "s_9.dat")
    found = step_of(tmp_path, positions={"files": "s_*.dat", "times": "0:2:2"})
    assert (found.matching, found.times) == (Matching("exact"), (0.0, 2.0))
    same(found.table(1), Positions(np.array([1]), np.array([[2.0, 3, 4]]), str(tmp_path / "s_10.dat")))
    assert found.table(0).label == str(tmp_path / "s_9.dat")


UPPER = np.array([[0.0, 0.01], [0.5, 0.1], [1.0, 0.0]])
LOWER = np.array([[0.0, 0.01], [0.3, -0.05], [0.6, -0.04], [1.0, 0.0]])


def test_airfoils_run_over_the_upper_side_whatever_their_form(tmp_path):
    outline = np.concatenate([UPPER[::-1], LOWER[1:]])
    text = {
        "selig": "NACA 1\nof 1933\n" + "\n".join(f"{x} {y}" for x, y in outline.tolist()),
        "backwards": "\n".join(f"{x}, {y}" for x, y in outline[::-1].tolist()),
        "lednicer": "x\n 3. 4.\n\n" + "\n".join(f"{x} {y}" for x, y in np.concatenate([UPPER, LOWER]).tolist()),
    }
    for name, content in text.items():
        path = tmp_path / f"{name}.dat"
        path.write_text(content)
        np.testing.assert_array_equal(read_airfoil(path), outline)
    for plane, fit in (("xy", "chord"), ("zx", "none")):
        found = step_of(tmp_path, airfoil={"file": "selig.dat", "plane": plane, "fit": fit})
        axes = ("xyz".index(plane[0]), "xyz".index(plane[1]))
        same(found, Airfoil(outline, axes, fit == "chord", str(tmp_path / "selig.dat")))


READERS = {read.__name__: read for read in (read_history, read_beam, read_positions, read_airfoil)}


@pytest.mark.parametrize(("reader", "text", "message"), entries("bad_tables.txt"))
def test_tables_are_checked(reader, text, message, tmp_path):
    path = tmp_path / "table.dat"
    path.write_text(text)
    with pytest.raises(FormatError) as error:
        READERS[reader](path)
    assert str(error.value).replace(str(path), "FILE") == message


def test_files_that_are_no_text_or_too_large_are_refused(tmp_path):
    path = tmp_path / "table.dat"
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(FormatError, match="pipe: it is a pipe"):
        read_history(tmp_path / "pipe")
    path.write_bytes(b"t,x\n0,\xff\n")
    with pytest.raises(FormatError, match="is not UTF-8 text: "):
        read_history(path)
    with path.open("wb") as file:
        file.truncate(256 * 2**20 + 1)
    with pytest.raises(FormatError, match=r"is larger than any such table \(256 MiB\)$"):
        read_history(path)
    path.write_bytes(b"\xef\xbb\xbft,x\n0,1\n")
    assert list(read_history(path)) == ["t", "x"]


@pytest.mark.parametrize(("motion", "text", "message"), entries("bad_motions.txt"))
def test_motions_are_checked(motion, text, message, tmp_path):
    path = tmp_path / "m.csv"
    path.write_text(text)
    with pytest.raises((CaseError, FormatError)) as error:
        step_of(tmp_path, **tomllib.loads(motion)["motion"])
    assert str(error.value).replace(str(path), "FILE") == message


def test_columns_of_amplitudes_that_belong_to_no_shape_are_named(tmp_path):
    rows = "0,0,0,1,1,1\n"
    (tmp_path / "a.csv").write_text(rows)
    (tmp_path / "b.csv").write_text(rows)
    for columns, found, number in (("q1,q3", "none", 2), ("a,b2,c_2", "2", 2), ("x,b", "none", 1)):
        (tmp_path / "q.csv").write_text(f"t,{columns}\n0{(columns.count(',') + 1) * ',0'}\n")
        with pytest.raises(FormatError) as error:
            step_of(tmp_path, modes={"files": ["a.csv", "b.csv"], "amplitudes": {"file": "q.csv"}})
        found = f"{tmp_path / 'q.csv'} has the columns t {columns.replace(',', ' ')}, of which {found} belong to shape"
        assert str(error.value) == f"{found} {number}; expected one called q{number} or {'ab'[number - 1]}"
