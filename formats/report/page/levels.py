"""A series in a page: curves over time, thumbnails, a table with every level linked."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import PurePath
from typing import Any
from urllib.parse import quote

from ..figures import Figure
from ..parts import Report
from ..series_text import ACCELERATION, acceleration_of, repaired
from .charts import curve
from .figures import thumbnail_lines

_HEADS = (
    "level", "time", "file", "moved", "rotated [deg]", "f_skew mean", "f_skew min", "invalid", "acceleration",
    "repaired", "steps", "seconds",
)  # fmt: skip
_TEXT = ("file", "repaired")


def level_tiles(report: Report) -> list[tuple[str, Any]]:
    """Worst over all levels."""
    levels = report["levels"]
    worst = min(levels, key=lambda level: level["quality"]["f_skew"]["min"])
    return [
        ("levels", f"{len(levels)}, t = {levels[0]['time']:g} to {levels[-1]['time']:g}"),
        ("smallest f_skew", f"{worst['quality']['f_skew']['min']:.4f} (level {worst['number']})"),
        ("largest displacement", f"{report['boundary']['max_displacement']:.5g}"),
        ("method", report["method"]["name"]),
        ("seconds", f"{report['timing']['total']:.2f}"),
    ]


def levels_section(report: Report, thumbnails: Sequence[tuple[Figure, str]], folder: str) -> str:
    """Curves, pictures, table."""
    html = _curves(report["levels"]) if len(report["levels"]) > 1 else ""
    if thumbnails:
        linked = [(figure, _link(folder, name)) for figure, name in thumbnails]
        html += f"<h3>Pictures</h3>{''.join(thumbnail_lines(linked))}"
    return html + "<h3>All levels</h3>" + _table(report, folder)


def _link(folder: str, name: str) -> str:
    return quote(PurePath(folder, name).as_posix())


def _curves(levels: Sequence[Report]) -> str:
    time, wrong = [level["time"] for level in levels], [not level["valid"] for level in levels]
    values: dict[str, list[float | None]] = {
        "smallest f_skew": [level["quality"]["f_skew"]["min"] for level in levels],
        "mean f_skew": [level["quality"]["f_skew"]["mean"] for level in levels],
        "largest displacement": [level["max_displacement"] for level in levels],
        "largest rotation [deg]": [level["max_rotation_deg"] for level in levels],
        "acceleration [steps of the walls]": [acceleration_of(level) for level in levels],
    }
    charts = "".join(_chart(name, time, data, wrong) for name, data in values.items() if any(data))
    return f'<div class="charts">{charts}</div>'


def _chart(name: str, time: Sequence[float], values: Sequence[float | None], wrong: Sequence[bool]) -> str:
    """A curve of the levels that have a value; empty for fewer than two."""
    known = [(time[n], value, wrong[n]) for n, value in enumerate(values) if value is not None]
    if len(known) < 2:
        return ""
    at, shown, bad = ([each[0] for each in known], [each[1] for each in known], [each[2] for each in known])
    return f"<div><h3>{name}</h3>{curve(at, shown, 'time', name, bad)}</div>"


def _table(report: Report, folder: str) -> str:
    rows = "".join(_row(level, folder) for level in report["levels"])
    heads = "".join(f'<th scope="col"{" class=text" if name in _TEXT else ""}>{name}</th>' for name in _HEADS)
    return (
        '<div class="scroll" tabindex="0" role="region" aria-label="All levels"><table class="sortable">'
        f"<thead><tr>{heads}</tr></thead><tbody>{rows}</tbody></table></div><p>Acceleration: {ACCELERATION}.</p>"
    )


def _row(level: Report, folder: str) -> str:
    skew, acceleration = level["quality"]["f_skew"], acceleration_of(level)
    cells = (
        f"{level['number']}", f"{level['time']:.6g}", None, f"{level['max_displacement']:.4g}",
        f"{level['max_rotation_deg']:.2f}", f"{skew['mean']:.4f}", f"{skew['min']:.4f}",
        f"{level['quality']['invalid_cells']}", "" if acceleration is None else f"{acceleration:.3f}", repaired(level),
        f"{level['steps']}", f"{level['timing']['total']:.2f}",
    )  # fmt: skip
    name = f'<td class="text"><a href="{escape(_link(folder, level["file"]))}">{escape(level["file"])}</a></td>'
    body = "".join(name if cell is None else f"<td>{cell}</td>" for cell in cells)
    return f"<tr{'' if level['valid'] else ' class=flagged'}>{body}</tr>"
