"""Reports as text and as pages, made of records in which every number is another one; charts by their data."""

from __future__ import annotations

import copy
import html
import json
import re

import numpy as np
import pytest
from matplotlib.figure import Figure as Drawing

from meshdeform_core.errors import FormatError
from meshdeform_core.series import Schedule
from meshdeform_formats.report import page
from meshdeform_formats.report.records import series_report, with_other
from meshdeform_formats.report.tables import Figure, measures_table, repair_lines, shape_table
from meshdeform_formats.report.write import as_text, write_report

MEASURES = {
    "f_skew harmonic mean": "f_skew harmonic_mean", "f_skew mean": "f_skew mean", "f_skew 1% quantile": "f_skew p01",
    "f_skew minimum": "f_skew min", "smallest scaled Jacobian": "min_scaled_jacobian",
    "smallest relative Jacobian": "min_relative_jacobian", "invalid cells": "invalid_cells",
    "inherited invalid cells": "inherited_invalid_cells", "negative volumes": "negative_volumes",
    **{f"wall-normal deviation {end} [deg]": f"wall_normal_deviation_deg {end}" for end in ("rms", "max")},
    **{f"first cell height ratio {end}": f"first_cell_height_ratio {end}" for end in ("min", "max")},
    **{f"layer thickness ratio {end}": f"walls moving layer_thickness_ratio {end}" for end in ("min", "max")},
    **{f"fixed walls: normal deviation {end} [deg]": f"walls fixed wall_normal_deviation_deg {end}"
       for end in ("rms", "max")},
    **{f"fixed walls: first cell ratio {end}": f"walls fixed first_cell_height_ratio {end}" for end in ("min", "max")},
    **{f"fixed walls: layer ratio {end}": f"walls fixed layer_thickness_ratio {end}" for end in ("min", "max")},
    **{f"interface kink {end} [deg]": f"interface_kink_deg {end}" for end in ("rms", "max")},
    **{f"interface spacing jump {end}": f"interface_spacing_jump {end}" for end in ("rms", "max")},
    **{f"volume ratio {end}": f"volume_ratio {end}" for end in ("min", "max")}, "total volume": "total_volume",
}  # fmt: skip


def quality(first: int) -> dict:
    """Measures that are numbers from ``first`` on, in the order of `MEASURES`."""
    found: dict = {}
    for n, path in enumerate(MEASURES.values(), start=first):
        *parts, last = path.split()
        entry = found
        for part in parts:
            entry = entry.setdefault(part, {})
        entry[last] = n
    found["f_skew"]["histogram"] = [0, 2, 5]
    return found


BOTH = {"before": quality(100), "after": quality(200)}


def test_every_measure_has_its_row():
    table = measures_table({"quality": BOTH})
    assert table.heads == ("measure", "before", "after", "worst at")
    assert table.rows == [(name, 100 + n, 200 + n, "") for n, name in enumerate(MEASURES)]
    assert [table.rows[n][0] for n in table.flagged] == ["invalid cells"]
    # A grid by itself is compared with nothing.
    table = measures_table({"quality": BOTH, "reference": None})
    assert (table.heads, len(table.rows)) == (("measure", "value", "worst at"), len(MEASURES) - 11)
    assert table.rows[-1] == ("total volume", 200 + len(MEASURES) - 1, "")


def test_only_extremes_have_a_worst_cell():
    places = {key: {"block": key, "ijk": [1, 2, 3]} for key in ("f_skew", "volume_ratio_min", "interface_kink_deg")}
    after = copy.deepcopy(BOTH["after"]) | {"worst": places}
    after["walls"]["moving"]["worst"] = {"layer_thickness_ratio_max": {"block": "w", "ijk": [4, 5, 6]}}
    found = {name: place for name, *_, place in measures_table({"quality": BOTH | {"after": after}}).rows if place}
    assert found == {
        "f_skew minimum": "f_skew (1, 2, 3)", "layer thickness ratio max": "w (4, 5, 6)",
        "interface kink max [deg]": "interface_kink_deg (1, 2, 3)", "volume ratio min": "volume_ratio_min (1, 2, 3)",
    }  # fmt: skip


def test_shapes_of_a_grid_by_itself_have_no_column_before():
    after = {"skewness": {"max": 2.0, "mean": 1.0, "worst": None}}
    for before, row in ((None, (2.0, 1.0, "")), ({"skewness": {"max": 1.5}}, (1.5, 2.0, 1.0, ""))):
        table = shape_table({"shape": {"before": before, "after": after}})
        assert (table.rows, len(table.heads)) == ([("skewness", *row)], len(row) + 1)


