"""Tables: results of a run beside the values of the paper, as data and as Markdown."""

from __future__ import annotations

import dataclasses
import tomllib
from collections.abc import Callable
from importlib.resources import files
from typing import Any

from .experiment import Outcome, PaperTable, Trial, asymmetry, quality_without_walls, run

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
        "paper_greedy_points": printed.get("greedy_points"),
        "measured_greedy_points": printed.get("measured_points"),
        "iterations": settings.get("iterations"),
        "paper_relative_cost": printed.get("relative_cost"),
        "cpu_seconds": outcome.cpu,
        "cpu_apply_seconds": outcome.cpu_apply,
        "seconds": outcome.wall,
        "gflop": outcome.gflop,
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
    return "; ".join(parts)


def as_markdown(results: dict[str, Any]) -> str:
    """All tables of a run with their figures, which lie beside the page."""
    machine = results["machine"]
    sizes = "Sizes are the paper's."
    if results["quick"]:
        sizes = "It was run with `--quick`: grids are smaller than the paper's, so its numbers cannot be expected."
    parts = [
        "# The paper's tables by meshdeform",
        "Sen, De Nayer, Breuer: A fast and robust hybrid method for block-structured mesh deformation with emphasis on "
        "FSI-LES applications, Int. J. Numer. Meth. Engng (2017). This page is written by `meshdeform reproduce`. "
        f"{sizes}",
        "`measured` is from an independent implementation of the same definitions. Differences are ours minus the "
        "paper's, which prints two digits: up to 0.005 is rounding. Nothing is fitted per row; what the paper leaves "
        "open is stated with each table. Costs are CPU times relative to one row, of set-up and deformation (`cost`) "
        "and of the deformation alone (`apply`), lowest of several runs in one process on "
        f"{machine['processor']}, {machine['threads']} threads, meshdeform {results['meshdeform']}, Python "
        f"{machine['python']}. The paper's are from another machine and program, with MINRES for its RBF rows; in "
        "Tables II to IV our TFI takes only milliseconds, which makes all costs relative to it larger.",
    ]
    return "\n\n".join([*parts, *map(_table, results["tables"].values()), _COUNTING]) + "\n"


_COUNTING = """## How operations are counted

GFLOP are counted from the loops of the program, not measured: every addition, multiplication, division and square root
counts as 1, a logarithm as 29. Per target-source pair, exact IDW sums take 30 (distance 8, root and inverse 2, weight
of eq. 16 5, eight sums 15); RBF sums take 14 plus the basis function (TPS 31, W C0 3, W C2 7, CTPS 41 or 42). TFI takes
207 per node in 3-D and 69 in 2-D, including arc lengths. A direct RBF solution takes n^3/3 + 16 n^2 plus the matrix; a
MINRES iteration 2 n^2 + 24 n per component; a greedy update n times distance, basis and 12, and each of its rounds a
direct solution in the points kept. The formulas are in `sample_cases/reproduce/paper_methods.py`."""


def _table(table: dict[str, Any]) -> str:
    head = [
        "method", "ours", "paper", "difference", "measured", "min", "bad cells", "cost", "apply", "paper's cost",
        "GFLOP (paper)", "points (paper)",
    ]  # fmt: skip
    extra = any("asymmetry" in row for row in table["rows"])
    body, reasons = [], []
    for row in table["rows"]:
        off = None if row["paper_f_skew"] is None else row["f_skew"] - row["paper_f_skew"]
        gflop = _number(row["gflop"], ".3g")
        if row["paper_gflop"] is not None:
            gflop = f"{gflop} ({row['paper_gflop']:.4g})".strip()
        points = str(row["greedy_points"] or "")
        if points and row["paper_greedy_points"]:
            points = f"{points} ({row['paper_greedy_points']})"
        body.append([
            row["method"], f"{row['f_skew']:.4f}", _number(row["paper_f_skew"], ".2f"), _number(off, "+.3f"),
            _number(row["measured_f_skew"], ".4g"), f"{row['f_skew_min']:.3f}", str(row["invalid_cells"]),
            _number(row["relative_cost"], ".3g"), _number(row["relative_apply_cost"], ".3g"),
            _number(row["paper_relative_cost"], ".4g"), gflop, points,
            *([f"{row['asymmetry']:.1e}"] if extra else []),
        ])  # fmt: skip
        free = row["f_skew_without_walls"]
        said = "; ".join(filter(None, (row["remark"], "" if free is None else f"boundary as interpolated: {free:.4f}")))
        said = f"{said[0].upper()}{said[1:]}." if said else ""
        if row["reason"] or said:
            reasons.append(f"- **{row['method']}**: {' '.join(filter(None, (said, row['reason'])))}")
        elif off is not None and abs(off) > table["tolerance"] + 0.005:
            reasons.append(f"- **{row['method']}**: not reproduced; the reason is not known.")
    parts = [
        f"## {table['title']}",
        table["note"],
        f"Run on: {'; '.join(dict.fromkeys(row['sample'] for row in table['rows']))}.",
        grid([*head, *(["asymmetry"] if extra else [])], body),
        "Reasons and remarks:\n\n" + "\n".join(reasons) if reasons else "",
        "\n\n".join(f"![{name.partition('.')[0]}](./{name})" for name in table["figures"]),
    ]
    return "\n\n".join(filter(None, parts))


def _number(value: float | None, style: str) -> str:
    return "" if value is None else format(value, style)


def grid(head: list[str], body: list[list[str]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *body]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
