"""Tables that reports show as Markdown and on pages."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any
from urllib.parse import quote

from .measures import measure_rows
from .records import Report
from .series_text import acceleration_of, repaired


@dataclass(frozen=True)
class Link:
    """A name with the file that it stands for."""

    name: str
    file: str

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True)
class Table:
    """Rows of texts, numbers (``None``: no value) and links.

    ``texts`` are numbers of columns of texts, all others hold numbers; ``flagged`` numbers of the rows to highlight;
    ``sortable``: by every column, where scripts run.
    """

    caption: str
    heads: Sequence[str]
    rows: Sequence[Sequence[Any]]
    texts: Sequence[int] = (0,)
    flagged: Sequence[int] = ()
    sortable: bool = False


def number(value: Any) -> str:
    """A formatted value: six digits, thousands separated; texts as they are, nothing for ``None``."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return "" if value is None else str(value)
    return f"{value:,}" if isinstance(value, int) else f"{value:.6g}"


def is_alone(report: Report) -> bool:
    """Whether a grid was judged by itself: it has nothing to be compared with."""
    return "reference" in report and report["reference"] is None


def measures_table(report: Report, change: bool = False) -> Table:
    """All measures with the position of the worst cell."""
    alone = is_alone(report)
    found = [row for row in measure_rows(report["quality"]) if not (alone and row.compared)]
    values = ("value",) if alone else ("before", "after", *(("change",) if change else ()))
    rows = [
        (
            row.name,
            *(() if alone else (row.before,)),
            row.after,
            *((row.change,) if "change" in values else ()),
            row.place,
        )
        for row in found
    ]
    flagged = [n for n, row in enumerate(found) if row.name == "invalid cells" and row.after]
    caption = "Quality measures; f_skew is Knupp's skew measure: 1 orthogonal, 0 invalid"
    return Table(caption, ("measure", *values, "worst at"), rows, (0, len(values) + 1), flagged)


def components_table(report: Report) -> Table:
    """The components of an overset grid: each has a verdict of its own."""
    parts = report.get("components", ())
    heads = ("component", "blocks", "nodes", "moving", "largest displacement", "verdict", "steps", "f_skew min")
    rows = [
        (
            part["name"], len(part["blocks"]), part["nodes"], part["moving_nodes"], part["max_displacement"],
            component_verdict(part), part["steps"], part["quality"]["after"]["f_skew"]["min"],
        )
        for part in parts
    ]  # fmt: skip
    flagged = [n for n, part in enumerate(parts) if not part["valid"]]
    return Table(f"{len(rows)} components, each moved by its own boundary", heads, rows, (0, 5), flagged)


def component_verdict(part: Report) -> str:
    """Whether a component is valid, and how that was reached."""
    if part["reached"] < 1.0:
        return f"INVALID, {part['reached']:.1%} of the motion imposed"
    how = f"{part['steps']:,} step{'s' if part['steps'] != 1 else ''}{', repaired' if part['repair'] else ''}"
    bad = part["invalid_cells"]
    return f"valid, {how}" if part["valid"] else f"INVALID, {bad:,} cell{'s' if bad != 1 else ''}, {how}"


def levels_table(report: Report, folder: str = "") -> Table:
    """The levels of a series, with links to their files in ``folder``."""
    heads = (
        "level", "time", "file", "moved", "rotated [deg]", "f_skew mean", "f_skew min", "invalid", "acceleration",
        "repaired", "steps", "seconds",
    )  # fmt: skip
    rows = []
    for level in report["levels"]:
        skew, acceleration = level["quality"]["f_skew"], acceleration_of(level)
        rows.append((
            f"{level['number']}", f"{level['time']:.6g}", Link(level["file"], level_link(folder, level["file"])),
            f"{level['max_displacement']:.4g}", f"{level['max_rotation_deg']:.2f}", f"{skew['mean']:.4f}",
            f"{skew['min']:.4f}", f"{level['quality']['invalid_cells']}",
            "" if acceleration is None else f"{acceleration:.3f}", repaired(level), f"{level['steps']}",
            f"{level['timing']['total']:.2f}",
        ))  # fmt: skip
    flagged = [n for n, level in enumerate(report["levels"]) if not level["valid"]]
    return Table("All levels", heads, rows, (2, 9), flagged, sortable=True)


def level_link(folder: str, name: str) -> str:
    """A file in ``folder`` as the address of a link."""
    return quote(PurePath(folder, name).as_posix())
