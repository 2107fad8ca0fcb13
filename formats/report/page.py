"""Reports as one self-contained page: the contents of its sections; the template ``page.html.jinja`` shows them."""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from importlib.resources import files
from pathlib import PurePath
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import jinja2
import numpy as np

from meshdeform_core.boundary import Kind
from meshdeform_core.deform import Result
from meshdeform_core.memory import readable
from meshdeform_core.wording import counted

from ..picture.overview import moved_walls, quality_planes, worst_cells
from ..picture.page import STYLE, page_bytes
from ..picture.subject import Subject, worst_cell
from . import tables
from .records import Report
from .tables import Figure, Table

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_SHOWN = 12
"""Invalid cells and levels that the page lists."""

# Seen on light and on dark pages.
_BEFORE, _AFTER, _BAD, _INK = "#8a94a0", "#3d82d6", "#d1242f", "#7d8590"
_COLOURS = dict.fromkeys(("axes.edgecolor", "axes.labelcolor", "xtick.color", "ytick.color", "grid.color"), _INK)
_LEAST = 0.3

Sections = Iterator[tuple[str, Sequence[Any]]]
"""Heading and parts: texts, tables, figures and dictionaries of what else the template shows."""


def as_html(report: Report, figures: Sequence[Figure] = (), folder: str = "") -> str:
    """The report as a self-contained page.

    Parameters
    ----------
    figures : pictures of a deformation, shown after the verdict
    folder : of the levels, relative to the page
    """
    template, style = (
        files(__package__).joinpath(file).read_text(encoding="utf-8") for file in ("page.html.jinja", "style.css")
    )
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    environment.filters |= {"number": tables.number, "base64": lambda png: base64.b64encode(png).decode("ascii")}
    series, grid = "levels" in report, report["grid"]
    name, kind = str(grid["file"] or "grid"), f"{grid['format']}, " if grid["format"] else ""
    blocks, cells = counted(grid["blocks"], "block"), counted(grid["cells"], "cell")
    title = f"{'Deformation' if 'method' in report else 'Quality'} of {name}"
    sections = [
        *(_levels(report) if series else [("Pictures", figures), *_judged(report)]),
        *_common_sections(report),
    ]
    return environment.from_string(template).render(
        report=report,
        title=f"Series of {len(report['levels'])} levels: {name}" if series else title,
        about=f"{kind}{grid['dimension']}-D, {blocks}, {grid['nodes']:,} nodes, {cells}",
        verdict=_verdict_of_levels(report) if series else _verdict(report),
        sections=[section for section in sections if section[1]],
        style=style,
        links={level["file"]: quote(PurePath(folder, level["file"]).as_posix()) for level in report.get("levels", ())},
    )


def _verdict_of_levels(report: Report) -> dict[str, Any]:
    """Headline, repair, places and advice of a series."""
    bad = [level for level in report["levels"] if not level["valid"]]
    if not bad:
        return {"headline": f"All {len(report['levels'])} levels are valid."}
    places = []
    for level in bad[:_SHOWN]:
        what = f"{level['quality']['invalid_cells']:,} cells became invalid"
        if level["reached"] < 1.0:
            what = f"only {level['reached']:.1%} of the motion imposed"
        places.append(f"level {level['number']} (t = {level['time']:g}): {what}")
    return {
        "headline": f"{len(bad)} of {len(report['levels'])} levels are not valid.",
        "places": places + ([f"and {len(bad) - _SHOWN} more"] if len(bad) > _SHOWN else []),
        "advice": ["--steps auto, or another method."],
    }


def _verdict(report: Report) -> dict[str, Any]:
    """Whether the grid is usable, and its repair; if not, where and why not, and what to do."""
    after = report["quality"]["after"]
    if report["valid"]:
        headline = "The grid is valid."
        if old := after["inherited_invalid_cells"]:
            headline = f"No cell became invalid; {old:,} cells were invalid before."
        return {"headline": headline, "how": "; ".join(tables.repair_lines(report))}
    reached, places = report.get("reached", 1.0), []
    for cell in report["invalid_cells"][:1]:
        near = f" near {cell['nearest_patch']!r}" if cell["nearest_patch"] else ""
        at = ", ".join(f"{x:.4g}" for x in cell["center"])
        places.append(f"the worst is {tables.place_text(cell)}{near}, around x, y, z = {at}")
    headline = f"{after['invalid_cells']:,} of {report['grid']['cells']:,} cells became invalid."
    if reached < 1.0:
        headline = f"Only {reached:.1%} of the motion was imposed; the next step would have made cells invalid."
    if "method" not in report:
        advice = ["Deform the original again with --repair auto, or with another method (meshdeform methods)."]
        return {"headline": headline, "places": places, "advice": advice}
    # In order of effort.
    advice, repaired = [], any(attempt["repair"] for attempt in report.get("attempts") or ())
    if not repaired:
        advice.append("Repair invalid cells and halve the motion as needed: --repair auto.")
    if not repaired and report["steps"] == 1 and reached == 1.0:
        advice.append("Impose the motion in as many steps as a valid grid requires: --steps auto.")
    holds = "" if report["method"]["name"] == "idw-tfi" else "-m idw-tfi keeps walls under rotation; "
    advice.append(f"Try another method: {holds}meshdeform methods lists the limits of each.")
    advice.append('Let nodes slide on nearby planes that need not be fixed: kind = "slip".')
    return {"headline": headline, "places": places, "advice": advice}


