"""Options that several commands share, and the checks that need no grid."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from meshdeform_core.errors import CaseError, FormatError
from meshdeform_core.memory import MemoryLimit

from .machine import machine_memory

F = TypeVar("F", bound=Callable[..., Any])

PATH = click.Path(path_type=Path)
grid_argument = click.argument("grid", type=PATH)
force_option = click.option("--force", is_flag=True, help="Overwrite an existing output (never the input).")
json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON.")
quiet_option = click.option("-q", "--quiet", is_flag=True, help="Print errors only.")
verbose_option = click.option("-v", "--verbose", is_flag=True, help="Tell more: stages and their times on stderr.")
threads_option = click.option("--threads", type=click.IntRange(min=1), help="Use at most so many threads.")
memory_option = click.option("--max-memory", metavar="SIZE", help="Refuse what needs more, like 2GiB.")
variant_option = click.option(
    "--variant", "variant", metavar="KEY=VALUE", multiple=True,
    help="How to write the output. plot3d: encoding=ascii|binary|fortran byte_order=little|big "
    "precision=float32|float64 markers=4|8 multiblock=true|false iblank=true|false dimension=2|3; "
    "vtk: encoding=ascii|binary|appended compression=none|zlib|lz4|lzma; cgns: precision (repeatable).",
)  # fmt: skip
boundary_file_option = click.option("--boundary-file", type=PATH, help="Neutral map file (.nmf) with the boundaries.")


def case_options(command: F) -> F:
    """Options that say what to do with a grid."""
    for option in (
        click.option("-s", "--set", "overrides", metavar="KEY=VALUE", multiple=True,
                     help="Override a key of the case, like method.idw.alpha=0.3 (repeatable)."),
        click.option("-m", "--method", metavar="NAME", help="tfi, idw, rbf or a hybrid like idw-tfi (the default)."),
        click.option("-d", "--displacement", type=PATH, help="Surface displacement table."),
        click.option("-c", "--case", "case_file", type=PATH, help="Case file (TOML)."),
    ):  # fmt: skip
        command = option(command)
    return command


def parse_variant(pairs: tuple[str, ...]) -> dict[str, str]:
    """``("encoding=ascii", ...)`` as a dictionary."""
    options = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not equals:
            raise FormatError(f"--variant {pair!r}: expected KEY=VALUE, like encoding=ascii")
        options[key.strip()] = value.strip()
    return options


def parse_memory(text: str | None) -> MemoryLimit:
    """``2GiB``, ``500 MB`` or plain bytes; the machine's memory when not given."""
    if text is None:
        return machine_memory()
    match = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([kmgt]?)(i?)b?\s*", text.lower())
    if not match or float(match[1]) == 0:
        raise CaseError(f"--max-memory {text!r}: expected a size like 2GiB, 500MB or 1e9 bytes written out")
    base = 1024 if match[3] else 1000
    size = int(float(match[1]) * base ** ("", "k", "m", "g", "t").index(match[2]))
    return MemoryLimit(size, "--max-memory allows")


def check_output(path: Path, force: bool, *inputs: Path | None) -> None:
    """Refuse, before anything is computed, to write where something lies or where nothing can be written.

    Raises
    ------
    FormatError
        When the output exists and ``force`` is not given, is one of the inputs, or its folder is missing.
    """
    for source in inputs:
        if source is not None and path.exists() and source.exists() and path.samefile(source):
            raise FormatError(f"{path} is an input; the output must be another file (even with --force)")
    if path.exists() and not force:
        raise FormatError(f"{path} exists; use --force to overwrite it")
    if not path.parent.is_dir():
        raise FormatError(f"cannot write {path}: the folder {path.parent} does not exist; create it first")
