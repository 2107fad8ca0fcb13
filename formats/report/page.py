"""Reports as one self-contained page: the contents of its sections; the template ``page.html.jinja`` shows them."""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import jinja2

from meshdeform_core.memory import readable
from meshdeform_core.wording import counted

from ..picture.page import STYLE
from .measures import place_text
from .records import Report
from .tables import (
    ACCELERATION,
    Figure,
    Table,
    acceleration_of,
    components_table,
    is_alone,
    level_link,
    levels_table,
    measures_table,
    number,
    repair_lines,
    repair_sentence,
    shape_table,
)

if TYPE_CHECKING:
    from matplotlib import figure as drawing
    from matplotlib.axes import Axes

_STAGES = {
    "read": "reading the grid",
    "topology": "coincident nodes, boundary",
    "prepare": "preparing the method",
    "apply": "moving the nodes",
    "compile": "compiling loops, once per installation",
    "repair": "repairing cells",
    "quality": "judging the cells",
    "write": "writing the grid",
    "publish": "index of the series",
    "other": "everything else (start, checksums)",
}
_SHOWN = 12
"""Groups of invalid cells, cells and levels that the page lists."""
_LISTED = 200
"""Blocks that are listed."""

# Colours of the page's style sheet, which stand for these in the drawing.
_INK, _LINE, _BEFORE, _AFTER, _BAD = "#010101", "#020202", "#030303", "#040404", "#050505"
_OF_PAGE = {
    _INK: "currentColor", _LINE: "var(--line)", _BEFORE: "var(--before)", _AFTER: "var(--after)", _BAD: "var(--bad)",
}  # fmt: skip
_LEAST = 0.3

REMEDIES = (
    (
        "not selected by any boundary entry; they are fixed",
        "If some of them are planes on which nodes should slide, add a boundary entry for them with "
        'kind = "slip" or "symmetry"; if they are the far field, no action is needed.',
    ),
    (
        "the grid is one cell thick",
        "No action is needed if this is a two-dimensional case; otherwise add a boundary entry for the end planes.",
    ),
    (
        "nothing moves",
        "Check the motion in the case: a formula that is zero at this time (--time), a table with zero "
        "displacements, or an angle of 0.",
    ),
    (
        "of the motion was imposed; a further step",
        "The report's invalid cells are those of the next step. Another method, a slip plane instead of a fixed one, "
        "or more space beside the wall allows a larger motion.",
    ),
    (
        "out of a slip or symmetry plane",
        "Give the plane itself a motion, or check the axis and the components of the motion.",
    ),
    (
        "face quads are shared by more than two blocks",
        "Such faces cannot be interfaces; check the grid generator's export for duplicate blocks.",
    ),
    (
        "node pairs do not coincide",
        "If the gap is round-off of the file, raise grid.tolerance (a fraction of the local edge); otherwise the "
        "connection in the file is wrong.",
    ),
    (
        "but no connection declares them",
        "No action is needed if the blocks belong together. For a thin plate whose two sides coincide, name one "
        "side in the case: [grid] plates.",
    ),
)
"""Words of warnings that do not say what to do, and what to do."""


@dataclass(frozen=True)
class Section:
    """Part of a page: texts, tables, figures and dictionaries of what else the template shows."""

    anchor: str
    heading: str
    parts: Sequence[Any]


def as_html(
    report: Report,
    figures: Sequence[Figure] = (),
    thumbnails: Sequence[tuple[Figure, str]] = (),
    folder: str = "",
) -> str:
    """The report as a self-contained page.

    Parameters
    ----------
    figures : pictures of a deformation, shown after the verdict
    thumbnails : of levels of a series, each with the name of its file
    folder : of the levels, relative to the page
    """
    here = files(__package__)
    template, style, script = (
        here.joinpath(file).read_text(encoding="utf-8") for file in ("page.html.jinja", "style.css", "script.js")
    )
    environment = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined)
    environment.globals["zip"] = zip
    environment.filters |= {
        "number": number,
        "base64": lambda png: base64.b64encode(png).decode("ascii"),
        "png_width": lambda png: int.from_bytes(png[16:20], "big"),
        "png_height": lambda png: int.from_bytes(png[20:24], "big"),
    }
    series, grid = "levels" in report, report["grid"]
    name, kind = str(grid["file"] or "grid"), f"{grid['format']}, " if grid["format"] else ""
    blocks, cells = counted(grid["blocks"], "block"), counted(grid["cells"], "cell")
    title = f"{'Deformation' if 'method' in report else 'Quality'} of {name}"
    sections = [
        Section("pictures", "Pictures", figures),
        *(_levels_section(report, thumbnails, folder) if series else _judged(report)),
        *_common_sections(report),
    ]
    return environment.from_string(template).render(
        report=report,
        title=f"Series of {len(report['levels'])} levels: {name}" if series else title,
        about=f"{kind}{grid['dimension']}-D, {blocks}, {grid['nodes']:,} nodes, {cells}",
        verdict=_verdict_banner(report),
        sections=[section for section in sections if section.parts],
        style=style,
        script=script,
    )


