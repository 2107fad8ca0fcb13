"""What the forms of a report have in common, and the JSON schema of case files: what the program reads fits it, what it
refuses does not."""

from __future__ import annotations

import base64
import contextlib
import hashlib
import html.parser
import io
import json
import re
import shlex
import shutil
import tomllib
from pathlib import Path
from xml.etree import ElementTree

import jsonschema
import numpy as np
import pytest
from PIL import Image

from meshdeform_cli.main import run
from meshdeform_core.errors import MeshDeformError
from meshdeform_core.wording import literal
from meshdeform_formats.case import read_case
from meshdeform_formats.case.reader import case_schema
from meshdeform_formats.report.page import as_html, curve, histogram
from meshdeform_formats.report.tables import measures_table, repair_lines, shape_table

DONE = {
    "invalid": 2, "weak": 10, "nodes": 1, "max_movement": 0.5, "newton_steps": 3, "converged": True, "before": None,
    "left_out": None,
}  # fmt: skip
WEAK = "weak: sheared by more than 45 degrees, or twice or half as long in one direction"


def measures(invalid, scaled):
    return {
        "invalid_cells": invalid, "min_scaled_jacobian": scaled, "f_skew": {"min": 0.5},
        "wall_normal_deviation_deg": {"rms": 2.0},
    }  # fmt: skip


def test_it_says_what_was_done_and_what_the_method_alone_gives():
    report = {
        "repair": DONE | {"before": measures(2, -0.25)},
        "boundary": {"max_displacement": 2.0},
        "quality": {"after": measures(0, 0.75)},
    }
    assert "; ".join(repair_lines(report)) == (
        "2 invalid and 10 weak cells repaired, 1 node moved by up to 0.5 (0.25 of the largest displacement), 3 Newton "
        "steps; the method alone -> repaired: smallest scaled Jacobian -0.25 -> 0.75, smallest f_skew 0.5 -> 0.5, "
        f"angle at walls 2 -> 2 degrees rms, invalid cells 2 -> 0; {WEAK}"
    )


@pytest.mark.parametrize(
    ("draw", "label"),
    [
        (lambda: histogram([0, 3, 1], [1, 10**7, 0], "f_skew"), "cells over f_skew"),
        (lambda: curve([0, 1, 2], [3.0, 2.5, 2.0], "time", "size", [False, True, False]), "size over time"),
    ],
)
def test_charts_are_elements_of_the_page(draw, label):
    svg = draw()
    root = ElementTree.fromstring(svg.replace("xlink:href", "href"))
    assert (root.tag, root.get("role"), root.get("aria-label")) == ("svg", "img", label)
    assert not re.search(r"https?:|url\(", svg)


def test_only_extremes_have_a_worst_cell():
    worst = {"f_skew": {"block": "b", "ijk": [1, 2, 3]}}
    quality = {"f_skew": {"harmonic_mean": 0.8, "mean": 0.9, "p01": 0.6, "min": 0.5}, "worst": worst}
    table = measures_table({"quality": {"before": quality, "after": quality}})
    places = {name: place for name, *_, place in table.rows}
    assert places.pop("f_skew minimum") == "b (1, 2, 3)"
    assert set(places.values()) == {""}


@pytest.mark.parametrize(
    ("before", "row"),
    [(None, ("skewness", 2.0, 1.0, "")), ({"skewness": {"max": 1.5}}, ("skewness", 1.5, 2.0, 1.0, ""))],
)
def test_shapes_of_a_grid_by_itself_have_no_column_before(before, row):
    table = shape_table({"shape": {"before": before, "after": {"skewness": {"max": 2.0, "mean": 1.0, "worst": None}}}})
    assert list(table.rows) == [row]
    assert ("largest before" in table.heads) == (len(row) == len(table.heads) == 5)


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
    valid = jsonschema.Draft202012Validator(case_schema()).is_valid(data)
    assert (valid, _read(data, tmp_path)) == (right, right)


def test_command_prints_the_schema(capsys):
    jsonschema.Draft202012Validator.check_schema(case_schema())
    assert run(["schema", "case"]) == 0
    assert json.loads(capsys.readouterr().out) == json.loads(json.dumps(case_schema()))


RUN = ("deform", "grid.xyz", "-c", "case.toml", "-o", "out.xyz")
SERIES = ("series", "grid.xyz", "-c", "case.toml", "-s", "constants.turn=1", "--times", "0:1:0.5", "-o", "levels")
_VOID = {"meta", "img", "input", "br"}


