"""Axes of the charts of a page."""

from __future__ import annotations

import pytest

from meshdeform_formats.report.page.charts import labels, ticks


@pytest.mark.parametrize(
    "ends", [(0, 1), (0.99912, 0.99923), (0.9999991, 0.9999993), (1, 1), (0, 2.5e-4), (3 + 1e-11, 3 + 2e-11), (-1e9, 1)]
)
def test_labels_are_distinct_and_right(ends):
    values = ticks(*ends)
    texts = labels(values)
    assert len(set(texts)) == len(values)
    first = float(texts[0])
    numbers = [first, *((float(t[1:]) + first if t.startswith("+") else float(t)) for t in texts[1:])]
    assert numbers == pytest.approx(values, rel=1e-5, abs=1e-3 * (values[-1] - values[0]))
