"""Results as Markdown: our numbers, the paper's, the differences, and their reasons."""

from __future__ import annotations

from typing import Any

from .rows import Row

Results = dict[str, Any]


def as_markdown(results: Results) -> str:
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
direct solution in the points kept. The formulas are in `sample_cases/reproduce/operations.py`."""


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
        body.append([
            row["method"], f"{row['f_skew']:.4f}", _number(row["paper_f_skew"], ".2f"), _number(off, "+.3f"),
            _number(row["measured_f_skew"], ".4g"), f"{row['f_skew_min']:.3f}", str(row["invalid_cells"]),
            _number(row["relative_cost"], ".3g"), _number(row["relative_apply_cost"], ".3g"),
            _number(row["paper_relative_cost"], ".4g"), gflop, _points(row),
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


def _points(row: Row) -> str:
    """Greedy points: ours, their range over start nodes, the paper's."""
    if row["greedy_points"] is None:
        return ""
    low_high = row["greedy_points_range"]
    ours = str(row["greedy_points"]) + (f", {low_high[0]}-{low_high[1]} by start" if low_high else "")
    return f"{ours} ({row['paper_greedy_points']})" if row["paper_greedy_points"] else ours


def grid(head: list[str], body: list[list[str]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *body]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
