"""The page of validation: our numbers, the paper's, the differences, and their reasons."""

from __future__ import annotations

from typing import Any

from .report import Results, grid, number, pair, pictures, points, remark, robustness_markdown, samples


def validation_page(results: Results, figures: str) -> str:
    """The page; ``figures`` is the path from it to the folder of the figures."""
    machine = results["machine"]
    sizes = "Sizes are the paper's."
    if results["quick"]:
        sizes = "It was run with `--quick`: grids are smaller than the paper's, so its numbers cannot be expected."
    parts = [
        "# Validation against the paper",
        "Sen, De Nayer, Breuer: A fast and robust hybrid method for block-structured mesh deformation with emphasis on "
        "FSI-LES applications, Int. J. Numer. Meth. Engng (2017). This page is written by `meshdeform reproduce all "
        f"-o reproduced --validation reproduced/validation.md`. {sizes}",
        "`measured` is from an independent implementation of the same definitions. Differences are ours minus the "
        "paper's, which prints two digits: up to 0.005 is rounding. Nothing is fitted per row; what the paper leaves "
        "open is stated with each table. Costs are CPU times relative to one row, of set-up and deformation (`cost`) "
        f"and of the deformation alone (`apply`), from one process on {machine['processor']}, {machine['threads']} "
        "threads. The paper's are from another machine and program, with MINRES for its RBF rows; in Tables II to IV "
        "our TFI takes only milliseconds, which makes all costs relative to it larger.",
    ]
    parts += [_table(table, figures) for table in results["tables"].values()]
    if "robustness" in results:
        parts.append(robustness_markdown(results["robustness"], figures))
    return "\n\n".join([*parts, _COUNTING]) + "\n"


_COUNTING = """## How operations are counted

GFLOP are counted from the loops of the program, not measured: every addition, multiplication, division and square root
counts as 1, a logarithm as 29. Per target-source pair, exact IDW sums take 30 (distance 8, root and inverse 2, weight
of eq. 16 5, eight sums 15); RBF sums take 14 plus the basis function (TPS 31, W C0 3, W C2 7, CTPS 41 or 42). TFI takes
207 per node in 3-D and 69 in 2-D, including arc lengths. A direct RBF solution takes n^3/3 + 16 n^2 plus the matrix; a
MINRES iteration 2 n^2 + 24 n per component; a greedy update n times distance, basis and 12, and each of its rounds a
direct solution in the points kept. The formulas are in `sample_cases/reproduce/operations.py`."""


def _table(table: dict[str, Any], figures: str) -> str:
    head = [
        "method", "ours", "paper", "difference", "measured", "min", "bad cells", "cost", "apply", "paper's cost",
        "GFLOP (paper)", "points (paper)",
    ]  # fmt: skip
    body, reasons = [], []
    for row in table["rows"]:
        off = None if row["paper_f_skew"] is None else row["f_skew"] - row["paper_f_skew"]
        body.append([
            row["method"], f"{row['f_skew']:.4f}", number(row["paper_f_skew"], ".2f"), number(off, "+.3f"),
            number(row["measured_f_skew"], ".4g"), f"{row['f_skew_min']:.3f}", str(row["invalid_cells"]),
            number(row["relative_cost"], ".3g"), number(row["relative_apply_cost"], ".3g"),
            number(row["paper_relative_cost"], ".4g"), pair(row["gflop"], row["paper_gflop"], ".3g", ".4g"),
            points(row),
        ])  # fmt: skip
        said = remark(row)
        said = f"{said[0].upper()}{said[1:]}." if said else ""
        if row["reason"] or said:
            reasons.append(f"- **{row['method']}**: {' '.join(part for part in (said, row['reason']) if part)}")
        elif off is not None and abs(off) > table["tolerance"] + 0.005:
            reasons.append(f"- **{row['method']}**: not reproduced; the reason is not known.")
    why = "Reasons and remarks:\n\n" + "\n".join(reasons) if reasons else ""
    parts = [
        f"## {table['title']}",
        table["note"],
        samples(table),
        grid(head, body),
        why,
        pictures(table["figures"], figures),
    ]
    return "\n\n".join(part for part in parts if part)
