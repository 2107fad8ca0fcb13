"""What goes to stderr, and streams that are closed, full or cannot show a name."""

from __future__ import annotations

import contextlib
import io
import os
import re
import sys
from collections.abc import Iterable
from typing import TextIO

import click

from meshdeform_core.errors import CaseError


def tell(message: str) -> None:
    """Print a message on stderr; that nobody can read it changes nothing."""
    with contextlib.suppress(OSError, ValueError):
        click.echo(f"meshdeform: {message}", err=True)


class Warnings:
    """Prints every warning once on stderr, ``-q`` or not; with ``--strict`` they end the command."""

    def __init__(self, strict: bool = False):
        self._strict = strict
        self._told: set[str] = set()

    def tell(self, warnings: Iterable[str]) -> None:
        """Print those that are new.

        Raises
        ------
        CaseError
            With ``--strict``, when there is any.
        """
        # The levels of a series repeat a warning with other numbers.
        new = [text for text in dict.fromkeys(warnings) if _without_numbers(text) not in self._told]
        for text in new:
            tell(f"warning: {text}")
        self._told.update(map(_without_numbers, new))
        if self._strict and new:
            raise CaseError(f"{'a warning' if len(new) == 1 else f'{len(new)} warnings'} (see above) and --strict")


def _without_numbers(text: str) -> str:
    return re.sub(r"\d+(\.\d+)?(e[-+]?\d+)?", "#", text)


def open_streams() -> None:
    """Make stdin, stdout and stderr usable, whatever the caller closed.

    A file that is opened while descriptor 1 is closed would get its number, and everything printed would end in it.
    """
    for number, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        try:
            os.fstat(number)
        except OSError:
            # The lowest free number is the one that is missing.
            os.open(os.devnull, os.O_RDWR)
            setattr(sys, name, open(number, mode, encoding="utf-8", closefd=False))  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # File names are bytes and need not be UTF-8.
            stream.reconfigure(errors="surrogateescape")


def flush_output() -> str | None:
    """Write out what was printed; why that was impossible, or ``None``. What cannot be written is dropped."""
    try:
        sys.stdout.flush()
    except OSError as error:
        drop_output()
        return error.strerror or str(error)
    return None


def flush_messages() -> None:
    """Write out messages; what cannot be written is dropped."""
    try:
        sys.stderr.flush()
    except (OSError, ValueError):
        _send_nowhere(sys.stderr)


def drop_output() -> None:
    """Send what stdout still holds nowhere, or the interpreter complains about it on its way out."""
    _send_nowhere(sys.stdout)


def _send_nowhere(stream: TextIO) -> None:
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