MATCH = {"table": "t.csv", "match": "nearest", "matched_nodes": 1000, "unmatched_nodes": 2000, "table_points": 3000,
         "table_points_used": 1500, "max_distance": 0.00012345, "walls": ["wing", "flap"]}  # fmt: skip
PLAN = {
    "schema": 1, "meshdeform": "1.2.3", "warnings": ["first <b>", "second"],
    "grid": {"file": "a & b.cgns", "format": "CGNS", "dimension": 3, "blocks": 1, "nodes": 12345, "cells": 1000},
    "method": {"name": "rbf", "radius": {"value": 1234567, "reason": "half the size"}, "basis": {"value": "ctps"}},
    "boundary": {"patches": [{"name": "wing", "kind": "moving", "nodes": 1234}], "moving_nodes": 1234, "fixed_nodes": 5,
                 "max_displacement": 2.0, "matches": [MATCH]},
    "motion": [
        {"boundary": "wing", "max_displacement": 2.0, "mean_displacement": [1e-12, 0.123456, -1.0],
         "max_rotation_deg": 12.34567, "rotation_axis": [0.1, -0.9995, 0]},
    ],
    "expected": {"work_bytes": 2**20, "output_bytes": 2**31, "memory_bytes": 2**30, "ranks": 4},
}  # fmt: skip
LINES = """grid      a & b.cgns: CGNS
          3-D, 1 block, 12,345 nodes, 1,000 cells
method    rbf
boundary  name  kind    nodes
          wing  moving  1,234
nodes     1,234 moving, 5 fixed
table     t.csv: fits 'wing', 'flap'; 1,000 nodes matched (nearest, at most 0.000123 away), 2,000 not; 1,500 of 3,000
motion    largest displacement 2
          wing: up to 2, mean (0, 0.1235, -1), rotated by up to 12.35 degrees about -y
settings  parameter  value      why
          radius     1,234,567  half the size
          basis      ctps       given or default
expected  memory 1 GiB on each of 4 ranks; disk 1 MiB of files to work in and 2 GiB for the output
warning   first <b>
warning   second"""


def test_a_plan_as_text():
    for line, start in zip(as_text(PLAN).splitlines(), LINES.splitlines(), strict=True):
        assert line == start + (" table points used" if "of 3,000 table" in line else "")
    assert "method    rbf  (-v shows its parameters)\nboundary" in as_text(PLAN, False)
    assert "settings" not in as_text(PLAN, False)


REPAIR = {"invalid": 2, "weak": 10, "nodes": 1, "max_movement": 0.5, "newton_steps": 3, "converged": True,
          "before": None, "left_out": None}  # fmt: skip
CELL = {"block": "b", "ijk": [1, 2, 3], "min_jacobian": -0.0123456, "step": 2, "nearest_patch": "wing",
        "center": [1.0, -2.5, 123456.7]}  # fmt: skip
DONE = PLAN | {
    "quality": BOTH, "valid": False, "steps": 3, "reached": 0.5, "repair": None, "peak_memory_bytes": 3 * 2**20,
    "invalid_cells": [CELL | {"ijk": [n, 2, 3]} for n in range(1, 23)], "timing": {"read": 0.123, "total": 1.5},
    "attempts": [{"method": "rbf", "steps": 1, "repair": False, "invalid_cells": 7, "reached": 0.25}],
}  # fmt: skip


def test_a_deformation_as_text():
    text = as_text(DONE)
    assert text.startswith("verdict   INVALID\n          b (1, 2, 3): Jacobian -0.0123, step 2, nearest patch wing\n")
    assert text.count("Jacobian -0.0123") == 20
    assert "\n          ... 2 more in the json report\nsteps     3, 50.0% of the motion imposed\nworst     " in text
    assert "up to 210 degrees, first cells 211 to 212 times as high\n" in text
    assert "seconds   read 0.12  total 1.50\nmemory    3 MiB at most\n" in text
    done = DONE | {"valid": True, "invalid_cells": [], "reached": 1.0, "repair": REPAIR | {"converged": False}}
    assert as_text(done).startswith("verdict   valid\nsteps     3, then repaired (below)\nworst     smallest scaled")