def _verdict_banner(report: Report) -> dict[str, Any]:
    """Whether the grid is usable; if not, where and why not, and what to do (advice is HTML)."""
    found: dict[str, Any] = {"how": "", "places": [], "blocks": "", "advice": []}
    if report["valid"]:
        headline = f"All {len(report['levels'])} levels are valid." if "levels" in report else "The grid is valid."
        if "levels" not in report and (old := report["quality"]["after"]["inherited_invalid_cells"]):
            headline = f"No cell became invalid; {old:,} cells were invalid before."
        return found | {"headline": headline, "how": repair_sentence(report)}
    if "levels" in report:
        bad = [level for level in report["levels"] if not level["valid"]]
        more = [f"and {len(bad) - _SHOWN} more"] if len(bad) > _SHOWN else []
        return found | {
            "headline": f"{len(bad)} of {len(report['levels'])} levels are not valid.",
            "places": [*map(_bad_level, bad[:_SHOWN]), *more],
            "advice": ["<code>--steps auto</code>, <code>--from last</code>, or another method."],
        }
    groups, reached = report["invalid_groups"], report.get("reached", 1.0)
    count = report["quality"]["after"]["invalid_cells"]
    headline = f"{count:,} of {report['grid']['cells']:,} cells became invalid."
    if reached < 1.0:
        headline = f"Only {reached:.1%} of the motion was imposed; the next step would have made cells invalid."
    more = [f"and {len(groups) - _SHOWN} smaller groups"] if len(groups) > _SHOWN else []
    hit = [block for block in report.get("blocks", ()) if block["invalid_cells"]]
    blocks = ", ".join(f"{block['name']} ({block['invalid_cells']:,})" for block in hit[:_SHOWN])
    return found | {
        "headline": headline,
        "places": [*map(_group, groups[:_SHOWN]), *more],
        "blocks": blocks + (" and more" if len(hit) > _SHOWN else "") if len(hit) > 1 and reached == 1.0 else "",
        "advice": _advice(report),
    }


def _bad_level(level: Report) -> str:
    what = f"{level['quality']['invalid_cells']:,} cells became invalid"
    if level["reached"] < 1.0:
        what = f"only {level['reached']:.1%} of the motion imposed"
    return f"level {level['number']} (t = {level['time']:g}): {what}"


def _group(group: Report) -> str:
    near = f" near {group['nearest_patch']!r}" if group["nearest_patch"] else ""
    at = ", ".join(f"{x:.4g}" for x in group["center"])
    blocks = ", ".join(group["blocks"][:4]) + (" and more" if len(group["blocks"]) > 4 else "")
    return (
        f"{counted(group['cells'], 'cell')}{near} in {blocks}, around x, y, z = {at}; the worst is {place_text(group)}"
    )


def _advice(report: Report) -> list[str]:
    """Advice, in order of effort."""
    if "method" not in report:
        return [
            "Deform the original again with <code>--repair auto</code>, or with another method "
            "(<code>meshdeform methods</code>)."
        ]
    advice = []
    repaired = any(attempt["repair"] for attempt in report.get("attempts") or ())
    if not repaired:
        advice.append("Repair invalid cells and halve the motion as needed: <code>--repair auto</code>.")
    if not repaired and report["steps"] == 1 and report.get("reached", 1.0) == 1.0:
        advice.append("Impose the motion in as many steps as a valid grid requires: <code>--steps auto</code>.")
    holds = "" if report["method"]["name"] == "idw-tfi" else "<code>-m idw-tfi</code> keeps walls under rotation; "
    advice.append(f"Try another method: {holds}<code>meshdeform methods</code> lists the limits of each.")
    advice.append("Let nodes slide on nearby planes that need not be fixed: <code>kind = &quot;slip&quot;</code>.")
    return advice


