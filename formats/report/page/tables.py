"""Tables as html."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import Any

from ..text import number

Row = Sequence[Any]


def table(caption: str, heads: Sequence[str], rows: Sequence[Row], *, text: Sequence[int] = (0,), **looks: Any) -> str:
    """A table; columns ``text`` hold texts, all others numbers.

    ``looks``: ``sortable`` for buttons in the header; ``flagged``, numbers of the rows to highlight.
    """
    flagged = looks.get("flagged", ())
    head = "".join(f'<th scope="col"{_text(n in text)}>{escape(name)}</th>' for n, name in enumerate(heads))
    body = "".join(
        f"<tr{' class=flagged' if n in flagged else ''}>{''.join(_cell(v, c in text) for c, v in enumerate(row))}</tr>"
        for n, row in enumerate(rows)
    )
    kind = ' class="sortable"' if looks.get("sortable") else ""
    return (
        f'<div class="scroll" tabindex="0" role="region" aria-label="{escape(caption)}"><table{kind}>'
        f"<caption>{escape(caption)}</caption><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>"
    )


def _cell(value: Any, text: bool) -> str:
    if text or value is None:
        return f"<td{_text(text)}>{escape(str(value)) if value is not None else ''}</td>"
    if isinstance(value, str):
        return f"<td>{escape(value)}</td>"
    return f'<td data-value="{value}">{escape(number(value))}</td>'


def _text(yes: bool) -> str:
    return ' class="text"' if yes else ""