VERDICTS = [
    ({"steps": 1}, ["Only 50.0% of the motion was imposed", "--repair auto.</li><li>Try another",
                    "is b (1, 2, 3) near 'wing', around x, y, z = 1, -2.5, 1.235e+05"]),
    ({"reached": 1.0}, ["206 of 1,000 cells became invalid.", "--repair auto", "-m idw-tfi keeps walls"]),
    ({"reached": 1.0, "steps": 1}, ["a valid grid requires: --steps auto"]),
    ({"valid": True}, ["No cell became invalid; 207 cells were invalid before."]),
    ({"grid": DONE["grid"] | {"file": "<b>&'\".xyz"}}, ["Deformation of <b>&'\".xyz"]),
]  # fmt: skip


@pytest.mark.parametrize(("changes", "words"), VERDICTS)
def test_a_page_needs_nothing_but_itself_and_says_what_happened(changes, words):
    text = page.as_html(DONE | changes, [Figure("Title", "Caption <c>", b"png")])
    assert not re.search(r"https?://(?!www\.w3\.org)|@import|url\(|<link|<script|<b>", text)
    text = html.unescape(text)
    assert [word for word in (*words, "Caption <c>", "first <b>", "<td>1,234</td>") if word not in text] == []
    # One row for each measure, and the first twelve of the invalid cells.
    assert all(f'<td class="text">{name}</td><td>{n}</td>' in text for n, name in enumerate(MEASURES, start=100))
    assert text.count("1, -2.5, 1.2346e+05</td><td>-0.0123456</td><td>2</td>") == 12


def level(number: int, **changes) -> dict:
    return {"number": number, "time": 0.1234567 * number, "file": f"out {number}.cgns", "max_displacement": 0.123456,
            "max_rotation_deg": 1.234, "quality": BOTH["after"] | {"f_skew": {"mean": 0.91, "min": 0.5}}, "steps": 1,
            "valid": True, "reached": 1.0, "timing": {"total": 0.5}} | changes  # fmt: skip


SERIES = DONE | {
    "series": {"levels": 3, "view": "all.pvd", "folder": "out"},
    "quality": {"before": {"f_skew": {"mean": 0.9, "min": 0.4}}},
    "levels": [level(1), level(2, smoothness={"acceleration": 2 / 3}, repair={"left_out": "large"}),
               level(3, valid=False, repair={"left_out": None, "converged": True}, reached=0.5)],
}  # fmt: skip


def test_a_series_as_text_and_as_a_page():
    lines = [line.split() for line in as_text(SERIES).splitlines()]
    assert ["series", "3", "levels,", "each", "from", "the", "undeformed", "grid"] in lines
    assert ["f_skew", "before:", "mean", "0.9000,", "minimum", "0.4000"] in lines
    assert ["accel.", "largest", "acceleration"] in [line[:3] for line in lines]
    same = ["0.1235", "1.23", "0.9100", "0.5000", "206"]
    for number, time, more in ((1, "0.123457", []), (2, "0.246913", ["0.667", "no"]), (3, "0.37037", ["yes"])):
        assert [str(number), time, "out", f"{number}.cgns", *same, *more, "1", "0.50"] in lines
    text = page.as_html(SERIES, [], "a b")
    for words in ('href="a%20b/out%202.cgns"', "1 of 3 levels are not valid.",
                  "level 3 (t = 0.37037): only 50.0% of the motion imposed"):  # fmt: skip
        assert words in text
    assert text.count("<tr class=flagged>") == 1
    assert "All 2 levels are valid." in page.as_html(SERIES | {"levels": [level(1), level(2)]})
    bad = re.sub("<[^>]*>", "\n", page.as_html(SERIES | {"levels": [level(n, valid=False) for n in range(14)]}))
    assert re.search("level 11 .t = 1.35802.: 206 cells became invalid\\s+and 2 more\\s+What to do:", bad)


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
    assert (after.get_fill(), before.get_fill(), axes.get_yscale()) == (True, False, "log")
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["before", "after"]
    assert (axes.get_xlim(), axes.get_ylim()) == ((0, 1), (0.3, 1.3e7))
    assert page.histogram(None, [1, 2], "f_skew")[0].get_ylim() == (0.3, 13.0)
    axes, label = page.curve([0, 1, 2], [3.0, 2.5, 2.0], "time", "size", [False, True, False])
    line, wrong = axes.lines
    assert (label, axes.get_xlabel(), axes.get_ylabel()) == ("size over time", "time", "size")
    assert (list(line.get_ydata()), list(wrong.get_xdata()), list(wrong.get_ydata())) == ([3.0, 2.5, 2.0], [1], [2.5])


