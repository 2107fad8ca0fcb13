"""Results as markdown, one table each."""

from __future__ import annotations

from typing import Any

from .rows import Row

Results = dict[str, Any]


def as_markdown(results: Results) -> str:
    """All tables of a run with their figures."""
    machine = results["machine"]
    parts = [
        "# The paper's tables by meshdeform",
        f"{'Quick sizes, smaller than the paper. ' if results['quick'] else ''}meshdeform {results['meshdeform']}, "
        f"{machine['processor']}, {machine['threads']} threads, Python {machine['python']}. Costs are CPU seconds of "
        "set-up and deformation, lowest of several runs in one process, relative to the row with 1.",
    ]
    parts += [table_markdown(table) for table in results["tables"].values()]
    if "robustness" in results:
        parts.append(robustness_markdown(results["robustness"], "."))
    return "\n\n".join(parts) + "\n"


def table_markdown(table: dict[str, Any]) -> str:
    """One table: our values, the paper's in brackets."""
    head = [
        "method", "f_skew (paper)", "min", "bad cells", "cost (paper)", "apply only", "GFLOP (paper)",
        "points (paper)", "remark",
    ]  # fmt: skip
    extra = any("asymmetry" in row for row in table["rows"])
    if extra:
        head.insert(3, "asymmetry")
    body = []
    for row in table["rows"]:
        cells = [
            row["method"], pair(row["f_skew"], row["paper_f_skew"], ".4f", ".2f"), f"{row['f_skew_min']:.3f}",
            str(row["invalid_cells"]), pair(row["relative_cost"], row["paper_relative_cost"], ".3g", ".4g"),
            number(row["relative_apply_cost"], ".3g"), pair(row["gflop"], row["paper_gflop"], ".3g", ".4g"),
            points(row), remark(row),
        ]  # fmt: skip
        if extra:
            cells.insert(3, f"{row['asymmetry']:.1e}")
        body.append(cells)
    parts = [f"## {table['title']}", table["note"], samples(table), grid(head, body), pictures(table["figures"], ".")]
    return "\n\n".join(parts).rstrip()


def samples(table: dict[str, Any]) -> str:
    """A sentence that names the samples of a table."""
    return f"Run on: {'; '.join(dict.fromkeys(row['sample'] for row in table['rows']))}."


_LARGEST = {"one_step": "one step", "marching": "marching", "repaired": "one step and repair"}


def robustness_markdown(robustness: dict[str, Any], folder: str) -> str:
    """Largest valid angles, and the figures."""
    largest = robustness["largest_angle"]
    body = [[row["method"], *(number(row[key], "g") for key in _LARGEST)] for row in largest["rows"]]
    step, tried = largest["step"], ", ".join(f"{angle:g}" for angle in largest["repaired"])
    text = (
        f"## Robustness\n\nLargest valid rotation of the body of `{robustness['sample']}` in degrees, in multiples of "
        f"{step:g}: imposed in one step, and marching in steps of {step:g} degrees from the last grid, both without "
        f"repair; and in one step with repair, of {tried}"
    )
    head = ["method", *(f"{title} [deg]" for title in _LARGEST.values())]
    return f"{text}.\n\n{grid(head, body)}\n\n{pictures(robustness['figures'], folder)}"


def pictures(names: list[str], folder: str) -> str:
    """Markdown images of the figures in a folder."""
    return "\n\n".join(f"![{name.partition('.')[0]}]({folder}/{name})" for name in names)


def number(value: float | None, style: str) -> str:
    """A formatted number, or an empty text."""
    return "" if value is None else format(value, style)


def pair(ours: float | None, theirs: float | None, style: str, paper_style: str) -> str:
    """Our number and the paper's in brackets."""
    text = number(ours, style)
    return f"{text} ({format(theirs, paper_style)})".strip() if theirs is not None else text


def remark(row: Row) -> str:
    """Remarks on a row."""
    free = row["f_skew_without_walls"]
    parts = [row["remark"]] if row["remark"] else []
    return "; ".join(parts if free is None else [*parts, f"boundary as interpolated: {free:.4f}"])


def points(row: Row) -> str:
    """Greedy points: ours, their range over start nodes, the paper's."""
    if row["greedy_points"] is None:
        return ""
    low_high = row["greedy_points_range"]
    ours = str(row["greedy_points"]) + (f", {low_high[0]}-{low_high[1]} by start" if low_high else "")
    return f"{ours} ({row['paper_greedy_points']})" if row["paper_greedy_points"] else ours


def grid(head: list[str], body: list[list[str]]) -> str:
    """A markdown table."""
    lines = [head, ["---"] * len(head), *body]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
