"""What an input consists of: one file, or those of an OpenFOAM case."""

from __future__ import annotations

import hashlib
from pathlib import Path


def files_of(path: Path) -> list[Path]:
    """The file itself; of a case of OpenFOAM, what is read of it."""
    if path.suffix.lower() != ".foam" and not path.is_dir():
        return [path]
    from .openfoam.case import case_files

    return case_files(path)


def digest(path: Path) -> str:
    """SHA-256 of the content of a file; of several files, that of their digests."""
    found = [_digest(file) for file in files_of(path)]
    return found[0] if len(found) == 1 else hashlib.sha256("".join(found).encode()).hexdigest()


def size(path: Path) -> int:
    """Bytes."""
    return sum(file.stat().st_size for file in files_of(path))


def _digest(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
