"""The paper's evaluation (Sen, De Nayer, Breuer 2017) rerun: tables and figures."""

from __future__ import annotations

import json
import os
import platform
import re
from importlib.metadata import version
from pathlib import Path
from typing import Any

from meshdeform_core.parallel import thread_count
from meshdeform_formats.files import replacing

from .experiment import TABLES
from .figures import Gallery
from .report import Tell, as_markdown, reproduce_table

__all__ = ["reproduce"]


def reproduce(what: str, folder: Path, quick: bool, tell: Tell) -> dict[str, Any]:
    """Run a table, or ``all``; write data, markdown and figures into ``folder``.

    ``quick``: at sizes that take minutes instead of an hour.
    """
    info = Path("/proc/cpuinfo")
    named = re.search(r"model name\s*: (.*)", info.read_text("utf-8", "replace")) if info.exists() else None
    processor = named[1] if named else platform.processor() or platform.machine()
    machine = {
        "processor": processor, "cores": os.cpu_count(), "threads": thread_count(),
        "python": platform.python_version(), "system": platform.system(),
    }  # fmt: skip
    results: dict[str, Any] = {
        "schema": 1, "meshdeform": version("meshdeform"), "quick": quick, "machine": machine, "tables": {},
    }  # fmt: skip
    for name in TABLES if what == "all" else (what,):
        gallery = Gallery(name, folder)
        table = reproduce_table(TABLES[name](quick), tell, gallery.keep)
        results["tables"][name] = table | {"figures": gallery.write()}
        _write(folder / name, results | {"tables": {name: results["tables"][name]}})
    _write(folder / "results", results)
    return results


def _write(stem: Path, results: dict[str, Any]) -> None:
    """Write data and tables side by side: ``stem.json``, where the rows of a single table are at the top, and
    ``stem.md``."""
    tables = list(results["tables"].values())
    flat = results | tables[0] if len(tables) == 1 else results
    data = json.dumps(flat, indent=1, allow_nan=False) + "\n"
    for suffix, text in ((".json", data), (".md", as_markdown(results))):
        with replacing(stem.with_suffix(suffix)) as partial:
            partial.write_text(text, encoding="utf-8")