SOUND = {"invalid_cells": 0, "min_scaled_jacobian": 0.75, "f_skew": {"min": 0.5},
         "wall_normal_deviation_deg": {"rms": 2.0}}  # fmt: skip
MOVED = "1 node moved by up to 0.5, 3 Newton steps"
WEAK = "weak: sheared by more than 45 degrees, or twice or half as long in one direction"
REPAIRED = [
    ({"repair": None}, []),
    ({"repair": None, "new_interior": None, "valid": False}, []),
    ({"repair": REPAIR | {"invalid": 0, "weak": 1}}, ["1 weak cell repaired, " + MOVED, WEAK]),
    ({"repair": None, "new_interior": None, "valid": True}, ["no cell is invalid or weak: nothing to repair"]),
    ({"repair": REPAIR | {"left_out": "too large"}}, ["not repaired: too large"]),
    (
        {"repair": REPAIR | {"before": SOUND | {"invalid_cells": 2, "min_scaled_jacobian": -0.25}},
         "quality": {"after": SOUND | {"f_skew": {"min": 0.25}}}, "boundary": {"max_displacement": 2.0}},
        ["2 invalid and 10 weak cells repaired, 1 node moved by up to 0.5 (0.25 of the largest displacement), 3 Newton "
         "steps", "the method alone -> repaired: smallest scaled Jacobian -0.25 -> 0.75, smallest f_skew 0.5 -> 0.25, "
         "angle at walls 2 -> 2 degrees rms, invalid cells 2 -> 0",
         WEAK],
    ),
    ({"repair": REPAIR | {"weak": 0}, "quality": {"after": SOUND | {"invalid_cells": 1000}}},
     [f"not repaired: 1,000 cells of 2 invalid cells stay invalid, {MOVED}"]),
]  # fmt: skip


@pytest.mark.parametrize(("report", "lines"), REPAIRED)
def test_repairs_in_words(report, lines):
    assert repair_lines(report) == lines


def test_a_report_of_a_series_is_over_all_levels():
    """The stages of a level that no other has, too; warnings with the number of their level."""
    parts = [(0.5, True, [], {"apply": 1.0, "total": 1.5}), (2.0, False, ["odd"], {"apply": 2.0, "repair": 4.0}),
             (1.0, True, ["a", "b"], {"write": 8.0})]  # fmt: skip
    levels = [dict(zip(("number", "max_displacement", "valid", "warnings", "timing"), (n, *part), strict=True))
              for n, part in enumerate(parts)]  # fmt: skip
    head, places = {"boundary": {"fixed_nodes": 3}, "warnings": ["first"]}, {"folder": "out", "view": None}
    schedule = Schedule((0.0, 1.0, 2.0), "first")
    assert series_report(head, levels, schedule, places, {"read": 16.0}, 7) == {
        "boundary": {"fixed_nodes": 3, "max_displacement": 2.0}, "levels": levels, "valid": False,
        "series": {"levels": 3, "velocity": "first", **places}, "peak_memory_bytes": 7,
        "timing": {"read": 16.0, "apply": 3.0, "repair": 4.0, "write": 8.0},
        "warnings": ["first", "level 1: odd", "level 2: a", "level 2: b"],
    }  # fmt: skip
    still = series_report(head, [levels[0] | {"max_displacement": 0.0}], schedule, places, {}, 7)
    assert (still["valid"], still["warnings"][1:]) == (True, ["nothing moves: the displacement is zero at all levels"])
    assert with_other({"a": 2.0, "other": 1.0, "total": 9.0}, 5.0) == {"a": 2.0, "other": 3.0, "total": 5.0}
    assert with_other({"a": 2.0}, 1.5) == {"a": 2.0, "other": 0.0, "total": 2.0}


def test_the_suffix_says_the_form(tmp_path):
    extra = (float("nan"), True)
    for suffix in (".json", ".txt", ".html"):
        write_report(DONE | {"extra": extra}, tmp_path / f"r{suffix}", lambda: [Figure("A title", "", b"")])
    assert json.loads((tmp_path / "r.json").read_text())["extra"] == [None, True]
    assert (tmp_path / "r.txt").read_text() == as_text(DONE)
    assert "<h3>A title</h3>" in (tmp_path / "r.html").read_text()
    with pytest.raises(FormatError, match=r"r\.pdf: suffix '\.pdf' is unknown; expected \.json, \.txt, \.html$"):
        write_report(DONE, tmp_path / "r.pdf")
