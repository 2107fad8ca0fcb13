"""Messages on stderr, and streams that are closed, full or cannot encode a name."""

from __future__ import annotations

import contextlib
import io
import os
import sys
from collections.abc import Iterable
from typing import TextIO

import click

from meshdeform_core.errors import CaseError
from meshdeform_core.notices import first_of_each_kind, kind_of


def tell(message: str) -> None:
    """Print a message on stderr; failing to do so is ignored."""
    with contextlib.suppress(OSError, ValueError):
        click.echo(f"meshdeform: {message}", err=True)


class Warnings:
    """Prints the first warning of each kind on stderr, even with ``-q``; with ``--strict`` warnings end the command."""

    def __init__(self, strict: bool = False):
        self._strict = strict
        self._told: set[str] = set()

    def tell(self, warnings: Iterable[str]) -> None:
        """Print the warnings of kinds that have not been printed.

        Raises
        ------
        CaseError
            With ``--strict``, if there are any.
        """
        new = first_of_each_kind(warnings, self._told)
        for text in new:
            tell(f"warning: {text}")
        # Warnings read back from a report have no kind, so that their texts are remembered, too.
        self._told.update(*((kind_of(text), str(text)) for text in new))
        if self._strict and new:
            raise CaseError(f"{'a warning' if len(new) == 1 else f'{len(new)} warnings'} (see above) and --strict")


def open_streams() -> None:
    """Occupy the descriptors of stdin, stdout and stderr if the caller closed them.

    A file opened while descriptor 1 is closed would get this number and receive everything printed. Messages to a
    closed stderr are lost; writing to a closed stdout fails, as it does on a full disk.
    """
    for number, name, mode, access in (
        (0, "stdin", "r", os.O_RDWR),
        (1, "stdout", "w", os.O_RDONLY),
        (2, "stderr", "w", os.O_RDWR),
    ):
        try:
            os.fstat(number)
        except OSError:
            # The system assigns the lowest free number, which is the missing one.
            os.open(os.devnull, access)
            setattr(sys, name, open(number, mode, encoding="utf-8", closefd=False))  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # File names are bytes and need not be UTF-8.
            stream.reconfigure(errors="surrogateescape")


def flushed(stream: TextIO) -> str:
    """Flush stdout or stderr; returns the reason of a failure. Output that cannot be written is dropped."""
    try:
        stream.flush()
    except (OSError, ValueError) as error:
        drop(stream)
        return (isinstance(error, OSError) and error.strerror) or str(error)
    return ""


def drop(stream: TextIO) -> None:
    """Discard what a stream still buffers; otherwise the interpreter complains at exit."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
