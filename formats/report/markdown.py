"""Reports as GitHub-flavoured Markdown, short enough for the summary of a CI run."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from meshdeform_core.wording import counted

from .components import HEADS, component_rows
from .measures import measure_rows
from .parts import Report
from .remedies import remedy_of
from .repaired import repair_sentence
from .text import number

_SHOWN = 10


def as_markdown(report: Report) -> str:
    """Verdict, measures or levels, warnings, command."""
    return "\n".join(_lines(report)) + "\n"


def _lines(report: Report) -> Iterator[str]:
    grid = report["grid"]
    yield f"## {'✅' if report['valid'] else '❌'} {_escaped(grid['file'] or 'grid')}: {_verdict(report)}"
    yield ""
    if done := repair_sentence(report):
        yield f"**After a repair:** {_escaped(done)}."
        yield ""
    yield f"{grid['dimension']}-D, {counted(grid['blocks'], 'block')}, {grid['nodes']:,} nodes, {grid['cells']:,} cells"
    if rows := component_rows(report):
        yield ""
        yield from _table(HEADS, [[each if isinstance(each, str) else number(each) for each in row] for row in rows], 3)
    if "levels" in report:
        yield from _levels(report)
    else:
        yield from _quality(report)
    if report["warnings"]:
        yield from ("", "### Warnings", "")
        for warning in report["warnings"]:
            yield f"- {_escaped(warning)}{_advice(warning)}"
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


def _quality(report: Report) -> Iterator[str]:
    groups = report["invalid_groups"]
    if groups:
        yield ""
        yield from _table(
            ("invalid cells", "blocks", "near", "around", "worst"),
            [
                (str(group["cells"]), ", ".join(group["blocks"][:4]), group["nearest_patch"],
                 " ".join(f"{x:.4g}" for x in group["center"]), f"{group['block']} {tuple(group['ijk'])}")
                for group in groups[:_SHOWN]
            ],
            texts=5,
        )  # fmt: skip
    yield ""
    rows = measure_rows(report["quality"])
    yield from _table(
        ("measure", "before", "after", "worst at"),
        [(row.name, number(row.before), number(row.after), row.place) for row in rows],
        texts=1,
    )


def _levels(report: Report) -> Iterator[str]:
    yield ""
    yield from _table(
        ("level", "time", "file", "moved", "f_skew mean", "f_skew min", "invalid"),
        [
            (
                f"{level['number']}",
                f"{level['time']:.6g}",
                level["file"],
                f"{level['max_displacement']:.4g}",
                f"{level['quality']['f_skew']['mean']:.4f}",
                f"{level['quality']['f_skew']['min']:.4f}",
                f"{level['quality']['invalid_cells']:,}",
            )
            for level in report["levels"]
        ],
        texts=0,
    )


def _table(heads: Sequence[str], rows: Iterable[Sequence[str]], texts: int) -> Iterator[str]:
    """A table; in addition to the first column the last ``texts`` ones are texts."""
    numbers = range(1, len(heads) - texts)
    yield f"| {' | '.join(heads)} |"
    yield f"|{'|'.join('---:' if n in numbers else '---' for n in range(len(heads)))}|"
    for row in rows:
        yield f"| {' | '.join(_escaped(cell) for cell in row)} |"


def _advice(warning: str) -> str:
    advice = remedy_of(warning)
    return f"<br>{_escaped(advice)}" if advice else ""


def _escaped(text: str) -> str:
    """Text escaped for Markdown."""
    for sign in "\\`*_|<>":
        text = text.replace(sign, f"\\{sign}")
    return text