def _levels(report: Report) -> Sections:
    """Curves and table."""
    levels = report["levels"]
    values = {
        "smallest f_skew": [level["quality"]["f_skew"]["min"] for level in levels],
        "mean f_skew": [level["quality"]["f_skew"]["mean"] for level in levels],
        "largest displacement": [level["max_displacement"] for level in levels],
        "largest rotation [deg]": [level["max_rotation_deg"] for level in levels],
        "acceleration [steps of the walls]": [tables.acceleration_of(level) for level in levels],
    }
    charts = []
    for name, data in values.items():
        known = [(level, value) for level, value in zip(levels, data, strict=True) if value is not None]
        if len(known) > 1 and any(value for _, value in known):
            times, wrong = ([level["time"] for level, _ in known], [not level["valid"] for level, _ in known])
            charts.append((name, curve(times, [value for _, value in known], "time", name, wrong)))
    table, note = tables.levels_table(report), f"Acceleration: {tables.ACCELERATION}."
    yield "Levels", [{"charts": charts}, table, note]


def _judged(report: Report) -> Sections:
    """Invalid cells, and quality with the distribution of f_skew."""
    rows = [
        (cell["block"], ", ".join(map(str, cell["ijk"])), ", ".join(f"{x:.5g}" for x in cell["center"]),
         cell["min_jacobian"], cell["step"], cell["nearest_patch"])
        for cell in report["invalid_cells"][:_SHOWN]
    ]  # fmt: skip
    heads = ("block", "i, j, k", "x, y, z", "smallest Jacobian", "in step", "nearest boundary")
    yield "Invalid cells", [Table("The worst invalid cells", heads, rows, (0, 1, 2, 5))] if rows else []
    before, after = (report["quality"][when]["f_skew"]["histogram"] for when in ("before", "after"))
    before = None if tables.is_alone(report) else before
    charts = [("Distribution of f_skew", histogram(before, after, "f_skew"))]
    yield "Quality", [tables.measures_table(report), {"charts": charts}]


def _common_sections(report: Report) -> Sections:
    yield "Components", [tables.components_table(report)] if report.get("components") else []
    yield "Shape of cells", [tables.shape_table(report)] if report.get("shape") else []
    yield "Attempts", list(_attempts(report))
    yield "Warnings", [{"warnings": report["warnings"]}] if report["warnings"] else []
    if boundary := report.get("boundary"):
        nodes = f"Nodes: {tables.node_counts(boundary)}."
        lines = [nodes, *tables.match_lines(boundary), *tables.motion_lines(report)]
        yield "Boundary and motion", [tables.boundary_table(boundary), *lines]
    if "method" in report:
        yield "Method", [f"Method: {report['method']['name']}", tables.settings_table(report)]
    if "timing" in report:
        total = report["timing"]["total"] or 1.0
        stages = [(name, f"{spent:.2f}", f"{100 * spent / total:.1f}") for name, spent in report["timing"].items()]
        memory = f"Memory: {readable(report['peak_memory_bytes'])} at most."
        yield "Time and memory", [Table("Seconds", ("stage", "seconds", "share [%]"), stages), memory]
    if run := report.get("run"):
        place = f"{run['directory']} with {counted(run['threads'], 'thread')}"
        ranks = f" on each of {run['ranks']} ranks" if run["ranks"] > 1 else ""
        versions = ", ".join(f"{name} {version}" for name, version in run["versions"].items())
        inputs = [(file["role"], file["path"], file["bytes"], file["sha256"]) for file in run["files"]]
        yield "Run", [
            f"Run on {run['date']} in {place}{ranks}. To repeat it:", {"code": run["command"]}, versions,
            Table("Files", ("role", "file", "bytes", "SHA-256"), inputs, (0, 1, 3)),
        ]  # fmt: skip


