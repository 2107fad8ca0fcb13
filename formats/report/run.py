"""Provenance of a report: command, time and place, and files with their checksums."""

from __future__ import annotations

import datetime
import hashlib
import os
import platform
import shlex
from collections.abc import Iterable, Sequence
from importlib.metadata import version
from pathlib import Path

from meshdeform_core.parallel import current_ranks, thread_count

from .parts import Report

_LIBRARIES = ("numpy", "scipy", "numba")


def run_part(arguments: Sequence[str], files: Iterable[tuple[str, Path | None]]) -> Report:
    """The data needed to repeat a run and to verify that it is the same.

    Parameters
    ----------
    arguments : of the command line, without the program's name
    files : role and path of the files read and written; ``None`` and missing files are omitted
    """
    return {
        "command": shlex.join(["meshdeform", *arguments]),
        "directory": os.getcwd(),
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "threads": thread_count(),
        "ranks": current_ranks().count,
        "versions": {"python": platform.python_version(), **{name: version(name) for name in _LIBRARIES}},
        "files": [_file(role, path) for role, path in files if path is not None and path.is_file()],
    }


def _file(role: str, path: Path) -> Report:
    with path.open("rb") as stream:
        digest = hashlib.file_digest(stream, "sha256").hexdigest()
    return {"role": role, "path": str(path), "bytes": path.stat().st_size, "sha256": digest}
