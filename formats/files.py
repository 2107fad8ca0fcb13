"""Output files that are complete or absent: each is written next to its target and renamed when done; options."""

from __future__ import annotations

import contextlib
import hashlib
import os
import platform
import re
import secrets
import shutil
import stat
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from meshdeform_core import interruption
from meshdeform_core.errors import FormatError, suggestion
from meshdeform_core.parallel import Nodes

_HOST = hashlib.sha256(platform.node().encode()).hexdigest()[:4]
"""Four digits that identify this machine; process numbers are meaningless on others."""
LARGEST = 1e30
"""Of coordinates: the square of a larger length overflows in single precision, and no grid is so large in any unit."""


@contextmanager
def replacing(target: Path) -> Iterator[Path]:
    """Yield a temporary path next to ``target``; rename it over ``target`` if the block succeeds, else delete it.

    A symbolic link is kept; the file that it points to is replaced.

    Raises FormatError when the folder is missing or not writable, or the disk is full; ``target`` is then unchanged.
    """
    target = followed(Path(target))
    folder = target.parent
    if not folder.is_dir():
        raise FormatError(f"cannot write {target}: the folder {folder} does not exist; create it first")
    require_replaceable(target)
    partial = partial_path(target)
    with interruption.cleaned_up(lambda: partial.unlink(missing_ok=True)):
        try:
            yield partial
            interruption.check()
            os.replace(partial, target)
        except OSError as error:
            raise FormatError(f"cannot write {target}: {reason_of(error)}") from error


@contextmanager
def replacing_by_all(target: Path, points: Any) -> Iterator[Path]:
    """:func:`replacing` for a file that all ranks write which hold ``points`` in parts; the first one creates it and,
    if all succeed, renames it.

    An error in the block must be raised on all ranks.
    """
    ranks = Nodes.of(points).ranks
    with contextlib.ExitStack() as own:
        partial = ranks.on_first(lambda: own.enter_context(replacing(target)))
        try:
            yield partial
        except OSError as error:
            raise FormatError(f"cannot write {target}: {reason_of(error)}") from error
        ranks.on_first(own.close)


def partial_path(target: Path) -> Path:
    """A temporary path next to ``target``, whose remains of killed runs on this machine are removed."""
    with contextlib.suppress(OSError):
        remove_partial(target.parent, target)
    # The suffix is kept: some writers choose the format by it.
    return target.parent / f".{target.stem}.{os.getpid()}-{_HOST}{secrets.token_hex(2)}.partial{target.suffix}"


def require_replaceable(target: Path) -> None:
    """Refuse a target that exists and is not a regular file: a pipe would be replaced, not written to."""
    with contextlib.suppress(OSError, ValueError):
        if kind := _kind_of(target.stat().st_mode):
            raise FormatError(f"cannot write {target}: it is {kind}; give a file name")


def _kind_of(mode: int) -> str:
    """The kind of a path that is not a regular file, such as ``a folder``; empty for regular files."""
    if stat.S_ISDIR(mode):
        return "a folder"
    if stat.S_ISREG(mode):
        return ""
    return "a pipe" if stat.S_ISFIFO(mode) else "a socket" if stat.S_ISSOCK(mode) else "a device"


def followed(path: Path) -> Path:
    """The path itself or, for a symbolic link, its target, which need not exist."""
    return Path(os.path.realpath(path)) if path.is_symlink() else path


def invalid_path(output: Path) -> Path:
    """Path for a grid with invalid cells: next to ``output``, so that make does not take it for the output.

    An OpenFOAM case holds one mesh, so that an invalid one needs another folder.
    """
    if output.suffix.lower() == ".foam":
        folder = Path(os.path.abspath(output.parent))
        return folder.with_name(f"{folder.name}.invalid") / output.name
    return output.with_name(f"{output.stem}.invalid{output.suffix}")


def _runs(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        # It belongs to another user.
        return True
    return True


def remove_partial(folder: Path, target: Path | None = None) -> None:
    """Remove files that killed runs left in ``folder``: the temporary paths of :func:`replacing`, of ``target`` or all.

    Files of processes that still run on this machine are kept; processes of other machines cannot be checked: their
    files are kept where only those of one ``target`` are removed.
    """
    own = (re.escape(target.stem), re.escape(target.suffix)) if target else (".+", r"(?:\..+)?")
    pattern = re.compile(rf"\.{own[0]}\.(\d+)-([0-9a-f]{{4}})[0-9a-f]{{4}}\.partial{own[1]}")
    for path in folder.glob(".*.partial*"):
        found = pattern.fullmatch(path.name)
        if found is None or (_runs(int(found[1])) if found[2] == _HOST else target is not None):
            continue
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)


def reason_of(error: BaseException) -> str:
    """Reason why a file cannot be read or written: the system's text for its error number, else the error's own."""
    number = error.errno if isinstance(error, OSError) else None
    if number is not None:
        return os.strerror(number)
    return str(error).strip() or f"{type(error).__name__}, the file is damaged"


def require_regular(path: Path, what: str = "") -> None:
    """Refuse anything but a regular file before opening it: opening a pipe without a writer would block forever.

    ``what`` describes the file in messages, such as ``the case file``.
    """
    label = f"{what} {path}".lstrip()
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError) as error:
        raise FormatError(f"cannot read {label}: {reason_of(error)}") from error
    kind = _kind_of(mode)
    if kind:
        again = "" if stat.S_ISDIR(mode) else ", which is read more than once"
        raise FormatError(f"cannot read {label}: it is {kind}; expected a file{again}")


def shown(path: Path) -> str:
    """A path as text; bytes of its name that are not UTF-8 are replaced."""
    return os.fsencode(path).decode("utf-8", "replace")


def read_head(path: Path) -> bytes:
    """The first kilobyte of a file, by which formats are distinguished."""
    require_regular(path)
    try:
        with path.open("rb") as stream:
            head = stream.read(1024)
    except OSError as error:
        raise FormatError(f"cannot read {path}: {reason_of(error)}") from error
    if not head:
        raise FormatError(f"{path} is empty")
    return head


def checked_options(where: str, options: Mapping[str, Any], known: Mapping[str, Sequence[Any]]) -> dict[str, Any]:
    """The options, each a known key with one of its values, which may be given as text.

    Raises FormatError for anything else; the message begins with ``where`` and names the nearest known key or value and
    all known ones.
    """
    found = {}
    for key, value in options.items():
        words = {str(choice).lower(): choice for choice in known.get(key, ())}
        for what, word, names in (("option", str(key), list(known)), (f"{key} =", str(value).lower(), list(words))):
            if word not in names:
                hint = suggestion(word, names)
                raise FormatError(f"{where}: unknown {what} {word!r}{hint}; known are: {' '.join(names) or 'none'}")
        found[key] = words[str(value).lower()]
    return found