def _attempts(report: Report) -> Iterator[Any]:
    """The attempts until the grid was valid, and the result of a repair."""
    attempts = report.get("attempts") or ()
    if len(attempts) < 2 and not report.get("repair"):
        return
    rows = [
        (a["method"], a["steps"], "yes" if a["repair"] else "no", a["invalid_cells"], f"{a['reached']:.1%}")
        for a in attempts
    ]
    heads = ("method", "steps", "with repair", "invalid cells", "motion imposed")
    if rows:
        yield Table("Attempts, in order; the last one is the grid that was written", heads, rows, (0, 2))
    if new := report.get("new_interior"):
        yield f"The interior was remade from the reference by {new['method']}: {new['reason']}."
    if lines := tables.repair_lines(report):
        yield f"Repair: {'; '.join(lines)}. Moving and fixed boundary nodes stay where they were put."


def deformation_figures(result: Result) -> list[Figure]:
    """The moving walls, a plane around them and the worst cells, before and after; drawn by the first of the ranks that
    hold the grid."""
    setup, after = result.setup, result.grid
    old = Subject(setup.grid, setup.topology, original=setup.original)
    new = Subject(after, setup.topology, setup.grid, original=old)
    moving = np.flatnonzero(setup.boundary.quad_kind == Kind.MOVING)
    block, cell = worst_cell(new, "f_skew")
    more = ", and of other invalid cells" if result.assessment.invalid else ""
    closeup = f"A close-up of cell {setup.grid.label(block, cell)}, where f_skew is smallest{more}."
    walls = moved_walls(old, new, moving) if moving.size else None
    pages = [("The moving walls", "The moving walls, coloured by their displacement.", walls)] if walls else []
    pages += [
        ("Around the walls", "A plane through the grid, coloured by f_skew.", quality_planes(old, new)),
        ("The worst cells", closeup, worst_cells(old, new, block, cell)),
    ]
    return [Figure(title, text, after.nodes.ranks.on_first(partial(page_bytes, page))) for title, text, page in pages]


def histogram(before: Sequence[int] | None, after: Sequence[int], label: str) -> str:
    """Cells per bin of [0, 1] on a logarithmic scale, which shows a few bad cells among millions of good ones."""

    def draw(axes: Axes) -> None:
        # The axis begins below 1, so that a single cell is seen.
        edges = [n / len(after) for n in range(len(after) + 1)]
        axes.stairs(after, edges, baseline=_LEAST, fill=True, color=_AFTER, label="after")
        if before is not None:
            axes.stairs(before, edges, baseline=_LEAST, color=_BEFORE, linewidth=1.5, label="before")
            axes.legend(loc="upper left", frameon=False, labelcolor=_INK, reverse=True)
        axes.set(yscale="log", xlim=(0, 1), xlabel=label, ylabel="cells")
        axes.set_ylim(bottom=_LEAST, top=max(10.0, *after, *(before or ())) * 1.3)

    return _svg(draw, f"cells over {label}")


def curve(x: Sequence[float], y: Sequence[float], x_label: str, y_label: str, wrong: Sequence[bool]) -> str:
    """One quantity over another, one dot per point; ``wrong`` marks points in the colour of errors."""

    def draw(axes: Axes) -> None:
        axes.plot(x, y, "o-" if len(x) <= 60 else "-", color=_AFTER, linewidth=1.5, markersize=4)
        bad = [n for n, each in enumerate(wrong) if each]
        axes.plot([x[n] for n in bad], [y[n] for n in bad], "o", color=_BAD, markersize=5)
        axes.set(xlabel=x_label, ylabel=y_label)

    return _svg(draw, f"{y_label} over {x_label}")


def _svg(draw: Callable[[Axes], None], label: str) -> str:
    """A chart as an element of the page."""
    import matplotlib as mpl
    from matplotlib.figure import Figure as Drawing

    buffer = io.BytesIO()
    with mpl.rc_context(STYLE | _COLOURS):
        figure = Drawing(figsize=(6.4, 2.8), layout="constrained")
        axes = figure.add_subplot()
        axes.grid(axis="y", alpha=0.4)
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
        draw(axes)
        nothing = dict.fromkeys(("Creator", "Date", "Format", "Type"))
        figure.savefig(buffer, format="svg", metadata=nothing, transparent=True)
    text = buffer.getvalue().decode()
    # Several drawings on a page have no use for the names of groups, and none of them is clipped.
    text = re.sub(r' (clip-path|xmlns(:\w+)?)="[^"]*"|(?<=<g) id="[^"]*"', "", text[text.index("<svg") :])
    return text.replace("<svg", f'<svg class="chart" role="img" aria-label="{label}"', 1)
