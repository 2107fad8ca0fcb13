"""Case files: what their content becomes, what is said about mistakes, and the JSON schema, which refuses the same
mistakes as the program."""

from __future__ import annotations

import tomllib
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from grids import CASE

from meshdeform_core.boundary import Kind
from meshdeform_core.boundary.tables import Matching
from meshdeform_core.errors import CaseError, MeshDeformError
from meshdeform_core.methods import IDW, TFI, Options
from meshdeform_core.repair import RepairOptions
from meshdeform_formats.case import case_of, read_case
from meshdeform_formats.case.reader import case_schema

SAMPLES = sorted((Path(__file__).parents[2] / "sample_cases").glob("*/case.toml"))
# A constant may be called like a table.
TURN = CASE.replace("[constants]", "[constants]\nrepair = 1")
BODY = '[[boundary]]\nname = "body"\nwhere = "abs(x) < 0.51"\n'
SHIFT = BODY + "motion = [{ translate = [0.1, 0, 0] }]\n"


def moved(motion: str) -> str:
    return f"{BODY}motion = {motion}\n"


@pytest.mark.parametrize("case", SAMPLES, ids=lambda path: path.parent.name)
def test_sample_cases_fit(case):
    jsonschema.validate(tomllib.loads(case.read_text()), case_schema())


NO_TOML = [
    ("[constants]\nL = " + "9" * 5000, "it has an integer of more than 64 bits; write large numbers like 1e30"),
    ("a = " + "[" * 3000 + "]" * 3000, "its brackets are nested too deeply"), ("[method\nname = 'tfi'", "at line 1, "),
    *(("\n" + "ab." * n + "ab = 1", f"line 2: the key {'ab.' * 13}a... has more than 30 parts") for n in (30, 3000)),
]  # fmt: skip
NOT_FOR_THE_SCHEMA = [
    ("[metod]\nname = 'tfi'", "case: unknown key 'metod'; did you mean 'method'?"),
    (moved("[{ translat = [0, 0, 0] }]"), "boundary 'body', motion step 1: unknown key 'translat'; did you mean 'tr"),
    ("[method]\nalpha = 0.1\n", "[method]: unknown key 'alpha'; did you mean 'method.idw.alpha'?"),
    ("[constants]\nL = 'five'", "constants.L: expected a finite number, found 'five'"),
    (SHIFT + "kind = 'movin'", "boundary 'body': kind = 'movin'; expected one of moving, fixed, symmetry"),
    (SHIFT + "select = []", "boundary 'body': select = []; expected a list of names, like"),
    (moved("5"), "boundary 'body': motion = 5; expected a list of tables, like [{ translate = [0, 0.1, 0] }]"),
    (moved("[{ rotate = 30 }]"), "motion step 1: rotate = 30; expected { angle = degrees, axis = [..], "),
    (SHIFT + "[[boundary]]\nmotion = [{ translate = [0, 0, 0] }, { rotate = { axis = [0, 0, 1] } }]",
     "boundary 'boundary 2', motion step 2: rotate: there is no angle; expected degrees"),
    (moved("[{ file = 5 }]"), "boundary 'body': motion step 1: file: expected a file name, found 5"),
    ("[grid]\ntolerance = 0.5", "grid.tolerance = 0.5; expected a finite number, between 0 and 0.5 of the edge"),
    ('[grid]\nboundary_file = "a\\u0000b"', "grid.boundary_file = 'a\\x00b'; expected a file name"),
    *((f"[grid]\ncomponents = {entry}", "; expected \"zone prefix\", or names with block patterns") for entry in (
        "'zones'", "{}", "{ a = 3 }", "{ a = [] }", "{ a = { file = 'x.cgns' } }")),
    ("[method]\nname = 'idw-tif'", "method 'idw-tif' is unknown; known are tfi, rbf, idw, tfi-tfi, rbf-rbf"),
    *((f"[method.idw]\nalpha = {value}", "; expected a positive number up to 10000 or ") for value in (0, 10001)),
]  # fmt: skip
FOR_THE_SCHEMA = [
    *((f"[constants]\n{name} = 1", f"constants.{name}: {name} already has a") for name in ("x", "t", "pi", "if")),
    ("[[boundary]]\nname = 'a'", "boundary 'a': has no kind; expected one of moving, fixed"),
    (BODY + "kind = 'moving'", "boundary 'body': moves but has no motion; expected motion = [...]"),
    (SHIFT + "kind = 'fixed'", "boundary 'body': is fixed but has a motion; expected motion = [...]"),
    (SHIFT + SHIFT, "boundary: names must differ, found ['body', 'body']"),
    (moved("[{ displace = ['q*x', 0, 0] }]"), "motion step 1: expression 'q*x' uses the unknown name 'q'; known are"),
    (SHIFT.replace("abs(x)", "t"), "where: expression 't < 0.51' uses the unknown name 't'; known are pi, x, y, z"),
    ("[repair]\nmin_jacobian = nan", "repair.min_jacobian = nan; expected a finite number"),
    ("[repair]\nmin_jacobian = 2", "repair: min_jacobian = 2.0; expected a share of the undeformed Jacobian"),
]  # fmt: skip


