"""Checks of output paths before anything is computed: nothing is overwritten by accident, and the folder exists."""

from __future__ import annotations

from pathlib import Path

import click

from meshdeform_core.errors import CaseError, FormatError

from .options import CaseInput, GridInput, RunInput


def check_order(source: GridInput, case: CaseInput) -> None:
    """Refuse a case file in the place of the grid."""
    if source.path.suffix.lower() == ".toml":
        grid = case.file if case.file and case.file.suffix.lower() != ".toml" else "GRID"
        raise click.UsageError(f"{source.path} is a case file; expected the grid first: {grid} -c {source.path}")


def keep_inputs(path: Path, *inputs: Path | None) -> None:
    """Refuse an output that would replace a file that the run reads, under any name."""
    from meshdeform_formats.inputs import existing_outputs, require_no_input

    # A new file replaces nothing, so that the inputs need not be searched.
    if existing_outputs(path):
        require_no_input(path, inputs)


def check_output(path: Path, force: bool, *inputs: Path | None) -> None:
    """Refuse, before anything is computed, to overwrite a file or to write where that is impossible.

    Raises
    ------
    FormatError
        When the output exists and ``force`` is not given, is one of the inputs, or its folder is missing.
    """
    from meshdeform_formats.files import require_replaceable
    from meshdeform_formats.inputs import existing_outputs

    # First, as reading the pieces of an existing .vtm would block if it were a pipe.
    require_replaceable(path)
    keep_inputs(path, *inputs)
    there = existing_outputs(path)
    if there and not force:
        raise FormatError(f"{there[0]} exists; use --force to overwrite it")
    # The folder of an OpenFOAM case is created.
    folder = path.parent.absolute().parent if path.suffix.lower() == ".foam" else path.parent
    if not folder.is_dir():
        reason = "is a file" if folder.exists() else "does not exist; create it first"
        raise FormatError(f"cannot write {path}: the folder {folder} {reason}")


def check_target(output: Path | None, run: RunInput, *inputs: Path | None) -> None:
    """Refuse the output of a command that makes a grid if it cannot be written, before anything is computed."""
    from meshdeform_formats.fields import check_fields
    from meshdeform_formats.files import invalid_path
    from meshdeform_formats.grids import format_of

    if run.dry_run:
        return
    if output is None:
        raise click.UsageError("Missing option '-o' / '--output' (or --dry-run).")
    format_of(output)
    check_fields(run.fields, output, True)
    check_output(output, run.force, *inputs)
    if not run.allow_invalid:
        # The invalid grid of an earlier run may be replaced, an input never.
        check_output(invalid_path(output), True, *inputs)


def make_folder(output: Path) -> None:
    """Make the folder for several outputs, unless it exists.

    Raises
    ------
    CaseError
        When there is a file in its place.
    """
    if output.exists() and not output.is_dir():
        raise CaseError(f"{output} is a file; expected a folder")
    output.mkdir(parents=True, exist_ok=True)


def check_reports(reports: tuple[Path, ...], force: bool, *inputs: Path | None) -> None:
    """:func:`check_output` for reports, whose suffix must be known."""
    from meshdeform_formats.report.write import check_report_path

    for path in reports:
        # A single dash is stdout.
        if str(path) != "-":
            check_report_path(path)
            check_output(path, force, *inputs)