class Page(html.parser.HTMLParser):
    """Text, tags and attributes of a page; refuses tags that are not closed in order."""

    def __init__(self, text: str):
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in _VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open[-1:] != ["style"]:
            self.text += data + " "

    def of(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.tags if name == tag]

    @property
    def pictures(self) -> list[Image.Image]:
        data = [image["src"].removeprefix("data:image/png;base64,") for image in self.of("img")]
        return [Image.open(io.BytesIO(base64.b64decode(text))) for text in data]


@pytest.fixture(scope="module")
def broken(_template, tmp_path_factory):
    """A folder with a deformation that broke cells."""
    folder = tmp_path_factory.mktemp("broken") / "bench"
    shutil.copytree(_template, folder)
    with contextlib.chdir(folder):
        reports = ("--report", "r.json", "--report", "r.html")
        assert run([*RUN, "-s", "constants.turn=80", "--repair", "off", *reports, "-q"]) == 3
    return folder


@pytest.fixture
def far(broken, monkeypatch):
    """A deformation that breaks cells: report in json and as a page."""
    monkeypatch.chdir(broken)
    return json.loads(Path("r.json").read_text()), Page(Path("r.html").read_text())


def test_page_needs_nothing_but_itself_and_its_pictures_show_something(far):
    text = Path("r.html").read_text()
    for attributes in far[1].of("img"):
        assert attributes["src"].startswith("data:image/png;base64,")
    assert not far[1].of("link")
    assert not re.search(r"https?://|@import|url\(", text)
    assert not far[1].of("script")
    assert [image["alt"] for image in far[1].of("img")] == ["Around the walls", "The worst cells"]
    assert all(np.asarray(picture).std() > 10 for picture in far[1].pictures)


def test_verdict_says_how_many_and_where(far):
    report, page = far
    count = report["quality"]["after"]["invalid_cells"]
    assert count > 0
    assert f"{count:,} of {report['grid']['cells']:,} cells became invalid" in page.text
    worst, named = report["invalid_cells"][0], report["quality"]["after"]["worst"]["min_relative_jacobian"]
    assert (worst["block"], worst["ijk"]) == (named["block"], named["ijk"])
    i, j, k = worst["ijk"]
    assert f"the worst is {worst['block']} ({i}, {j}, {k}) near {worst['nearest_patch']!r}" in page.text
    assert "wall-normal deviation rms [deg]" in page.text


def test_run_can_be_repeated_and_files_recognised(far, capsys):
    report, page = far
    for file in report["run"]["files"]:
        data = Path(file["path"]).read_bytes()
        assert file["sha256"] == hashlib.sha256(data).hexdigest()
        assert file["sha256"] in page.text
    assert {file["role"] for file in report["run"]["files"]} == {"grid", "case", "output"}
    words = shlex.split(report["run"]["command"].replace("--report r.html ", ""))
    assert words[0] == "meshdeform"
    again = Path("out.invalid.xyz").read_bytes()
    assert run([*words[1:], "--force"]) == 3
    assert Path("out.invalid.xyz").read_bytes() == again


def test_seconds_of_a_resumed_series_add_up(bench, call):
    assert call(*SERIES, "--report", "a.json").code == 0
    levels = json.loads(Path("levels/series.json").read_text())["levels"]
    assert call(*SERIES, "--resume", "--report", "b.json").code == 0
    timing = json.loads(Path("b.json").read_text())["timing"]
    assert timing["apply"] == pytest.approx(sum(level["timing"]["apply"] for level in levels))
    assert timing.pop("total") == pytest.approx(sum(timing.values()))


def test_names_cannot_break_the_page(far):
    report = far[0] | {"grid": far[0]["grid"] | {"file": "<b>&'\".xyz"}}
    assert "Deformation of <b>&'\".xyz" in Page(as_html(report)).text


def test_series_page_has_curves_and_links(bench, call):
    assert call(*SERIES, "--report", "r.html").code == 0
    page = Page(Path("r.html").read_text())
    assert "All 3 levels are valid" in page.text
    links = {a["href"] for a in page.of("a") if not a["href"].startswith("#")}
    assert len(links) == 3
    assert all(Path(link).is_file() for link in links)
    curves = [svg for svg in page.of("svg") if "over time" in (svg["aria-label"] or "")]
    assert len(curves) == 4


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
