"""What the forms of a report have in common: sentences on repairs, advice on warnings, charts in the page's colours."""

from __future__ import annotations

import ast
import re
from pathlib import Path
from xml.etree import ElementTree

import pytest

import meshdeform_core
from meshdeform_formats.report.measures import change_of
from meshdeform_formats.report.page import REMEDIES, curve, histogram
from meshdeform_formats.report.tables import repair_sentence

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
    assert repair_sentence(report) == (
        "2 invalid and 10 weak cells repaired, 1 node moved by up to 0.5 (0.25 of the largest displacement), 3 Newton "
        "steps; the method alone -> repaired: smallest scaled Jacobian -0.25 -> 0.75, smallest f_skew 0.5 -> 0.5, "
        f"angle at walls 2 -> 2 degrees rms, invalid cells 2 -> 0; {WEAK}"
    )


def test_round_off_is_no_change():
    assert change_of(76.875, 76.875 - 1.4e-14) == 0.0
    assert change_of(76.875, 76.874) == 76.874 - 76.875


def test_advice_is_for_warnings_that_there_are():
    texts = []
    for path in Path(meshdeform_core.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            parts = node.values if isinstance(node, ast.JoinedStr) else [node]
            texts.append("".join(p.value for p in parts if isinstance(p, ast.Constant) and isinstance(p.value, str)))
    assert [words for words, _ in REMEDIES if not any(words in text for text in texts)] == []


@pytest.mark.parametrize(
    ("svg", "label", "colours"),
    [
        (histogram([0, 3, 1], [1, 10**7, 0], "f_skew"), "cells over f_skew", {"before", "after"}),
        (histogram(None, [0, 0, 5], "f_skew"), "cells over f_skew", {"after"}),
        (curve([0, 1, 2], [3.0, 2.5, 2.0], "time", "size", [False, True, False]), "size over time", {"after", "bad"}),
    ],
)
def test_charts_are_elements_of_the_page(svg, label, colours):
    root = ElementTree.fromstring(svg.replace("xlink:href", "href"))
    assert (root.tag, root.get("role"), root.get("aria-label")) == ("svg", "img", label)
    assert not re.search(r"https?:|url\(|#0[1-5]0", svg)
    assert set(re.findall(r"var\(--(\w+)\)", svg)) == colours | {"line"}
    assert "currentColor" in svg
