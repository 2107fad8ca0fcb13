"""Provenance of a report: command, time and place, and files with their checksums."""

from __future__ import annotations

import datetime
import os
import platform
import shlex
from collections.abc import Iterable, Sequence
from importlib.metadata import version
from pathlib import Path

from meshdeform_core.parallel import thread_count

from ..inputs import digest, files_of, size
from .parts import Report

_LIBRARIES = ("numpy", "scipy", "numba")


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
        "files": [_file(role, path) for role, path in files if path is not None and files_of(path) and path.exists()],
    }


def _file(role: str, path: Path) -> Report:
    return {"role": role, "path": str(path), "bytes": size(path), "sha256": digest(path)}