def _levels_section(report: Report, thumbnails: Sequence[tuple[Figure, str]], folder: str) -> Iterator[Section]:
    """Curves, pictures, table."""
    levels = report["levels"]
    values = {
        "smallest f_skew": [level["quality"]["f_skew"]["min"] for level in levels],
        "mean f_skew": [level["quality"]["f_skew"]["mean"] for level in levels],
        "largest displacement": [level["max_displacement"] for level in levels],
        "largest rotation [deg]": [level["max_rotation_deg"] for level in levels],
        "acceleration [steps of the walls]": [acceleration_of(level) for level in levels],
    }
    charts = []
    for name, data in values.items():
        known = [(level, value) for level, value in zip(levels, data, strict=True) if value is not None]
        if len(known) > 1 and any(value for _, value in known):
            times, wrong = ([level["time"] for level, _ in known], [not level["valid"] for level, _ in known])
            charts.append((name, curve(times, [value for _, value in known], "time", name, wrong)))
    parts: list[Any] = [{"charts": charts, "compared": False}]
    if thumbnails:
        parts.append({"thumbnails": [(figure, level_link(folder, name)) for figure, name in thumbnails]})
    yield Section("levels", "Levels", [*parts, levels_table(report, folder), f"Acceleration: {ACCELERATION}."])


def _judged(report: Report) -> Iterator[Section]:
    """Invalid cells, and quality with the distribution of f_skew."""
    worst = sorted(report["invalid_cells"], key=lambda cell: cell["min_jacobian"])[:_SHOWN]
    rows = [
        (cell["block"], ", ".join(map(str, cell["ijk"])), ", ".join(f"{x:.5g}" for x in cell["center"]),
         cell["min_jacobian"], cell["step"], cell["nearest_patch"])
        for cell in worst
    ]  # fmt: skip
    heads = ("block", "i, j, k", "x, y, z", "smallest Jacobian", "in step", "nearest boundary")
    cells = Table("The worst invalid cells", heads, rows, (0, 1, 2, 5))
    yield Section("cells", "Invalid cells", [cells] if rows else [])
    before, after = (report["quality"][when]["f_skew"]["histogram"] for when in ("before", "after"))
    before = None if is_alone(report) else before
    chart = histogram(before, after, "f_skew")
    shown = {"charts": [("Distribution of f_skew", chart)], "compared": before is not None}
    yield Section("quality", "Quality", [measures_table(report, change=True), shown])


def _common_sections(report: Report) -> Iterator[Section]:
    components = [components_table(report)] if report.get("components") else []
    yield Section("components", "Components", components)
    yield Section("shape", "Shape of cells", [shape_table(report)] if report.get("shape") else [])
    yield Section("attempts", "Attempts", list(_attempts(report)))
    yield Section("blocks", "Blocks", list(_blocks(report.get("blocks") or ())))
    remedies = [next((advice for words, advice in REMEDIES if words in each), "") for each in report["warnings"]]
    warnings = list(zip(report["warnings"], remedies, strict=True))
    yield Section("warnings", "Warnings", [{"warnings": warnings}] if warnings else [])
    yield Section("boundary", "Boundary and motion", list(_boundary_tables(report)))
    if "method" in report:
        rows = [
            (name, number(setting["value"]), setting.get("reason", "given or default"))
            for name, setting in report["method"].items()
            if name != "name"
        ]
        parameters = Table("Parameters as used", ("parameter", "value", "why"), rows, (0, 1, 2))
        yield Section("method", "Method", [f"Method: {report['method']['name']}", parameters])
    if "timing" in report:
        timing, memory = report["timing"], f"Memory: {readable(report['peak_memory_bytes'])} at most."
        each = 100 / (timing["total"] or 1.0)
        stages = [(_STAGES.get(stage, stage), s, each * s) for stage, s in timing.items() if stage != "total"]
        yield Section("time", "Time and memory", [{"stages": stages, "total": timing["total"]}, memory])
    yield Section("run", "Run", list(_run(report.get("run"))))


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
    if lines := repair_lines(report):
        yield f"Repair: {'; '.join(lines)}. Moving and fixed boundary nodes stay where they were put."


def _blocks(blocks: Sequence[Report]) -> Iterator[Any]:
    """The blocks, the worst first."""
    blocks = sorted(blocks, key=lambda block: block["after"]["f_skew_min"])
    if not blocks:
        return
    heads = ("block", "cells", "invalid", "f_skew min", "before", "f_skew mean", "before", "scaled Jacobian min")
    rows = [
        (
            block["name"], block["cells"], block["invalid_cells"],
            *(block[when][key] for key in ("f_skew_min", "f_skew_mean") for when in ("after", "before")),
            block["after"]["min_scaled_jacobian"],
        )
        for block in blocks[:_LISTED]
    ]  # fmt: skip
    rest = len(blocks) - _LISTED
    more = f"; {counted(rest, 'more is', 'more are')} in the report as JSON" if rest > 0 else ""
    caption = f"{counted(len(blocks), 'block')}, the one with the worst cell first{more}"
    yield Table(caption, heads, rows, flagged=[n for n, row in enumerate(rows) if row[2]], sortable=True)


