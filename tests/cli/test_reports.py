"""Reports that commands write: what they show and name is there, and a run can be repeated from its report."""

from __future__ import annotations

import base64
import hashlib
import io
import json
import re
import shlex
from pathlib import Path

import jsonschema
import numpy as np
from PIL import Image

from meshdeform_formats.case.reader import case_schema

RUN = ("deform", "grid.xyz", "-c", "case.toml", "-o", "out.xyz")
SERIES = ("series", "grid.xyz", "-c", "case.toml", "-s", "constants.turn=1", "--times", "0:1:0.5", "-o", "levels")


def test_command_prints_the_schema(call):
    jsonschema.Draft202012Validator.check_schema(case_schema())
    assert json.loads(call("schema", "case").out) == json.loads(json.dumps(case_schema()))


def test_a_run_can_be_repeated_from_its_report_and_its_page_shows_something(bench, call):
    reports = ("--report", "r.json", "--report", "r.html")
    assert call(*RUN, "-s", "constants.turn=80", "--repair", "off", *reports, "-q").code == 3
    report, page = json.loads(Path("r.json").read_text()), Path("r.html").read_text()
    pictures = re.findall(r'<img src="data:image/png;base64,([^"]*)" alt="([^"]*)">', page)
    assert [title for _, title in pictures] == ["Around the walls", "The worst cells"]
    assert all(np.asarray(Image.open(io.BytesIO(base64.b64decode(data)))).std() > 10 for data, _ in pictures)
    worst, named = report["invalid_cells"][0], report["quality"]["after"]["worst"]["min_relative_jacobian"]
    assert (worst["block"], worst["ijk"]) == (named["block"], named["ijk"])
    for file in report["run"]["files"]:
        assert file["sha256"] == hashlib.sha256(Path(file["path"]).read_bytes()).hexdigest()
        assert file["sha256"] in page
    assert {file["role"] for file in report["run"]["files"]} == {"grid", "case", "output"}
    words = shlex.split(report["run"]["command"].replace("--report r.html ", ""))
    again = Path("out.invalid.xyz").read_bytes()
    assert (words[0], call(*words[1:], "--force").code) == ("meshdeform", 3)
    assert Path("out.invalid.xyz").read_bytes() == again


def test_json_goes_to_stdout_alone(bench, call):
    for option in (("--json",), ("--report", "-")):
        result = call(*RUN, *option, "--force")
        assert json.loads(result.out)["valid"] is True
        assert "verdict   valid" in result.err
    assert call(*RUN, "--json", "--force", "-q").err == ""
    plan = call(*RUN, "--json", "--dry-run", "-q")
    assert json.loads(plan.out)["method"]["name"] == "idw-tfi"
    assert json.loads(call("quality", "grid.xyz", "--report", "-").out)["valid"] is True
    assert len(json.loads(call(*SERIES, "--json").out)["levels"]) == 3
