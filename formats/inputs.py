"""The files that make up an input, their digest, and those that an output replaces, so that no input is overwritten;
disk space for outputs, which is checked before the computation."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import shutil
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import FileFormat, Grid
from meshdeform_core.memory import readable

from .files import followed
from .grids import Layout, format_at, format_of


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


# --- disk space


def lack(needed: int, path: Path, what: str) -> str:
    """A message on the space on the disk that ``needed`` bytes beside ``path`` lack; empty if they fit.

    ``what`` like ``the grid takes``. An output is completed before it replaces a file. Quotas, and data that others
    write meanwhile, are not considered.
    """
    folder = existing(followed(path).absolute().parent)
    try:
        free = shutil.disk_usage(folder).free
    except OSError:
        # Errors of the folder are reported when the file is written.
        return ""
    if needed <= free:
        return ""
    return (
        f"the disk of {folder} has {readable(free)} free, {what} at least {readable(needed)}; free some space, "
        f"or choose an output on another disk"
    )


def least_bytes(grid: Grid | Layout, path: Path, variant: FileFormat) -> int:
    """Smallest size in bytes of a grid in a file; 0 for text, whose size is not known."""
    name = format_of(path)
    container = grid.format.options.get("container") if grid.format else None
    if name == "cgns" and container == "HDF5" and grid.path is not None and grid.path.exists():
        # A copy of the original file, whose coordinates may be compressed.
        return os.path.getsize(grid.path) // (1 if variant.precision == grid.precision else 2)
    options = variant.options
    raw = name == "cgns" or (name in ("plot3d", "vtk") and options.get("encoding") != "ascii")
    plane = name == "plot3d" and str(options.get("dimension")) == "2"
    count = 3 if name == "vtk" else 2 if plane else grid.dimension
    return grid.n_nodes * count * np.dtype(variant.precision).itemsize if raw else 0


def velocity_bytes(grid: Grid | Layout, velocity: str, precision: str) -> int:
    """Smallest size in bytes of the velocities at the nodes, and of what the cell faces sweep, of one level."""
    if velocity == "none":
        return 0
    faces = 2 * np.dtype("float64").itemsize * grid.n_cells if velocity == "swept" else 0
    return grid.dimension * (grid.n_nodes * np.dtype(precision).itemsize + faces)


def bytes_at(path: Path) -> int:
    """Size of a grid file, of a multi-block set with its blocks; 0 if there is none."""
    parts = [path, *(path.with_suffix("").glob("*") if path.suffix.lower() == ".vtm" else ())]
    return sum(part.stat().st_size for part in parts if part.is_file())


def existing(folder: Path) -> Path:
    """The folder, or its closest parent that exists."""
    return next((each for each in (folder, *folder.parents) if each.is_dir()), folder)
