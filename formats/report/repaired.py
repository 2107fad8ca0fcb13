"""A summary of a repair for the banner of the page, the Markdown and the text report."""

from __future__ import annotations

from typing import Any

from meshdeform_core.wording import counted

_LAYERS = (("first cell", "first_cell_height_ratio"), ("first cells together", "layer_thickness_ratio"))

_NO_MINIMUM = "the search did not reach the minimum, so the grid depends on how it was found"


def repair_sentence(report: dict[str, Any]) -> str:
    """All of :func:`repair_lines` in one sentence."""
    return "; ".join(repair_lines(report))


def repair_lines(report: dict[str, Any]) -> list[str]:
    """Number of cells repaired, largest movement of nodes, result of the method alone, whether the minimum was missed,
    and fraction of the layers at walls that changed; empty without a repair."""
    done = report.get("repair")
    if not done:
        return []
    cells = f"{counted(done['cells'], 'invalid or weak cell')} repaired" if done["cells"] else "weak cells improved"
    largest = report.get("boundary", {}).get("max_displacement")
    part = f" ({done['max_movement'] / largest:.2g} of the largest displacement)" if largest else ""
    tried = [part["attempts"] for part in report.get("components", ())] or [report.get("attempts", ())]
    alone = [next((a["invalid_cells"] for a in attempts if not a["repair"]), 0) for attempts in tried if attempts]
    before = f"; the method alone leaves {counted(sum(alone), 'invalid cell')}" if alone else ""
    what = (
        f"{cells}, {counted(done['nodes'], 'node')} moved by up to {done['max_movement']:.4g}{part}, "
        f"{counted(done['newton_steps'], 'Newton step')}{before}"
    )
    found = [] if done.get("converged", True) or "reference" in report else [_NO_MINIMUM]
    changes = report.get("repaired_layers") or {}
    return [what, *found, *(_layer_text(name, change) for name, change in changes.items() if change)]


def _layer_text(name: str, change: dict[str, Any]) -> str:
    walls = f"of the {change['lines']:,} grid lines that begin at {name} walls"
    if not change["changed"]:
        return f"none {walls} changed by more than 1% in its first cells"
    ranges = [(what, change[key]) for what, key in _LAYERS if change[key]]
    heights = ", ".join(f"{what} {ratio['min']:.3g}..{ratio['max']:.3g}" for what, ratio in ranges)
    return (
        f"{change['changed']:,} {walls} changed by more than 1% there (height over that by the method alone: {heights})"
    )