def _boundary_tables(report: Report) -> Iterator[Any]:
    """Boundary entries, motions, and matches of tables."""
    boundary = report.get("boundary")
    if boundary is None:
        return
    rows = [(patch["name"], patch["kind"], patch["nodes"]) for patch in boundary["patches"]]
    yield Table("Boundary entries", ("name", "kind", "nodes"), rows, (0, 1))
    counts = ", ".join(f"{boundary[key]:,} {key.removesuffix('_nodes')}" for key in boundary if key.endswith("_nodes"))
    yield f"Nodes: {counts}."
    if report.get("motion"):
        moved = [(m["boundary"], m["max_displacement"], m.get("max_rotation_deg")) for m in report["motion"]]
        yield Table("Motion", ("boundary", "largest displacement", "largest rotation [deg]"), moved)
    if matches := boundary.get("matches"):
        heads = ("table", "match", "nodes matched", "not matched", "points used", "of", "largest distance")
        keys = (
            "table", "match", "matched_nodes", "unmatched_nodes", "table_points_used", "table_points", "max_distance"
        )  # fmt: skip
        yield Table("Displacement tables", heads, [[match[key] for key in keys] for match in matches], (0, 1))


def _run(run: Report | None) -> Iterator[Any]:
    """The command, where and when it was run, and the files with their checksums."""
    if not run:
        return
    ranks = f" on each of {run['ranks']} ranks" if run["ranks"] > 1 else ""
    yield f"Run on {run['date']} in {run['directory']} with {counted(run['threads'], 'thread')}{ranks}. To repeat it:"
    yield {"code": run["command"]}
    yield ", ".join(f"{name} {version}" for name, version in run["versions"].items())
    rows = [(file["role"], file["path"], file["bytes"], file["sha256"]) for file in run["files"]]
    yield Table("Files", ("role", "file", "bytes", "SHA-256"), rows, (0, 1, 3))


def histogram(before: Sequence[int] | None, after: Sequence[int], label: str) -> str:
    """Cells per bin of [0, 1] on a logarithmic scale, which shows a few bad cells among millions of good ones."""
    figure, axes = _axes()
    width = 1 / len(after)
    sets = (
        [(after, _AFTER, 0.5, 0.72)] if before is None else [(before, _BEFORE, 0.29, 0.41), (after, _AFTER, 0.71, 0.41)]
    )
    for counts, colour, middle, thick in sets:
        there = [n for n, count in enumerate(counts) if count]
        # Half a decade below 1, so that a single cell has a visible bar.
        heights = [counts[n] - _LEAST for n in there]
        places = [(n + middle) * width for n in there]
        axes.bar(places, heights, thick * width, bottom=_LEAST, color=colour)
    axes.set(yscale="log", xlim=(0, 1), xlabel=label, ylabel="cells")
    axes.set_ylim(bottom=_LEAST, top=max(10.0, *after, *(before or ())) * 1.3)
    return _svg(figure, f"cells over {label}")


def curve(x: Sequence[float], y: Sequence[float], x_label: str, y_label: str, wrong: Sequence[bool]) -> str:
    """One quantity over another, one dot per point; ``wrong`` marks points in the colour of errors."""
    figure, axes = _axes()
    axes.plot(x, y, color=_AFTER, linewidth=1.5)
    if len(x) <= 60:
        axes.plot(x, y, "o", color=_AFTER, markersize=4)
    bad = [n for n, each in enumerate(wrong) if each]
    axes.plot([x[n] for n in bad], [y[n] for n in bad], "o", color=_BAD, markersize=5)
    axes.set(xlabel=x_label, ylabel=y_label)
    return _svg(figure, f"{y_label} over {x_label}")


def _axes() -> tuple[drawing.Figure, Axes]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 2.8), layout="constrained")
    axes = figure.add_subplot()
    axes.grid(axis="y", color=_LINE)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    return figure, axes


def _svg(figure: drawing.Figure, label: str) -> str:
    """The drawing as an element of the page."""
    import matplotlib as mpl

    (axes,), buffer = figure.axes, io.BytesIO()
    axes.tick_params(colors=_INK, which="both")
    for each in (axes.xaxis.label, axes.yaxis.label):
        each.set_color(_INK)
    for spine in axes.spines.values():
        spine.set_color(_INK)
    with mpl.rc_context(STYLE):
        nothing = dict.fromkeys(("Creator", "Date", "Format", "Type"))
        figure.savefig(buffer, format="svg", metadata=nothing, transparent=True)
    text = buffer.getvalue().decode()
    # Several drawings on a page have no use for the names of groups, and none of them is clipped.
    text = re.sub(r' (clip-path|xmlns(:\w+)?)="[^"]*"|(?<=<g) id="[^"]*"', "", text[text.index("<svg") :])
    for colour, name in _OF_PAGE.items():
        text = text.replace(colour, name)
    return text.replace("<svg", f'<svg class="chart" role="img" aria-label="{label}"', 1)
