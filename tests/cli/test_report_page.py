"""The report as a page: complete without anything else, true to the report in json, without scripts."""

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
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from meshdeform_cli.main import run
from meshdeform_formats.report.page import as_html

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


def test_page_needs_nothing_but_itself(far):
    text = Path("r.html").read_text()
    for attributes in far[1].of("img"):
        assert attributes["src"].startswith("data:image/png;base64,")
        assert attributes["alt"]
    assert not far[1].of("link")
    assert not re.search(r"https?://|@import|url\(", text)
    assert not far[1].of("script")


def test_pictures_show_something(far):
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


def test_run_can_be_repeated_and_files_recognised(far, capsys):
    report, page = far
    for file in report["run"]["files"]:
        data = Path(file["path"]).read_bytes()
        assert file["sha256"] == hashlib.sha256(data).hexdigest()
        assert file["sha256"] in page.text
    assert {file["role"] for file in report["run"]["files"]} == {"grid", "case", "output"}
    words = shlex.split(report["run"]["command"])
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
