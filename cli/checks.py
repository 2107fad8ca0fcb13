"""Checks before anything is computed: outputs replace no file by accident, and grids fit into the memory."""

from __future__ import annotations

import contextlib
import dataclasses
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from meshdeform_core.errors import CaseError, FormatError
from meshdeform_core.memory import Amounts, Demand, MemoryLimit, Work
from meshdeform_core.parallel import set_sharing

from .options import CaseInput, Files, GridInput, RunInput

if TYPE_CHECKING:
    from meshdeform_core.grid import Grid
    from meshdeform_formats.grids import Layout

_NODES = 4
"""Bytes of a file that hold one node at most: compressed, in single precision."""
_COORDINATES = 24
_SMALL = 1 << 20


def check_order(source: GridInput, case: CaseInput) -> None:
    """Refuse a case file in the place of the grid."""
    if source.path.suffix.lower() == ".toml":
        grid = case.file if case.file and case.file.suffix.lower() != ".toml" else "GRID"
        raise click.UsageError(f"{source.path} is a case file; expected the grid first: {grid} -c {source.path}")


def check_output(path: Path, force: bool, inputs: Files = ()) -> None:
    """Refuse, before anything is computed, to overwrite a file unasked, or an input, or to write into no folder."""
    from meshdeform_formats.files import require_replaceable
    from meshdeform_formats.inputs import existing_outputs, require_no_input

    # First, as reading the pieces of an existing .vtm would block if it were a pipe.
    require_replaceable(path)
    require_no_input(path, [file for _, file in inputs])
    there = existing_outputs(path)
    if there and not force:
        raise FormatError(f"{there[0]} exists; use --force to overwrite it")
    # The folder of an OpenFOAM case is created.
    folder = path.parent.absolute().parent if path.suffix.lower() == ".foam" else path.parent
    if not folder.is_dir():
        reason = "is a file" if folder.exists() else "does not exist; create it first"
        raise FormatError(f"cannot write {path}: the folder {folder} {reason}")


def check_target(output: Path | None, run: RunInput, inputs: Files) -> None:
    """Refuse the output of a command that makes a grid if it cannot be written, before anything is computed."""
    from meshdeform_formats.files import invalid_path
    from meshdeform_formats.grids import format_of

    if run.dry_run:
        return
    if output is None:
        raise click.UsageError("Missing option '-o' / '--output' (or --dry-run).")
    format_of(output)
    if run.fields:
        from meshdeform_formats.fields import check_fields

        check_fields(run.fields, output, True)
    check_output(output, run.force, inputs)
    # The invalid grid of an earlier run may be replaced, or goes when the grid is valid; an input never.
    check_output(invalid_path(output), True, inputs)


def keep_boundaries(grid: Grid, output: Path, force: bool, inputs: Files) -> Callable[[], Path | None]:
    """A function that writes the boundaries which the format of an output cannot hold into a neutral map file beside it
    and returns its path; refuses to replace other boundaries. Types are the families or names of patches, so that case
    files remain usable."""
    from meshdeform_formats.grids import FORMATS, format_of
    from meshdeform_formats.neutral_map import neutral_map_text, write_neutral_map

    entry, path = FORMATS[format_of(output)], output.with_suffix(".nmf")
    if not (grid.patches and not entry.patches) and not (grid.connections and not entry.connections):
        return lambda: None
    named = tuple(dataclasses.replace(patch, bc_type=patch.family or patch.name) for patch in grid.patches)
    mapped = dataclasses.replace(grid, patches=named)
    with contextlib.suppress(OSError):
        # As after a conversion of the same grid to another format, or the file that they were read from.
        told = path.is_file() and path.read_bytes() == neutral_map_text(mapped).encode("utf-8")
        if told or any(file and path.samefile(file) for _, file in inputs):
            return lambda: path
    try:
        check_output(path, force, inputs)
    except FormatError as error:
        raise FormatError(
            f"{error}. {output.suffix} files cannot hold boundaries, which are therefore written next to {output} as "
            f"{path.name}, but that file has other content"
        ) from error
    return lambda: write_neutral_map(mapped, path)


def check_reports(reports: tuple[Path, ...], force: bool, inputs: Files) -> None:
    """:func:`check_output` for reports, whose suffix must be known."""
    from meshdeform_formats.report.write import check_report_path

    for path in reports:
        # A single dash is stdout.
        if str(path) != "-":
            check_report_path(path)
            check_output(path, force, inputs)


def make_folder(output: Path) -> None:
    """Make the folder for several outputs, unless it exists; a file in its place is an error."""
    if output.exists() and not output.is_dir():
        raise CaseError(f"{output} is a file; expected a folder")
    output.mkdir(parents=True, exist_ok=True)


def make_room(limit: MemoryLimit, doing: str, work: Work, sources: Sequence[GridInput], folder: Path | None) -> None:
    """Refuse grids that do not fit, from the headers of their files; large arrays are put into files in ``folder`` if
    that helps. ``doing`` is the word for it in the message that states the required size, like ``deforming``."""
    there = [source for source in sources if source.path.is_file()]
    size = sum(_bytes_of(source.path) for source in there)
    if _at_most(work, size).in_memory <= limit.size:
        set_sharing(scratch=None)
        return
    layouts = [source.block_sizes() for source in there]
    known = [layout for layout in layouts if layout is not None]
    if len(known) < len(layouts):
        names = " and ".join(str(source.path) for source in there)
        whole = work._replace(more=work.more + _COORDINATES)
        Demand(f"{doing} {names} (read as a whole)", whole, Amounts(1, size // _COORDINATES)).place(limit, None)
    else:
        Demand.of(doing, work, *known, ranks=limit.ranks).place(limit, folder)


def too_large(limit: MemoryLimit, work: Work, source: GridInput) -> Layout | None:
    """The blocks of a grid that cannot be deformed in memory; ``None`` for others, and where its header does not
    tell."""
    if not source.path.is_file() or _at_most(work, _bytes_of(source.path)).in_memory <= limit.size:
        return None
    layout = source.block_sizes()
    fits = layout is None or Demand.of("deforming", work, layout, ranks=limit.ranks).in_memory <= limit.size
    return None if fits else layout


def _at_most(work: Work, size: int) -> Demand:
    """What the grid in a file of this size takes at most: every node may be on a face outside."""
    nodes = size // _NODES
    return Demand("", work, Amounts(1, nodes, nodes, nodes, nodes))


def _bytes_of(path: Path) -> int:
    """Size of a file; for small ones, including the files that they may refer to."""
    from meshdeform_formats.inputs import files_behind

    size = os.path.getsize(path)
    return size if size > _SMALL else sum(os.path.getsize(each) for each in files_behind(path) if each.is_file())
