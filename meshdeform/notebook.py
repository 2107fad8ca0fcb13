"""HTML of results for notebooks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from html import escape
from typing import Any


def html_table(head: str, rows: Iterable[tuple[str, ...]], heads: tuple[str, ...] = ()) -> str:
    """A paragraph followed by a table of texts."""
    top = f"<tr>{''.join(f'<th>{escape(text)}</th>' for text in heads)}</tr>" if heads else ""
    body = "".join(f"<tr>{''.join(f'<td>{escape(text)}</td>' for text in row)}</tr>" for row in rows)
    return f"<p>{escape(head)}</p><table>{top}{body}</table>"


def quality_rows(quality: Mapping[str, Any]) -> list[tuple[str, str]]:
    """The most important quality measures of a grid, from a report's quality section."""
    return [
        ("f_skew harmonic mean", f"{quality['f_skew']['harmonic_mean']:.4f}"),
        ("f_skew minimum", f"{quality['f_skew']['min']:.4f}"),
        ("smallest scaled Jacobian", f"{quality['min_scaled_jacobian']:.4f}"),
        ("invalid cells", f"{quality['invalid_cells']:,}"),
    ]


class QualityReport(dict[str, Any]):
    """A quality report (docs/report.md) that a notebook shows as a table."""

    def _repr_html_(self) -> str:
        before, after = (quality_rows(self["quality"][when]) for when in ("before", "after"))
        verdict = "valid" if self["valid"] else f"INVALID: {self['quality']['after']['invalid_cells']:,} cells"
        if self["shape"]["before"] is None:
            return html_table(verdict, after)
        rows = [(name, old, new) for (name, old), (_, new) in zip(before, after, strict=True)]
        return html_table(verdict, rows, ("", "before", "after"))
