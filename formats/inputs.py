"""The files that make up an input, their digest, and those that an output replaces, so that no input is overwritten."""

from __future__ import annotations

import contextlib
import functools
import hashlib
from collections.abc import Iterable, Iterator
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

    Raises FormatError naming both files.
    """
    replaced = {identity: path for path in _replaced(output) if (identity := _identity(path))}
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
            found += _linked_files(path)
        elif kind == "vtk":
            from .vtk.multiblock import referenced_files
            from .vtk.xml_tags import file_kind

            if file_kind(path) == "vtkMultiBlockDataSet":
                found += referenced_files(path)
    return tuple(found)


def _replaced(output: Path) -> Iterable[Path]:
    if output.suffix.lower() == ".foam":
        return existing_outputs(output)
    if output.suffix.lower() != ".vtm":
        return [output]
    from .vtk.multiblock import replaced_files

    try:
        return replaced_files(output)
    except FormatError:
        return [output]


def existing_outputs(output: Path) -> list[Path]:
    """The existing files that writing an output would replace."""
    found = [output] if output.exists() else []
    if output.suffix.lower() == ".foam":
        from .openfoam.case import mesh_files

        found += mesh_files(output)
    return found


def _linked_files(path: Path) -> Iterator[Path]:
    """The targets of links, including the targets of links in these files."""
    from .cgns.file import linked_files

    found, waiting = {_identity(path)}, [path]
    while waiting:
        for target in linked_files(waiting.pop()):
            if _identity(target) not in found:
                found.add(_identity(target))
                waiting.append(target)
                yield target


def _identity(path: Path) -> tuple[int, int] | None:
    try:
        found = path.stat()
    except (OSError, ValueError):
        return None
    return found.st_dev, found.st_ino
