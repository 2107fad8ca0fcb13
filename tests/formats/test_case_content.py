"""Case files: what their content becomes, exactly what is said about mistakes, and the JSON schema, which refuses the
same mistakes as the program."""

from __future__ import annotations

import os
import tomllib
from pathlib import Path

import jsonschema
import pytest
from expected import entries
from grids import CASE as TURN

from meshdeform_core.boundary import Kind
from meshdeform_core.boundary.tables import AUTOMATIC, Matching
from meshdeform_core.errors import CaseError, MeshDeformError
from meshdeform_core.methods import IDW, TFI, Options
from meshdeform_core.repair import RepairOptions
from meshdeform_formats.case import case_of, read_case
from meshdeform_formats.case.reader import case_schema

SAMPLES = sorted((Path(__file__).parents[2] / "sample_cases").glob("*/case.toml"))


@pytest.mark.parametrize("case", SAMPLES, ids=lambda path: path.parent.name)
def test_sample_cases_fit(case):
    jsonschema.validate(tomllib.loads(case.read_text()), case_schema())


TOO_LONG = [
    ("", "[constants]\nL = " + "9" * 5000, "it has an integer of more than 64 bits; write large numbers like 1e30"),
    ("", "a = " + "[" * 3000 + "]" * 3000, "its brackets are nested too deeply"),
]


@pytest.mark.parametrize(("case", "text", "message"), [*TOO_LONG, *entries("bad_cases.txt")])
def test_mistakes_in_the_file(case, text, message, tmp_path):
    path = tmp_path / "case.toml"
    path.write_text(text)
    with pytest.raises(MeshDeformError) as error:
        read_case(path)
    assert str(error.value).replace(str(path), "FILE") == (message if case else f"FILE is not a TOML file: {message}")
    if case.startswith("the schema"):
        valid = jsonschema.Draft202012Validator(case_schema()).is_valid(tomllib.loads(text))
        assert valid == (case == "the schema accepts it")
    # The command line is at fault only if there is no error without it.
    if "method 'idw-tif'" not in message:
        with pytest.raises(MeshDeformError, match=f"^{path}"):
            read_case(path, method="tfi")


@pytest.mark.parametrize(("setting", "_", "message"), entries("bad_settings.txt"))
def test_mistakes_of_the_command_line(setting, _, message, tmp_path):
    path = tmp_path / "case.toml"
    path.write_text(TURN)
    with pytest.raises(MeshDeformError) as error:
        read_case(path, [setting])
    assert str(error.value) == message


@pytest.mark.parametrize(("setting", "content", "_"), entries("settings.txt"))
def test_settings_replace_one_value(setting, content, _, tmp_path):
    (tmp_path / "case.toml").write_text(TURN)
    assert read_case(tmp_path / "case.toml", [setting]).content == tomllib.loads(content)
    # Without a file the tables that it passes through are made.
    if setting.startswith("method"):
        assert read_case(None, [setting]).content == {"method": tomllib.loads(content)["method"]}


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
    first, table, levels, *others = case.boundaries
    assert (first.where.text, table.where, first.motion.constants) == ("x > a", None, case.constants)
    assert [spec.motion for spec in others] == 5 * [None]
    assert table.motion.steps[0].matching == Matching("exact", 0.25)
    assert [len(spec.motion.steps) for spec in (first, table, levels)] == [1, 2, 1]
    assert (levels.motion.steps[0].times, levels.motion.steps[0].matching) == ((0.0, 2.0), Matching("nearest"))
    assert [levels.motion.steps[0].table(n).label for n in (0, 1)] == ["t.csv", "u.csv"]
    plain = read_case(None)
    assert (plain.case.boundaries, plain.case.method, plain.boundary_file) == ((), Options("idw-tfi"), None)
    assert (plain.case.repair, plain.case.open_faces, plain.case.components) == (RepairOptions(), False, "")
    assert case_of({"grid": {"components": "zone prefix", "open": True}}).case.components == "zone prefix"


def test_a_table_of_the_command_line_moves_what_it_matches(tmp_path):
    path = tmp_path / "case.toml"
    path.write_text(TURN)
    for n in (9, 10):
        (tmp_path / f"t{n}.csv").write_text("0,0,0,1,0,0\n")
    for matching in (None, Matching("exact", 0.5)):
        found = read_case(path, method="rbf", table=tmp_path / "t9.csv", matching=matching)
        assert [spec.name for spec in found.case.boundaries] == ["body", "span", "outer", "t9.csv"]
        spec = found.case.boundaries[-1]
        assert (spec.select, spec.kind, spec.where, spec.motion.constants) == (
            ("*",),
            Kind.MOVING,
            None,
            {"turn": 10.0},
        )
        assert spec.motion.steps[0].matching == (matching or Matching(AUTOMATIC, partial=True))
        assert (found.files, found.case.method.name) == ((tmp_path / "t9.csv",), "rbf")
    found = read_case(None, table=tmp_path / "t*.csv", times="0:2:2")
    (step,) = found.case.boundaries[0].motion.steps
    assert (step.times, found.files) == ((0.0, 2.0), (tmp_path / "t9.csv", tmp_path / "t10.csv"))
    assert step.table(1).label == "t10.csv"
    with pytest.raises(CaseError, match=r"^--displacement .*/t\*\.csv: 2 files \(t9\.csv to t10\.csv\) for 3 times"):
        read_case(None, table=tmp_path / "t*.csv", times="0,1,2")
    with pytest.raises(MeshDeformError, match=r"^--method idv: method 'idv' is unknown; .*did you mean 'idw'\?$"):
        read_case(path, method="idv")


def test_files_that_cannot_be_read(tmp_path):
    (tmp_path / "bytes").write_bytes(b"\xff")
    os.mkfifo(tmp_path / "pipe")
    for name, message in (("gone", "cannot read the case file {}: No such file or directory"),
                          ("bytes", "{} is not a TOML file: "), ("pipe", "{}: it is a pipe")):  # fmt: skip
        with pytest.raises(MeshDeformError) as error:
            read_case(tmp_path / name)
        assert message.format(tmp_path / name) in str(error.value)
    deep: dict = {}
    for _ in range(102):
        deep = {"a": deep}
    with pytest.raises(CaseError, match="nested more than 100 deep"):
        case_of(deep)
    (tmp_path / "mark.toml").write_bytes(b"\xef\xbb\xbf[method]\nname = 'tfi'")
    assert read_case(tmp_path / "mark.toml").case.method.name == "tfi"
