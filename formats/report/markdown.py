"""Reports as GitHub-flavoured Markdown, short enough for the summary of a CI run."""

from __future__ import annotations

from collections.abc import Iterator

from meshdeform_core.wording import counted

from .records import Report
from .remedies import remedy_of
from .repaired import repair_sentence
from .tables import Table, components_table, levels_table, measures_table, number

_SHOWN = 10


def as_markdown(report: Report) -> str:
    """Verdict, measures or levels, warnings, command."""
    return "\n".join(_lines(report)) + "\n"


def _lines(report: Report) -> Iterator[str]:
    grid = report["grid"]
    yield f"## {'✅' if report['valid'] else '❌'} {_escaped(grid['file'] or 'grid')}: {_verdict(report)}"
    yield ""
    if done := repair_sentence(report):
        yield f"**Repair:** {_escaped(done)}."
        yield ""
    yield f"{grid['dimension']}-D, {counted(grid['blocks'], 'block')}, {grid['nodes']:,} nodes, {grid['cells']:,} cells"
    if report.get("components"):
        yield from _table(components_table(report))
    if "levels" in report:
        yield from _table(levels_table(report))
    else:
        if report["invalid_groups"]:
            yield from _table(_groups(report))
        yield from _table(measures_table(report))
    if report["warnings"]:
        yield from ("", "### Warnings", "")
        for warning in report["warnings"]:
            advice = remedy_of(warning)
            yield f"- {_escaped(warning)}{f'<br>{_escaped(advice)}' if advice else ''}"
    if report.get("run"):
        yield from ("", "```sh", report["run"]["command"], "```")
    if "timing" in report:
        yield from ("", f"{report['timing']['total']:.1f} s, meshdeform {report['meshdeform']}")


def _verdict(report: Report) -> str:
    if report["valid"]:
        return "valid"
    if "levels" in report:
        bad = sum(not level["valid"] for level in report["levels"])
        return f"{bad} of {len(report['levels'])} levels are not valid"
    if report.get("reached", 1.0) < 1.0:
        return f"only {report['reached']:.1%} of the motion imposed"
    return f"{report['quality']['after']['invalid_cells']:,} cells became invalid"


def _groups(report: Report) -> Table:
    rows = [
        (group["cells"], ", ".join(group["blocks"][:4]), group["nearest_patch"],
         " ".join(f"{x:.4g}" for x in group["center"]), f"{group['block']} {tuple(group['ijk'])}")
        for group in report["invalid_groups"][:_SHOWN]
    ]  # fmt: skip
    return Table("", ("invalid cells", "blocks", "near", "around", "worst"), rows, range(5))


def _table(table: Table) -> Iterator[str]:
    yield ""
    yield f"| {' | '.join(table.heads)} |"
    yield f"|{'|'.join('---' if n in table.texts else '---:' for n in range(len(table.heads)))}|"
    for row in table.rows:
        yield f"| {' | '.join(_escaped(number(cell)) for cell in row)} |"


def _escaped(text: str) -> str:
    """Text escaped for Markdown."""
    for sign in "\\`*_|<>":
        text = text.replace(sign, f"\\{sign}")
    return text
