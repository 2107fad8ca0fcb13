"""Reports as one self-contained html page."""

from __future__ import annotations

from html import escape
from typing import Any

from .text import as_text, measure_rows

_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>{title}</title><style>
body {{ font: 15px/1.45 system-ui, sans-serif; margin: 2rem auto; max-width: 60rem; color: #222; }}
table {{ border-collapse: collapse; }} th, td {{ padding: .2rem .8rem; text-align: right; }}
th:first-child, td:first-child {{ text-align: left; }} tr:nth-child(even) {{ background: #f3f4f6; }}
pre {{ background: #f3f4f6; padding: 1rem; overflow-x: auto; }} .bad {{ color: #b00020; }} .good {{ color: #0a6b2d; }}
</style></head><body><h1>{title}</h1><p class="{tone}">{verdict}</p>
{measures}<h2>All of it</h2><pre>{text}</pre></body></html>
"""
_MEASURES = """<table><tr><th>measure</th><th>before</th><th>after</th></tr>{rows}</table>
<h2>Distribution of f_skew</h2>{histogram}"""
_WIDTH, _HEIGHT = 600, 180


def as_html(report: dict[str, Any]) -> str:
    """The report as a page: verdict, table and histogram (of a single deformation), text."""
    one = "levels" not in report
    verdict = "The grid is valid." if one else "All levels are valid."
    if not report["valid"]:
        verdict = f"{'The grid' if one else 'A level'} has invalid cells, or the motion is incomplete."
    return _PAGE.format(
        title=f"meshdeform: {escape(str(report['grid']['file'] or 'grid'))}",
        tone="good" if report["valid"] else "bad",
        verdict=verdict,
        measures=_measures(report) if one else "",
        text=escape(as_text(report)),
    )


def _measures(report: dict[str, Any]) -> str:
    rows = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in measure_rows(report))
    quality = report["quality"]
    return _MEASURES.format(rows=rows, histogram=_histogram(quality["before"]["f_skew"], quality["after"]["f_skew"]))


def _histogram(before: dict[str, Any], after: dict[str, Any]) -> str:
    """Cells per bin of f_skew, before in grey, after in blue, on a square-root scale so that few bad cells show."""
    bins = len(after["histogram"])
    top = max(*before["histogram"], *after["histogram"], 1)
    bars = []
    for n in range(bins):
        for counts, color, shift in ((before, "#b9bec7", 0.08), (after, "#2866b1", 0.5)):
            height = _HEIGHT * (counts["histogram"][n] / top) ** 0.5
            x = (n + shift) * _WIDTH / bins
            bars.append(
                f'<rect x="{x:.1f}" y="{_HEIGHT - height:.1f}" width="{0.4 * _WIDTH / bins:.1f}" '
                f'height="{height:.1f}" fill="{color}"><title>{counts["histogram"][n]} cells</title></rect>'
            )
    ticks = "".join(
        f'<text x="{f * _WIDTH:.0f}" y="{_HEIGHT + 16}" font-size="12" text-anchor="middle">{f:.1f}</text>'
        for f in (0.0, 0.2, 0.4, 0.6, 0.8, 1.0)
    )
    return (
        f'<svg viewBox="-15 0 {_WIDTH + 30} {_HEIGHT + 24}" width="{_WIDTH}">{"".join(bars)}{ticks}</svg>'
        "<p>grey: before, blue: after; square-root scale</p>"
    )
