"""Rows of a table: results of a run beside the values of the paper."""

from __future__ import annotations

import dataclasses
import tomllib
from collections.abc import Callable
from importlib.resources import files
from typing import Any

from .experiment import Outcome, Trial, asymmetry, greedy_range, quality_without_walls, run
from .tables import PaperTable

Row = dict[str, Any]
Tell = Callable[[str, int, int], None]
"""``tell(label, done, total)`` before every run."""


def paper() -> dict[str, Any]:
    """The paper's tables with the values of an independent implementation, see ``paper.toml``."""
    return tomllib.loads((files(__package__) / "paper.toml").read_text(encoding="utf-8"))


def reproduce_table(table: PaperTable, tell: Tell, keep: Callable[[Trial, Outcome], None]) -> dict[str, Any]:
    """Run all trials of a table; ``keep`` is called with each outcome (for figures) before it is discarded."""
    printed = paper()[table.name]
    by_key = {row["key"]: row for row in printed["rows"]}
    rows = []
    for done, trial in enumerate(table.trials):
        tell(f"{table.name} {trial.key}", done, len(table.trials))
        outcome = run(trial)
        rows.append(_row(trial, outcome, by_key[trial.key]))
        keep(trial, outcome)
    tell(table.name, len(table.trials), len(table.trials))
    order = [row["key"] for row in printed["rows"]]
    rows.sort(key=lambda row: order.index(row["key"]))
    reference = next(row for row in rows if row["key"] == table.reference)
    for row in rows:
        same = row["nodes"] == reference["nodes"]
        row["relative_cost"] = row["cpu_seconds"] / reference["cpu_seconds"] if same else None
        row["relative_apply_cost"] = row["cpu_apply_seconds"] / reference["cpu_apply_seconds"] if same else None
    return {"name": table.name, **{key: printed[key] for key in ("title", "note", "tolerance")}, "rows": rows}


def _row(trial: Trial, outcome: Outcome, printed: dict[str, Any]) -> Row:
    after = outcome.assessment.after
    settings = {name: setting.value for name, setting in outcome.account.settings.items()}
    grid = outcome.setup.grid
    row: Row = {
        "key": trial.key,
        "method": printed["method"],
        "sample": trial.sample.label,
        "nodes": grid.n_nodes,
        "blocks": grid.n_blocks,
        "sources": len(outcome.setup.problem.source_numbers),
        "f_skew": after.f_skew.harmonic_mean,
        "paper_f_skew": printed.get("f_skew"),
        "measured_f_skew": printed.get("measured"),
        "f_skew_without_walls": quality_without_walls(trial) if trial.method.rbf.greedy != "none" else None,
        "f_skew_min": after.f_skew.min,
        "invalid_cells": after.invalid_cells,
        "greedy_points": settings.get("greedy_points"),
        "greedy_points_range": greedy_range(trial) if trial.starts > 1 else None,
        "paper_greedy_points": printed.get("greedy_points"),
        "measured_greedy_points": printed.get("measured_points"),
        "iterations": settings.get("iterations"),
        "paper_relative_cost": printed.get("relative_cost"),
        "cpu_seconds": outcome.cpu,
        "cpu_apply_seconds": outcome.cpu_apply,
        "seconds": outcome.wall,
        "gflop": outcome.gflop,
        "pairs": outcome.pairs[0],
        "pairs_by_block": outcome.pairs[1],
        "paper_gflop": printed.get("gflop"),
        "quality": dataclasses.asdict(after),
        "reason": printed.get("reason", ""),
        "remark": _remark(trial, outcome),
    }
    if trial.sample.name == "beam":
        origin = dict(trial.sample.options).get("origin", (0.0, 0.0))
        row["asymmetry"], row["measured_asymmetry"] = asymmetry(outcome, origin[0]), printed.get("measured_asymmetry")
    return row


def _remark(trial: Trial, outcome: Outcome) -> str:
    """Crossed cells, bad first cells, and warnings of the method."""
    after, parts = outcome.assessment.after, []
    heights = after.first_cell_height_ratio
    if after.invalid_cells:
        squeezed = heights is not None and heights.min <= 0.0
        parts.append(f"{after.invalid_cells} crossed cells" + (", bad first cell" if squeezed else ""))
    elif heights is not None and (heights.min < 0.2 or heights.max > 5.0):
        parts.append(f"first cells {heights.min:.2g} to {heights.max:.2g} times as high")
    if "divisions" in outcome.account.settings:
        parts.append(f"done in {outcome.account.settings['divisions'].value} steps")
    if any("MINRES stopped" in warning for warning in outcome.account.warnings):
        parts.append("MINRES did not converge")
    if trial.sample.name == "hemisphere":
        parts.append(f"{outcome.setup.grid.n_nodes:,} nodes, {outcome.setup.grid.n_blocks} blocks")
        if outcome.pairs[0]:
            parts.append(f"{outcome.pairs[0]:.2e} pairs, {outcome.pairs[1]:.2e} if each block sums for its own faces")
    return "; ".join(parts)
