"""Sections of a page without pictures: functions of the report that return HTML, or an empty text."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import Any

from meshdeform_core.memory import readable
from meshdeform_core.wording import counted

from ..components import HEADS, component_rows
from ..measures import measure_rows, place_text
from ..parts import Report
from ..remedies import remedy_of
from ..repaired import repair_lines
from ..text import number
from .charts import histogram
from .tables import table

STAGES = {
    "read": "reading the grid",
    "topology": "coincident nodes, boundary",
    "prepare": "preparing the method",
    "apply": "moving the nodes",
    "compile": "compiling loops, once per installation",
    "repair": "repairing cells",
    "quality": "judging the cells",
    "write": "writing the grid",
    "publish": "index and single file of the series",
    "other": "everything else (start, checksums)",
}


def quality_section(report: Report) -> str:
    """All measures with the position of the worst cell, and the distribution of f_skew."""
    quality = report["quality"]
    alone = _alone(report)
    rows = [
        (row.name, None if alone else row.before, row.after, None if alone else row.change, row.place)
        for row in measure_rows(quality)
    ]
    text = table(
        "Quality measures; f_skew is Knupp's skew measure: 1 orthogonal, 0 invalid",
        ("measure", "before", "after", "change", "worst at"),
        rows,
        text=(0, 4),
        flagged=[n for n, row in enumerate(rows) if row[0] == "invalid cells" and row[2]],
    )
    if alone:
        text = table(
            "Quality measures; f_skew is Knupp's skew measure: 1 orthogonal, 0 invalid",
            ("measure", "value", "worst at"),
            [(name, after, place) for name, _, after, _, place in rows],
            text=(0, 2),
        )
    before = None if alone else quality["before"]["f_skew"]["histogram"]
    key = "" if alone else '<span class="key before"></span>before<span class="key after"></span>after'
    chart = histogram(before, quality["after"]["f_skew"]["histogram"], "f_skew")
    return f"{text}<h3>Distribution of f_skew</h3><p class=soft>Cells per bin, logarithmic scale.{key}</p>{chart}"


def _alone(report: Report) -> bool:
    """Whether the grid was judged without an original, so that there are no values before."""
    return "method" not in report and not report.get("reference")


_TOGETHER = 200
"""Blocks in one table; more are grouped by the families of their patches."""
_LISTED = 100
"""Blocks of a group that are listed."""


def blocks_section(report: Report) -> str:
    """Every block, or groups of them that unfold; sortable where scripts run."""
    blocks = sorted(report["blocks"], key=lambda block: block["after"]["f_skew_min"])
    if len(blocks) <= _TOGETHER:
        return _block_table(f"{len(blocks)} blocks, the one with the worst cell first", blocks)
    groups: dict[str, list[Report]] = {}
    for block in blocks:
        groups.setdefault(", ".join(block["families"]), []).append(block)
    parts = [_block_group(name or "no family", members) for name, members in groups.items()]
    return f"<p class=soft>{len(blocks):,} blocks by the families on them, the worst first</p>{''.join(parts)}"


def _block_group(name: str, blocks: Sequence[Report]) -> str:
    invalid = sum(block["invalid_cells"] for block in blocks)
    cells = sum(block["cells"] for block in blocks)
    title = (
        f"{name}: {counted(len(blocks), 'block')}, {counted(cells, 'cell')}, {invalid:,} invalid; "
        f"f_skew min {number(blocks[0]['after']['f_skew_min'])}"
    )
    rest = len(blocks) - _LISTED
    more = f"; {counted(rest, 'more is', 'more are')} in the report as JSON" if rest > 0 else ""
    inside = _block_table(f"The one with the worst cell first{more}", blocks[:_LISTED])
    return f"<details><summary>{escape(title)}</summary>{inside}</details>"


def _block_table(caption: str, blocks: Sequence[Report]) -> str:
    heads = ("block", "cells", "invalid", "f_skew min", "before", "f_skew mean", "before", "scaled Jacobian min")
    rows = [
        (
            block["name"],
            block["cells"],
            block["invalid_cells"],
            block["after"]["f_skew_min"],
            block["before"]["f_skew_min"],
            block["after"]["f_skew_mean"],
            block["before"]["f_skew_mean"],
            block["after"]["min_scaled_jacobian"],
        )
        for block in blocks
    ]
    return table(caption, heads, rows, sortable=True, flagged=[n for n, row in enumerate(rows) if row[2]])


def components_section(report: Report) -> str:
    """Every component of an overset grid."""
    rows = component_rows(report)
    flagged = [n for n, part in enumerate(report["components"]) if not part["valid"]]
    return table(f"{len(rows)} components, each moved by its own boundary", HEADS, rows, text=(0, 5), flagged=flagged)


def attempts_section(report: Report) -> str:
    """The attempts until the grid was valid, and the result of a repair."""
    rows = [
        (a["method"], a["steps"], "yes" if a["repair"] else "no", a["invalid_cells"], f"{a['reached']:.1%}")
        for a in report.get("attempts", ())
    ]
    heads = ("method", "steps", "with repair", "invalid cells", "motion imposed")
    title = "Attempts, in order; the last one is the grid that was written"
    html = table(title, heads, rows, text=(0, 2)) if rows else ""
    if new := report.get("new_interior"):
        reason = f"by {escape(new['method'])}: {escape(new['reason'])}"
        html += f"<p>The interior was remade from the reference {reason}.</p>"
    if lines := repair_lines(report):
        html += f"<p>Repair: {escape('; '.join(lines))}. Moving and fixed boundary nodes stay where they were put.</p>"
    return html


def shape_section(report: Report) -> str:
    """Measures that matter to flow solvers."""
    shape = report["shape"]
    rows = []
    for name, after in shape["after"].items():
        before = (shape["before"] or {}).get(name)
        place = after.get("worst")
        where = place_text(place) if place else ""
        rows.append((name, before["max"] if before else None, after["max"], after["mean"], where))
    heads = ("measure", "largest before", "largest", "mean", "largest at")
    return table("Measures that matter to flow solvers", heads, rows, text=(0, 4))


def boundary_section(report: Report) -> str:
    """Boundary entries, motions, and matches of tables."""
    boundary = report["boundary"]
    rows = [(patch["name"], patch["kind"], patch["nodes"]) for patch in boundary["patches"]]
    text = table("Boundary entries", ("name", "kind", "nodes"), rows, text=(0, 1))
    counts = ", ".join(f"{boundary[key]:,} {key.removesuffix('_nodes')}" for key in boundary if key.endswith("_nodes"))
    text += f"<p>Nodes: {counts}.</p>"
    if report.get("motion"):
        moved = [(m["boundary"], m["max_displacement"], m.get("max_rotation_deg")) for m in report["motion"]]
        text += table("Motion", ("boundary", "largest displacement", "largest rotation [deg]"), moved)
    matches = boundary.get("matches")
    if matches:
        heads = ("table", "match", "nodes matched", "not matched", "points used", "of", "largest distance")
        text += table("Displacement tables", heads, [tuple(match.values())[:4] + (
            match["table_points_used"], match["table_points"], match["max_distance"]) for match in matches], text=(0, 1)
        )  # fmt: skip
    return text


def method_section(report: Report) -> str:
    """Parameters with their reasons."""
    method = report["method"]
    rows = [
        (name, number(setting["value"]), setting.get("reason", "given or default"))
        for name, setting in method.items()
        if name != "name"
    ]
    return f"<p>Method: <strong>{escape(method['name'])}</strong></p>" + table(
        "Parameters as used", ("parameter", "value", "why"), rows, text=(0, 1, 2)
    )


def warnings_section(report: Report) -> str:
    """Every warning with advice."""
    items = []
    for warning in report["warnings"]:
        advice = remedy_of(warning)
        text = f'<p class="soft">{escape(advice)}</p>' if advice else ""
        items.append(f"<li><p>{escape(warning)}</p>{text}</li>")
    return f'<ul class="warnings">{"".join(items)}</ul>'


def timing_section(report: Report) -> str:
    """Seconds by stage, which add up, and memory."""
    timing = report["timing"]
    total = timing["total"] or 1.0
    rows = "".join(
        f'<tr><td class="text">{escape(STAGES.get(stage, stage))}</td><td>{seconds:.2f}</td>'
        f'<td class="barcell"><span class="bar" style="width:{100 * seconds / total:.1f}%"></span></td></tr>'
        for stage, seconds in timing.items()
        if stage != "total"
    )
    return (
        '<div class="scroll" tabindex="0" role="region" aria-label="Seconds by stage"><table><caption>Seconds</caption>'
        '<thead><tr><th scope="col" class="text">stage</th><th scope="col">seconds</th>'
        f'<th scope="col" class="text">share</th></tr></thead><tbody>{rows}'
        '<tr><td class="text"><strong>total</strong></td>'
        f"<td><strong>{timing['total']:.2f}</strong></td><td></td></tr>"
        f"</tbody></table></div><p>Memory: {readable(report['peak_memory_bytes'])} at most.</p>"
    )


def run_section(report: Report) -> str:
    """The command, where and when it was run, and the files with their checksums."""
    run = report["run"]
    versions = ", ".join(f"{name} {version}" for name, version in run["versions"].items())
    rows = [(file["role"], file["path"], file["bytes"], file["sha256"]) for file in run["files"]]
    return (
        f"<p>Run on {escape(run['date'])} in <code>{escape(run['directory'])}</code> "
        f"with {run['threads']} thread{'s' if run['threads'] != 1 else ''}"
        f"{f' on each of {ranks} ranks' if (ranks := run['ranks']) > 1 else ''}. To repeat it:</p>"
        f"<pre><code>{escape(run['command'])}</code></pre><p class=soft>{escape(versions)}</p>"
        + table("Files", ("role", "file", "bytes", "SHA-256"), rows, text=(0, 1, 3))
    )


def tiles(facts: list[tuple[str, Any]]) -> str:
    """A few key numbers."""
    return (
        '<dl class="tiles">'
        + "".join(f"<div><dt>{escape(name)}</dt><dd>{escape(str(value))}</dd></div>" for name, value in facts)
        + "</dl>"
    )