MISTAKES = [*((None, *each) for each in NO_TOML), *((False, *each) for each in NOT_FOR_THE_SCHEMA),
            *((True, *each) for each in FOR_THE_SCHEMA)]  # fmt: skip


@pytest.mark.parametrize(("valid", "text", "message"), MISTAKES)
def test_mistakes_in_the_file(valid, text, message, tmp_path):
    path = tmp_path / "case.toml"
    path.write_text(text)
    with pytest.raises(MeshDeformError) as error:
        read_case(path)
    assert str(error.value).startswith(f"{path} is not a TOML file" if valid is None else f"{path}: ")
    assert message in str(error.value)
    if valid is not None:
        assert jsonschema.Draft202012Validator(case_schema()).is_valid(tomllib.loads(text)) == valid
    # The command line is at fault only if there is no error without it.
    if "method 'idw-tif'" not in message:
        with pytest.raises(MeshDeformError, match=f"^{path}"):
            read_case(path, method="tfi")


WRONG_SETTINGS = [
    ("constants.turn.x=1", "--set 'constants.turn.x=1': 'turn' is a value, not a table"),
    ("boundary.wing.kind=fixed", "no entry 'wing'; known are body, span, outer"),
    ("constants.trun=40", "no formula uses the constant 'trun'; did you mean 'turn'?"),
    ("constants={turn=1, much=2}", "no formula uses the constant 'much'; used are turn"),
    ("boundary.body=3", "; name an entry and its key"),
    ("turn=10", "--set 'turn=10': unknown key 'turn'; did you mean 'constants.turn'?"),
    ("method.rbf.basis=wendland-c2", "has no effect: the method 'idw-tfi' uses only method.idw, method.tfi"),
    ("repair.min_jacobian=nan", "command line: repair.min_jacobian = nan; expected a finite number"),
]


@pytest.fixture
def turn(tmp_path):
    (tmp_path / "case.toml").write_text(TURN)
    return tmp_path / "case.toml"


@pytest.mark.parametrize(("setting", "message"), WRONG_SETTINGS)
def test_mistakes_of_the_command_line(setting, message, turn):
    with pytest.raises(MeshDeformError) as error:
        read_case(turn, [setting])
    assert message in str(error.value)
    assert str(error.value).startswith(("--set ", "command line: "))


@pytest.mark.parametrize(
    ("setting", "place", "value"),
    [
        ("constants.turn=.5", ("constants", "turn"), 0.5), ("constants.turn = -1.", ("constants", "turn"), -1.0),
        ("method.name=tfi", ("method",), {"name": "tfi"}), ("repair={mode='off'}", ("repair",), {"mode": "off"}),
        ("method.idw.alpha=1.e3", ("method",), {"idw": {"alpha": 1e3}}),
        ("boundary.2.name=a=b", ("boundary", 1, "name"), "a=b"),
        ('boundary.body.select=["*.kmin"]', ("boundary", 0, "select"), ["*.kmin"]),
        ("boundary.body.motion.1.rotate.angle=turn", ("boundary", 0, "motion", 0, "rotate", "angle"), "turn"),
    ],
)  # fmt: skip
def test_settings_replace_one_value(setting, place, value, turn):
    expected = entry = tomllib.loads(TURN)
    for key in place[:-1]:
        entry = entry[key]
    entry[place[-1]] = value
    assert read_case(turn, [setting]).content == expected
    # Without a file the tables that it passes through are made.
    if place == ("method",):
        assert read_case(None, [setting]).content == {"method": value}


