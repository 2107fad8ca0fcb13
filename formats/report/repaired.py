"""A summary of a repair for the banner of the page, the Markdown and the text report."""

from __future__ import annotations

from typing import Any

from meshdeform_core.wording import counted

_LAYERS = (("first cell", "first_cell_height_ratio"), ("first cells together", "layer_thickness_ratio"))

_WEAK = "weak: sheared by more than 45 degrees, or twice or half as long in one direction"


def repair_sentence(report: dict[str, Any]) -> str:
    """All of :func:`repair_lines` in one sentence."""
    return "; ".join(repair_lines(report))


def repair_lines(report: dict[str, Any]) -> list[str]:
    """How many cells were repaired, how far nodes moved, and measures of the method's grid beside those of the repaired
    one; empty without a repair."""
    done = report.get("repair")
    if not done:
        return []
    if done["left_out"]:
        return [f"not repaired: {done['left_out']}"]
    counts = [f"{done[kind]:,} {kind}" for kind in ("invalid", "weak") if done[kind]]
    cells = f"{' and '.join(counts) or 'no bad'} {'cell' if done['invalid'] + done['weak'] == 1 else 'cells'}"
    left = report.get("quality", {}).get("after", {}).get("invalid_cells", 0)
    what = f"not repaired: {counted(left, 'cell')} of {cells} stay invalid" if left else f"{cells} repaired"
    largest = report.get("boundary", {}).get("max_displacement")
    part = f" ({done['max_movement'] / largest:.2g} of the largest displacement)" if largest else ""
    moved = (
        f"{what}, {counted(done['nodes'], 'node')} moved by up to {done['max_movement']:.4g}{part}, "
        f"{counted(done['newton_steps'], 'Newton step')}"
    )
    found = [moved, *_compared(report), *([_WEAK] if done["weak"] else [])]
    changes = report.get("repaired_layers") or {}
    return [*found, *(_layer_text(name, change) for name, change in changes.items() if change)]


def _compared(report: dict[str, Any]) -> list[str]:
    """Measures of the method's grid and of the repaired one."""
    before, after = report["repair"]["before"], report.get("quality", {}).get("after")
    if not before or not after:
        return []
    found = [f"smallest scaled Jacobian {before['min_scaled_jacobian']:.3g} -> {after['min_scaled_jacobian']:.3g}"]
    found.append(f"smallest f_skew {before['f_skew']['min']:.3g} -> {after['f_skew']['min']:.3g}")
    key = "wall_normal_deviation_deg"
    if before[key] and after[key]:
        found.append(f"angle at walls {before[key]['rms']:.3g} -> {after[key]['rms']:.3g} degrees rms")
    if before["invalid_cells"]:
        found.append(f"invalid cells {before['invalid_cells']:,} -> {after['invalid_cells']:,}")
    return [f"the method alone -> repaired: {', '.join(found)}"]


def _layer_text(name: str, change: dict[str, Any]) -> str:
    walls = f"of the {change['lines']:,} grid lines that begin at {name} walls"
    if not change["changed"]:
        return f"none {walls} changed by more than 1% in its first cells"
    ranges = [(what, change[key]) for what, key in _LAYERS if change[key]]
    heights = ", ".join(f"{what} {ratio['min']:.3g}..{ratio['max']:.3g}" for what, ratio in ranges)
    return (
        f"{change['changed']:,} {walls} changed by more than 1% there (height over that by the method alone: {heights})"
    )
