"""What a repair did, in one sentence for the banner of the page, the Markdown and the text."""

from __future__ import annotations

from typing import Any

from ..wording import counted


def repair_sentence(report: dict[str, Any]) -> str:
    """How many cells a repair mended, how far nodes moved, and what the method alone would have given; empty without
    a repair."""
    done = report.get("repair")
    if not done:
        return ""
    cells = f"{counted(done['cells'], 'cell')} repaired" if done["cells"] else "weak cells improved"
    largest = report.get("boundary", {}).get("max_displacement")
    part = f" ({done['max_movement'] / largest:.2g} of the largest displacement)" if largest else ""
    alone = [attempt for attempt in report.get("attempts", ()) if not attempt["repair"]]
    before = f"; the method alone leaves {counted(alone[0]['invalid_cells'], 'invalid cell')}" if alone else ""
    return (
        f"{cells}, {counted(done['nodes'], 'node')} moved by up to {done['max_movement']:.4g}{part}, "
        f"{counted(done['newton_steps'], 'Newton step')}{before}"
    )
