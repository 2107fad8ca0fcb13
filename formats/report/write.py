"""Reports written as json, text or html."""

from __future__ import annotations

import json
from pathlib import Path

from meshdeform_core.errors import FormatError

from ..files import replacing
from .parts import Report

SUFFIXES = (".json", ".txt", ".html")


def write_report(report: Report, path: Path) -> None:
    """Write a report; the suffix picks json, txt or html.

    Raises
    ------
    FormatError
        For another suffix, or when the file cannot be written.
    """
    check_report_path(path)
    if path.suffix == ".json":
        text = json.dumps(report, indent=2, allow_nan=False) + "\n"
    elif path.suffix == ".txt":
        from .text import as_text

        text = as_text(report)
    else:
        from .html import as_html

        text = as_html(report)
    with replacing(path) as partial:
        partial.write_text(text, encoding="utf-8")


def check_report_path(path: Path) -> None:
    """Refuse an unknown suffix before anything is computed."""
    if path.suffix not in SUFFIXES:
        raise FormatError(f"report {path}: suffix {path.suffix!r} is unknown; expected {', '.join(SUFFIXES)}")
