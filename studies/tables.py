"""Tables of results: rows of named values as Markdown, printed and put on pages of the documentation."""

from __future__ import annotations

import argparse
import os
import re
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from meshdeform_samples.reproduce.report import grid

Row = dict[str, Any]
Job = TypeVar("Job")


def run(
    jobs: Callable[[], Mapping[str, Job]], row: Callable[[str, Job], Row], description: str | None, program: str
) -> None:
    """The command line of a program that makes a row of every motion; ``jobs`` are those possible here, by name."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", metavar="TEXT", default="", help="motions whose name contains this")
    parser.add_argument("--grids", type=Path, metavar="FOLDER", help="where the third-party grids lie")
    parser.add_argument("--write", type=Path, metavar="PAGE", help="put the table between its marks on a page")
    options = parser.parse_args()
    if options.grids:
        os.environ["MESHDEFORM_GRIDS"] = str(options.grids)
    rows = []
    for name, job in jobs().items():
        if options.only in name:
            rows.append(row(name, job))
            print(rows[-1], file=sys.stderr, flush=True)
            keep(rows, options.write, program)
    show(rows, None if options.only else options.write, program)


def show(rows: list[Row], page: Path | None, program: str) -> None:
    """Print the rows as a table, whose columns are their keys, and put it in its place on a page."""
    table = grid(*_cells(rows))
    print(table)
    if page:
        _put_on(page, Path(program).name, table)


def keep(rows: list[Row], page: Path | None, program: str) -> None:
    """Put some rows in the table on a page, so that a run cut off is not lost: instead of those with the same first
    cell, or after all others; a table with other columns is replaced."""
    if page is None:
        return
    (head, lines), name = _cells(rows), Path(program).name
    found = re.search(f"<!-- {re.escape(name)} begin -->\n(.*?)\n<!--", page.read_text(encoding="utf-8"), re.DOTALL)
    table = found[1].splitlines() if found else []
    before = [[cell.strip() for cell in line.strip("| ").split(" | ")] for line in table]
    kept = {line[0]: line for line in before[2:]} if before[:1] == [head] else {}
    _put_on(page, name, grid(head, list((kept | {line[0]: line for line in lines}).values())))


def _cells(rows: list[Row]) -> tuple[list[str], list[list[str]]]:
    columns = list(dict.fromkeys(key for row in rows for key in row))
    return columns, [[_text(row.get(column, "")) for column in columns] for row in rows]


def _put_on(page: Path, program: str, table: str) -> None:
    """Replace what is between the marks ``<!-- program begin -->`` and ``<!-- program end -->`` of a page."""
    begin, end = f"<!-- {program} begin -->", f"<!-- {program} end -->"
    before = page.read_text(encoding="utf-8")
    if begin not in before or end not in before:
        raise SystemExit(f"{page} has no lines {begin} and {end} to put the table between")
    pattern = f"{re.escape(begin)}.*?{re.escape(end)}"
    after = re.sub(pattern, lambda _: f"{begin}\n{table}\n{end}", before, flags=re.DOTALL)
    page.write_text(after, encoding="utf-8")


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.3g}" if abs(value) < 1000 else f"{value:,.0f}"
    return f"{value:,}" if isinstance(value, int) and not isinstance(value, bool) else str(value)
