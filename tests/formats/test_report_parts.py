"""What the forms of a report have in common: sentences on repairs, charts."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import pytest

from meshdeform_formats.report.page import curve, histogram
from meshdeform_formats.report.tables import change_of, measure_values, repair_lines, shape_table

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


def test_round_off_is_no_change():
    assert change_of(76.875, 76.875 - 1.4e-14) == 0.0
    assert change_of(76.875, 76.874) == 76.874 - 76.875


@pytest.mark.parametrize(
    ("svg", "label"),
    [
        (histogram([0, 3, 1], [1, 10**7, 0], "f_skew"), "cells over f_skew"),
        (histogram(None, [0, 0, 5], "f_skew"), "cells over f_skew"),
        (curve([0, 1, 2], [3.0, 2.5, 2.0], "time", "size", [False, True, False]), "size over time"),
    ],
)
def test_charts_are_elements_of_the_page(svg, label):
    root = ElementTree.fromstring(svg.replace("xlink:href", "href"))
    assert (root.tag, root.get("role"), root.get("aria-label")) == ("svg", "img", label)
    assert not re.search(r"https?:|url\(", svg)


def test_only_extremes_have_a_worst_cell():
    worst = {"f_skew": {"block": "b", "ijk": [1, 2, 3]}}
    quality = {"f_skew": {"harmonic_mean": 0.8, "mean": 0.9, "p01": 0.6, "min": 0.5}, "worst": worst}
    places = {name: place for name, *_, place in measure_values({"before": quality, "after": quality})}
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
