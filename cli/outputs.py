"""Checks of outputs before anything is computed: what would be overwritten, and whether there is a folder."""

from __future__ import annotations

from pathlib import Path

from meshdeform_core.errors import FormatError


def keep_inputs(path: Path, *inputs: Path | None) -> None:
    """Refuse an output that would replace a file which the run reads, by whatever name."""
    from meshdeform_formats.inputs import existing_outputs, require_no_input

    # Nothing is replaced where nothing is: no need to look into the inputs.
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

    # First: reading the pieces of an existing .vtm would wait for ever if it were a pipe.
    require_replaceable(path)
    keep_inputs(path, *inputs)
    there = existing_outputs(path)
    if there and not force:
        raise FormatError(f"{there[0]} exists; use --force to overwrite it")
    # The folder of a case is made with it.
    folder = path.parent.absolute().parent if path.suffix.lower() == ".foam" else path.parent
    if not folder.is_dir():
        reason = "is a file" if folder.exists() else "does not exist; create it first"
        raise FormatError(f"cannot write {path}: the folder {folder} {reason}")


def check_reports(reports: tuple[Path, ...], force: bool, *inputs: Path | None) -> None:
    """The same for reports, whose suffix must be known."""
    from meshdeform_formats.report import check_report_path

    for path in reports:
        # A single dash is stdout.
        if str(path) != "-":
            check_report_path(path)
            check_output(path, force, *inputs)
