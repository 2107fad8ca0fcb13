"""Whole files or none: every output is written beside its target and renamed when complete. And how files begin."""

from __future__ import annotations

import os
import re
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from meshdeform_core import interruption
from meshdeform_core.errors import FormatError


@contextmanager
def replacing(target: Path) -> Iterator[Path]:
    """Yield a temporary path beside ``target``; rename it over ``target`` if the block succeeds, delete it if not.

    Raises
    ------
    FormatError
        When the folder is missing or not writable, or the disk is full; ``target`` is then as it was.
    """
    target = Path(target)
    folder = target.parent
    if not folder.is_dir():
        raise FormatError(f"cannot write {target}: the folder {folder} does not exist; create it first")
    if target.is_dir():
        raise FormatError(f"cannot write {target}: it is a folder; give a file name")
    # The suffix is kept: some writers choose the format by it.
    partial = folder / f".{target.stem}.{os.getpid()}-{secrets.token_hex(4)}.partial{target.suffix}"
    with interruption.cleaned_up(lambda: partial.unlink(missing_ok=True)):
        try:
            yield partial
            interruption.check()
            os.replace(partial, target)
        except OSError as error:
            raise FormatError(f"cannot write {target}: {error.strerror or error}") from error


def remove_partial(folder: Path) -> None:
    """Remove what killed programs were writing into ``folder``: the temporary paths of :func:`replacing`."""
    for left in folder.glob(".*.partial*"):
        if not re.fullmatch(r"\..+\.\d+-[0-9a-f]{8}\.partial(\..+)?", left.name):
            continue
        if left.is_dir():
            shutil.rmtree(left)
        else:
            left.unlink()


def read_head(path: Path) -> bytes:
    """The first kilobyte of a file, by which formats are told apart.

    Raises
    ------
    FormatError
        When the file cannot be read or is empty.
    """
    try:
        with path.open("rb") as stream:
            head = stream.read(1024)
    except OSError as error:
        raise FormatError(f"cannot read {path}: {error.strerror or error}") from error
    if not head:
        raise FormatError(f"{path} is empty")
    return head
