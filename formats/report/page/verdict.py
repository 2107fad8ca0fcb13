"""The verdict: whether the grid is usable; if not, where and why not, and what to do."""

from __future__ import annotations

from html import escape
from typing import Any

from ..parts import Report
from ..repaired import repair_sentence
from .tables import table

_SHOWN = 12


def verdict_section(report: Report) -> str:
    """The banner at the top, with the positions of invalid cells."""
    if report["valid"]:
        done = repair_sentence(report)
        how = f"<p>After a repair: {escape(done)}.</p>" if done else ""
        return f'<div class="verdict good"><strong>✓ {_good(report)}</strong>{how}</div>'
    if "levels" in report:
        return _bad_levels(report)
    return _bad(report)


def _good(report: Report) -> str:
    if "levels" in report:
        return f"All {len(report['levels'])} levels are valid."
    quality = report["quality"]["after"]
    if quality["inherited_invalid_cells"]:
        return f"No cell became invalid; {quality['inherited_invalid_cells']:,} cells were invalid before."
    return "The grid is valid."


def _bad(report: Report) -> str:
    quality = report["quality"]["after"]
    reached = report.get("reached", 1.0)
    count = quality["invalid_cells"]
    if reached < 1.0:
        head = f"Only {reached:.1%} of the motion was imposed; the next step would have made cells invalid."
    else:
        head = f"{count:,} of {report['grid']['cells']:,} cells became invalid."
    groups = report["invalid_groups"]
    items = "".join(f"<li>{escape(_sentence(group))}</li>" for group in groups[:_SHOWN])
    more = f"<li>and {len(groups) - _SHOWN} smaller groups</li>" if len(groups) > _SHOWN else ""
    where = f"<p>Where:</p><ul>{items}{more}</ul>" if items else ""
    hit = [block for block in report.get("blocks", ()) if block["invalid_cells"]]
    if len(hit) > 1 and reached == 1.0:
        blocks = ", ".join(f"{escape(block['name'])} ({block['invalid_cells']:,})" for block in hit[:_SHOWN])
        where += f"<p>Blocks with invalid cells: {blocks}{' and more' if len(hit) > _SHOWN else ''}.</p>"
    advice = "".join(f"<li>{text}</li>" for text in _advice(report))
    banner = f'<div class="verdict bad"><strong>✗ {escape(head)}</strong>{where}'
    return f"{banner}<p>What to do:</p><ul>{advice}</ul></div>"


def _sentence(group: dict[str, Any]) -> str:
    count = f"{group['cells']:,} cell{'s' if group['cells'] != 1 else ''}"
    near = f" near {group['nearest_patch']!r}" if group["nearest_patch"] else ""
    at = ", ".join(f"{x:.4g}" for x in group["center"])
    blocks = ", ".join(group["blocks"][:4]) + (" and more" if len(group["blocks"]) > 4 else "")
    worst = f"{group['block']} ({', '.join(map(str, group['ijk']))})"
    return f"{count}{near} in {blocks}, around x, y, z = {at}; the worst is {worst}"


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


def cells_section(report: Report) -> str:
    """The worst of the invalid cells that the report lists."""
    rows = [
        (cell["block"], ", ".join(map(str, cell["ijk"])), ", ".join(f"{x:.5g}" for x in cell["center"]),
         cell["min_jacobian"], cell["step"], cell["nearest_patch"])
        for cell in sorted(report["invalid_cells"], key=lambda cell: cell["min_jacobian"])[:_SHOWN]
    ]  # fmt: skip
    heads = ("block", "i, j, k", "x, y, z", "smallest Jacobian", "in step", "nearest boundary")
    return table("The worst invalid cells", heads, rows, text=(0, 1, 2, 5)) if rows else ""


def _bad_levels(report: Report) -> str:
    bad = [level for level in report["levels"] if not level["valid"]]
    items = "".join(
        f"<li>level {level['number']} (t = {level['time']:g}): "
        + (
            f"{level['quality']['invalid_cells']:,} cells became invalid"
            if level["reached"] == 1.0
            else f"only {level['reached']:.1%} of the motion imposed"
        )
        + "</li>"
        for level in bad[:_SHOWN]
    )
    more = f"<li>and {len(bad) - _SHOWN} more</li>" if len(bad) > _SHOWN else ""
    return (
        f'<div class="verdict bad"><strong>✗ {len(bad)} of {len(report["levels"])} levels are not valid.'
        f"</strong><ul>{items}{more}</ul><p>What to do: <code>--steps auto</code>, <code>--from last</code>, or "
        "another method.</p></div>"
    )
