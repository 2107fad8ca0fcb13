"""Writing reports as JSON, text or HTML; their provenance."""

from __future__ import annotations

import datetime
import math
import os
import platform
import shlex
from collections.abc import Iterable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from meshdeform_core.errors import FormatError
from meshdeform_core.parallel import thread_count

from ..files import replacing
from ..inputs import digest, files_of, size
from ..text import json_text
from .records import Report
from .tables import Illustrate

SUFFIXES = (".json", ".txt", ".html")
_LIBRARIES = ("numpy", "scipy", "numba")


def write_report(report: Report, path: Path, illustrate: Illustrate = tuple) -> None:
    """Write a report; the suffix selects json, txt or html. Pictures are made only for HTML.

    Raises FormatError for another suffix, or when the file cannot be written.
    """
    check_report_path(path)
    if path.suffix == ".json":
        text = as_json(report)
    elif path.suffix == ".txt":
        from .text import as_text

        text = as_text(report)
    else:
        from .page import as_html

        folder = os.path.relpath(report["series"]["folder"], path.parent) if "series" in report else ""
        text = as_html(report, illustrate(), folder)
    with replacing(path) as partial:
        partial.write_text(text, encoding="utf-8", errors="surrogateescape")


def as_json(report: Report) -> str:
    """The report as JSON; non-finite numbers, which JSON lacks, are null."""
    return json_text(_finite(report), allow_nan=False) + "\n"


def _finite(value: Any) -> Any:
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    return value


def check_report_path(path: Path) -> None:
    """Refuse an unknown suffix before anything is computed."""
    if path.suffix not in SUFFIXES:
        raise FormatError(f"report {path}: suffix {path.suffix!r} is unknown; expected {', '.join(SUFFIXES)}")


def run_part(arguments: Sequence[str], files: Iterable[tuple[str, Path | None]], ranks: int) -> Report:
    """The data needed to repeat a run and to verify that it is the same.

    Parameters
    ----------
    arguments : of the command line, without the program's name
    files : role and path of the files read and written; ``None`` and missing files are omitted
    ranks : number of processes that shared the work
    """
    return {
        "command": shlex.join(["meshdeform", *arguments]),
        "directory": os.getcwd(),
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "threads": thread_count(),
        "ranks": ranks,
        "versions": {"python": platform.python_version(), **{name: version(name) for name in _LIBRARIES}},
        "files": [
            {"role": role, "path": str(path), "bytes": size(path), "sha256": digest(path)}
            for role, path in files
            if path is not None and files_of(path) and path.exists()
        ],
    }
