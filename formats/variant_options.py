"""The options of a file variant, checked against those that the writer supports."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from meshdeform_core.errors import FormatError, suggestion


def checked_options(path: Path, options: Mapping[str, Any], known: Mapping[str, Sequence[str]]) -> dict[str, str]:
    """The options unchanged, each a known key with one of its values.

    Raises
    ------
    FormatError
        For anything else; the message names the nearest known key or value and all known ones.
    """
    for key, value in options.items():
        _require_known(path, "option", str(key), list(known))
        _require_known(path, f"{key} =", str(value), known[key])
    return {str(key): str(value) for key, value in options.items()}


def _require_known(path: Path, what: str, word: str, known: Sequence[str]) -> None:
    if word in known:
        return
    hint = suggestion(word, known)
    raise FormatError(f"cannot write {path}: unknown {what} {word!r}{hint}; known are: {' '.join(known) or 'none'}")