MADE = [
    ({"constants": {"a": -(2**63) - 1}}, "constants.a is beyond integers of 64 bits, -2^63 to 2^63 - 1; write large"),
    ({"constants": {"a": 2**63}}, "constants.a is beyond integers of 64 bits"),
    ({"boundary": [{}, {"motion": ({"translate": np.array([0, np.nan, 0])},)}]},
     "boundary.2.motion.1.translate.2 = nan; expected a finite number"),
]  # fmt: skip


@pytest.mark.parametrize(("content", "message"), MADE)
def test_numbers_of_cases_made_in_python_are_those_of_files(content, message):
    assert case_of({"constants": {"a": -(2**63), "b": np.int64(2**63 - 1)}}).case.constants == {
        "a": -(2.0**63),
        "b": 2.0**63,
    }
    with pytest.raises(CaseError) as error:
        case_of(content)
    assert str(error.value).startswith(message)


FULL = {
    "grid": {"boundary_file": "a.nmf", "tolerance": 1e-3, "open": ["b.imin"], "plates": ["b.kmax"],
             "components": {"wing": "w*", "flap": ["f*", "g*"]}},
    "constants": {"a": 1, "idle": 2.5, "b": 0.5},
    "boundary": [
        {"select": "*.imin", "where": "x > a", "motion": {"translate": [0, "b*t", 1]}},
        {"name": "table", "motion": [{"file": "t.csv", "match": "exact", "tolerance": 0.25}, {"translate": [0, 0, 1]}]},
        {"name": "levels", "motion": [{"files": ["t.csv", "u.csv"], "times": [0, 2]}]},
        *({"name": kind, "kind": kind} for kind in ("fixed", "symmetry", "slip", "periodic", "free")),
    ],
    "method": {"name": "idw-tfi", "idw": {"alpha": 0.5}, "tfi": {"max_cells": 4}},
    "repair": {"mode": "off", "min_jacobian": 0.125, "time_limit": 9.0},
}  # fmt: skip


def test_what_a_case_becomes(tmp_path):
    for name in ("t.csv", "u.csv"):
        (tmp_path / name).write_text("0,0,0,1,0,0\n")
    found = case_of(FULL, tmp_path)
    case = found.case
    assert (found.boundary_file, found.content) == (tmp_path / "a.nmf", FULL)
    assert found.files == tuple(tmp_path / name for name in ("a.nmf", "t.csv", "t.csv", "u.csv"))
    assert (case.constants, case.tolerance, case.open_faces) == ({"a": 1.0, "idle": 2.5, "b": 0.5}, 1e-3, ("b.imin",))
    assert (case.plates, case.components) == (("b.kmax",), {"wing": ("w*",), "flap": ("f*", "g*")})
    assert case.method == Options("idw-tfi", idw=IDW(alpha=0.5), tfi=TFI(max_cells=4))
    assert case.repair == RepairOptions("off", 0.125, 9.0)
    assert case.notes == ("no formula uses the constant 'idle'",)
    names = ["boundary 1", "table", "levels", "fixed", "symmetry", "slip", "periodic", "free"]
    assert [spec.name for spec in case.boundaries] == names
    assert [spec.kind for spec in case.boundaries] == [Kind.MOVING] * 3 + [Kind[name.upper()] for name in names[3:]]
    assert [spec.select for spec in case.boundaries] == [("*.imin",)] + 7 * [("*",)]
    first, table, levels, *_ = case.boundaries
    assert (first.where.text, table.where, first.motion.constants) == ("x > a", None, case.constants)
    assert table.motion.steps[0].matching == Matching("exact", 0.25)
    assert [len(spec.motion.steps) for spec in (first, table, levels)] == [1, 2, 1]
    assert (levels.motion.steps[0].times, levels.motion.steps[0].matching) == ((0.0, 2.0), Matching("nearest"))
