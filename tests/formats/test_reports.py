"""Reports as text and as pages: made of the records in `expected/reports.json`, they are compared with files beside it,
letter by letter but for the charts, which are compared with their data."""

from __future__ import annotations

import hashlib
import json
import platform
import re
from datetime import UTC, datetime, timedelta
from importlib.metadata import version
from pathlib import Path

import expected
import numpy as np
import pytest
from matplotlib.figure import Figure as Drawing

from meshdeform_core.errors import FormatError
from meshdeform_core.parallel import thread_count
from meshdeform_formats.report import page
from meshdeform_formats.report.tables import Figure, repair_lines
from meshdeform_formats.report.write import as_json, as_text, run_part, write_report

REPORTS = json.loads(expected.text("reports.json"))


@pytest.mark.parametrize("name", REPORTS)
def test_reports_as_text(name):
    assert as_text(REPORTS[name], name != "good") == expected.text(f"{name}.txt")


@pytest.mark.parametrize("name", [name for name in REPORTS if name not in ("forecast", "brief")])
def test_reports_as_pages(name, monkeypatch):
    figures = [Figure("Title", "Caption <c>", b"png")] if name == "good" else []
    if name != "good":
        monkeypatch.setattr(page, "_svg", lambda draw, label: f'<svg aria-label="{label}"></svg>\n')
    text = page.as_html(REPORTS[name], figures, "a b")
    # It needs nothing but itself.
    assert not re.search(r"https?://|@import|url\(|<link|<script", text)
    text = re.sub(r"(?s)<style>.*?</style>", "<style/>", text)
    text = re.sub(r"(?s)<svg.*?(aria-label=\"[^\"]*\").*?</svg>", r"<svg \1/>", text)
    assert text + "\n" == expected.text(f"{name}.html")


def test_charts_show_their_data(monkeypatch):
    def drawn(draw, label):
        axes = Drawing().add_subplot()
        draw(axes)
        return axes, label

    monkeypatch.setattr(page, "_svg", drawn)
    axes, label = page.histogram([0, 3, 20], [10**7, 1, 0], "f_skew")
    assert (label, axes.get_xlabel(), axes.get_ylabel()) == ("cells over f_skew", "f_skew", "cells")
    after, before = axes.patches
    np.testing.assert_array_equal(after.get_data().values, [10**7, 1, 0])
    np.testing.assert_array_equal(before.get_data().values, [0, 3, 20])
    np.testing.assert_allclose(before.get_data().edges, [0, 1 / 3, 2 / 3, 1])
    assert (after.get_fill(), before.get_fill(), axes.get_yscale()) == (True, False, "log")
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["before", "after"]
    assert (axes.get_xlim(), axes.get_ylim()) == ((0, 1), (0.3, 1.3e7))
    # A single cell is seen, and a few do not fill the chart.
    axes, _ = page.histogram(None, [1, 2], "f_skew")
    assert (len(axes.patches), axes.get_legend(), axes.get_ylim()) == (1, None, (0.3, 13.0))
    assert page.histogram([40], [1], "f_skew")[0].get_ylim() == (0.3, 52.0)
    for count, style in ((60, "o"), (61, "None")):
        axes, label = page.curve(range(count), [3.0] * count, "time", "size", [n in (1, 7) for n in range(count)])
        line, wrong = axes.lines
        assert (label, axes.get_xlabel(), axes.get_ylabel()) == ("size over time", "time", "size")
        assert (line.get_marker(), line.get_linestyle(), wrong.get_linestyle()) == (style, "-", "None")
        assert (list(line.get_xdata()), list(wrong.get_xdata())) == (list(range(count)), [1, 7])
        assert (set(line.get_ydata()), list(wrong.get_ydata())) == ({3.0}, [3.0, 3.0])
        assert line.get_color() != wrong.get_color()


REPAIR, SOUND = REPORTS["mended"]["repair"], REPORTS["mended"]["quality"]["after"]
MOVED = "1 node moved by up to 0.5, 3 Newton steps"
REPAIRED = [
    ({"repair": None}, []),
    ({"repair": None, "new_interior": None, "valid": False}, []),
    ({"repair": None, "new_interior": None, "valid": True}, ["no cell is invalid or weak: nothing to repair"]),
    ({"repair": REPAIR | {"left_out": "too large"}}, ["not repaired: too large"]),
    ({"repair": REPAIR | {"weak": 0, "invalid": 1}}, [f"1 invalid cell repaired, {MOVED}"]),
    ({"repair": REPAIR | {"weak": 0, "invalid": 0}}, [f"no bad cells repaired, {MOVED}"]),
    (
        {"repair": REPAIR | {"weak": 0, "invalid": 3000, "nodes": 2, "newton_steps": 1, "before": SOUND},
         "quality": {"after": SOUND | {"invalid_cells": 1000, "wall_normal_deviation_deg": None}},
         "boundary": {"max_displacement": 0.0}},
        ["not repaired: 1,000 cells of 3,000 invalid cells stay invalid, 2 nodes moved by up to 0.5, 1 Newton step",
         "the method alone -> repaired: smallest scaled Jacobian 0.75 -> 0.75, smallest f_skew 0.5 -> 0.5"],
    ),
]  # fmt: skip


@pytest.mark.parametrize(("report", "lines"), REPAIRED)
def test_repairs_in_words(report, lines):
    assert repair_lines(report) == lines


def test_the_suffix_says_the_form(tmp_path):
    report = REPORTS["good"] | {"peak_memory_bytes": 2**20, "series": {"folder": str(tmp_path / "levels")}}
    report["extra"] = [float("nan"), (float("-inf"), 1.5), {"a": float("inf"), "b": True}]
    for suffix in (".json", ".txt", ".html"):
        write_report(report, tmp_path / f"r{suffix}", lambda: [Figure("A title", "", b"")])
    text = (tmp_path / "r.json").read_text()
    assert text == as_json(report)
    assert json.loads(text)["extra"] == [None, [None, 1.5], {"a": None, "b": True}]
    assert (tmp_path / "r.txt").read_text() == as_text(report)
    assert "<h3>A title</h3>" in (tmp_path / "r.html").read_text()
    torn = REPORTS["torn"]
    write_report(torn | {"series": torn["series"] | {"folder": str(tmp_path / "levels")}}, tmp_path / "t.html")
    assert '<a href="levels/out%201.cgns">' in (tmp_path / "t.html").read_text()
    with pytest.raises(
        FormatError, match=r"^report .*r\.pdf: suffix '\.pdf' is unknown; expected \.json, \.txt, \.html$"
    ):
        write_report(report, tmp_path / "r.pdf")


def test_a_run_names_its_files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("a b").write_bytes(b"12345")
    run = run_part(["deform", "a b"], [("grid", Path("a b")), ("case", None), ("table", Path("gone"))], 3)
    digest = hashlib.sha256(b"12345").hexdigest()
    assert run["files"] == [{"role": "grid", "path": "a b", "bytes": 5, "sha256": digest}]
    assert (run["command"], run["directory"], run["ranks"]) == ("meshdeform deform 'a b'", str(tmp_path), 3)
    assert run["threads"] == thread_count()
    assert run["versions"] == {
        "python": platform.python_version(),
        **{n: version(n) for n in ("numpy", "scipy", "numba")},
    }
    assert len(run["date"]) == len("2026-01-01T00:00:00+00:00")
    assert abs(datetime.fromisoformat(run["date"]) - datetime.now(UTC)) < timedelta(minutes=5)
