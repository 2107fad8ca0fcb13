"""The files that make up an input, their digest, and those that an output replaces, so that no input is overwritten."""

from __future__ import annotations

import contextlib
import functools
import hashlib
from collections.abc import Iterable
from pathlib import Path

from meshdeform_core.errors import FormatError

from .grids import format_at


def files_of(path: Path) -> list[Path]:
    """The file itself; of an OpenFOAM case, the files that are read."""
    if path.suffix.lower() != ".foam" and not path.is_dir():
        return [path]
    from .openfoam.case import case_files

    return case_files(path)


def digest(path: Path) -> str:
    """SHA-256 of the content of a file; of several files, that of their digests."""
    found = []
    for file in files_of(path):
        with file.open("rb") as stream:
            found.append(hashlib.file_digest(stream, "sha256").hexdigest())
    return found[0] if len(found) == 1 else hashlib.sha256("".join(found).encode()).hexdigest()


def size(path: Path) -> int:
    """Size of an input in bytes."""
    return sum(file.stat().st_size for file in files_of(path))


def require_no_input(output: Path, inputs: Iterable[Path | None]) -> None:
    """Refuse an output that would replace a file that the run reads, under any name.

    The pieces of multi-block sets and the targets of links in CGNS files are included on both sides.
    """
    outputs: Iterable[Path] = [output]
    if output.suffix.lower() == ".foam":
        outputs = existing_outputs(output)
    elif output.suffix.lower() == ".vtm":
        from .vtk.multiblock import replaced_files

        with contextlib.suppress(FormatError):
            outputs = list(replaced_files(output))
    replaced = {identity: path for path in outputs if (identity := _identity(path))}
    if not replaced:
        return
    for source in inputs:
        for file in files_behind(source) if source is not None else ():
            if (identity := _identity(file)) not in replaced:
                continue
            if replaced[identity] == output and file == source:
                raise FormatError(f"{output} is an input; the output must be another file (even with --force)")
            raise FormatError(
                f"writing {output} would replace {replaced[identity]}, which {source} needs; the output must be "
                "another file (even with --force)"
            )


def files_behind(path: Path) -> tuple[Path, ...]:
    """An input file and the files that it refers to: the data sets of a .vtm, the targets of CGNS links."""
    try:
        found = path.stat()
    except (OSError, ValueError):
        return (path,)
    return _files_behind(path, (found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns))


@functools.lru_cache(maxsize=64)
def _files_behind(path: Path, state: tuple[int, ...]) -> tuple[Path, ...]:
    """Cached while the file is unchanged, as the outputs of a series are compared with its inputs one by one."""
    found = [path]
    # Errors in the file are reported when it is read.
    with contextlib.suppress(FormatError):
        kind = format_at(path)
        if kind == "openfoam":
            found += files_of(path)
        elif kind == "cgns":
            from .cgns.format import linked_files

            # Of these files, too.
            for file in found:
                found += [each for each in linked_files(file) if _identity(each) not in map(_identity, found)]
        elif kind == "vtk":
            from .vtk.multiblock import referenced_files

            # Refused unless it is a multi-block set.
            found += [piece for _, piece in referenced_files(path)]
    return tuple(found)


def existing_outputs(output: Path) -> list[Path]:
    """The existing files that writing an output would replace."""
    found = [output] if output.exists() else []
    if output.suffix.lower() == ".foam":
        from .openfoam.case import mesh_files

        found += mesh_files(output)
    return found


def _identity(path: Path) -> tuple[int, int] | None:
    try:
        found = path.stat()
    except (OSError, ValueError):
        return None
    return found.st_dev, found.st_ino
