"""Charts of a page: drawings without references to anything else, in the colours of the page."""

import re
from xml.etree import ElementTree

import pytest

from meshdeform_formats.report.page import curve, histogram


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
