"""The JSON schemas: what the program reads and writes fits them, what it refuses does not."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import jsonschema
import pytest

from meshdeform_cli.main import run
from meshdeform_core.errors import MeshDeformError
from meshdeform_core.wording import literal
from meshdeform_formats.case import read_case
from meshdeform_formats.case.reader import case_schema
from meshdeform_formats.report.schema import report_schema

SAMPLES = sorted((Path(__file__).parents[2] / "sample_cases").glob("*/case.toml"))
CASE = """
[grid]
tolerance = 1e-3
[constants]
turn = 10
[[boundary]]
name = "a"
select = "*.imin"
where = "x > 0"
motion = [{ rotate = { angle = "turn*t", axis = [0, 0, 1], center = [0, "turn", 0] } }, { translate = [0, "t", 1] }]
[[boundary]]
select = ["*.jmin"]
kind = "slip"
[method]
name = "idw-tfi"
[method.idw]
alpha = "auto"
rotation = "lie"
[method.tfi]
max_cells = 0
"""
WRONG = (
    ("nothing", lambda d: None),
    ("grid.tolerence = 0.1", lambda d: d["grid"].update(tolerence=0.1)),
    ("constants are numbers", lambda d: d["constants"].update(turn="ten")),
    ("kind", lambda d: d["boundary"][0].update(kind="movin")),
    ("select is empty", lambda d: d["boundary"][0].update(select=[])),
    ("three components", lambda d: d["boundary"][0].update(motion=[{"translate": [0, 1]}])),
    ("rotate without angle", lambda d: d["boundary"][0].update(motion=[{"rotate": {"axis": [0, 0, 1]}}])),
    ("two motions in one", lambda d: d["boundary"][0]["motion"][0].update(translate=[0, 0, 1])),
    ("unknown method", lambda d: d["method"].update(name="idw-tif")),
    ("unknown rotation", lambda d: d["method"]["idw"].update(rotation="lies")),
    ("unknown option", lambda d: d["method"]["idw"].update(alfa=1)),
    ("zero, which the range excludes", lambda d: d["method"]["idw"].update(alpha=0)),
    ("negative", lambda d: d["method"]["tfi"].update(max_cells=-1)),
)


def _valid(data, schema) -> bool:
    return jsonschema.Draft202012Validator(schema).is_valid(data)


def _read(data: dict, folder: Path) -> bool:
    """Whether the program accepts a case given as data."""
    path = folder / "case.toml"
    path.write_text("\n".join(f"{key} = {literal(value)}" for key, value in data.items()))
    try:
        read_case(path)
    except MeshDeformError:
        return False
    return True


@pytest.mark.parametrize("case", SAMPLES, ids=lambda path: path.parent.name)
def test_sample_cases_fit(case):
    jsonschema.validate(tomllib.loads(case.read_text()), case_schema())


@pytest.mark.parametrize("spoil", [action for _, action in WRONG], ids=[name for name, _ in WRONG])
def test_program_and_schema_refuse_the_same_mistake(spoil, tmp_path):
    data = tomllib.loads(CASE)
    spoil(data)
    right = data == tomllib.loads(CASE)
    assert (_valid(data, case_schema()), _read(data, tmp_path)) == (right, right)


def test_every_kind_of_report_fits(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run(["sample", "beam", "-o", ".", "--size", "small"]) == 0
    deform = ["deform", "grid.cgns", "-c", "case.toml"]
    commands = [
        [*deform, "-o", "a.cgns"],
        [*deform, "-m", "tfi", "-o", "b.cgns", "--allow-invalid"],
        [*deform, "-m", "rbf", "--steps", "auto", "-o", "c.cgns"],
        [*deform, "--dry-run"],
        ["series", "grid.cgns", "-c", "case.toml", "--times", "0,1", "-o", "levels"],
        ["quality", "a.cgns", "--reference", "grid.cgns", "-c", "case.toml"],
        ["quality", "grid.cgns"],
    ]
    for command in commands:
        capsys.readouterr()
        assert run([*command, "--json"]) == 0
        jsonschema.validate(json.loads(capsys.readouterr().out), report_schema())


def test_command_prints_schemas(capsys):
    for what, schema in (("case", case_schema()), ("report", report_schema())):
        jsonschema.Draft202012Validator.check_schema(schema)
        assert run(["schema", what]) == 0
        assert json.loads(capsys.readouterr().out) == json.loads(json.dumps(schema))
    assert not _valid({"schema": 2}, report_schema())
