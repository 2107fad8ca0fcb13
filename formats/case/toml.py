"""The text of a case file, and overrides from the command line."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

from meshdeform_core.errors import CaseError, FormatError

from ..files import require_regular
from .forms import Table

_PART = r"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')"""
_DEEP_KEY = re.compile(rf"(?<![\w.-]){_PART}(?:[ \t]*+\.[ \t]*+{_PART}){{30}}")
"""Dotted keys with more parts than any key of a case: the parser's work and memory grow with their square."""
TABLES = ("grid", "constants", "boundary", "method", "repair")
"""The tables of a case."""
_TOO_LONG = "it has an integer of more than 64 bits; write large numbers like 1e30"


def load(path: Path | None) -> Table:
    """The tables of a case file; empty without a file. Raises CaseError when the file cannot be read or is not TOML."""
    if path is None:
        return {}
    try:
        require_regular(path, "the case file")
    except FormatError as error:
        raise CaseError(str(error)) from error
    try:
        # Some Windows editors begin files with a byte order mark.
        return _toml(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise CaseError(f"cannot read the case file {path}: {error.strerror or error}") from error
    except ValueError as error:
        raise CaseError(f"{path} is not a TOML file: {error}") from error


def _toml(text: str) -> Table:
    """Parse TOML; ``ValueError`` for anything else, including integers beyond 64 bits, which TOML excludes."""
    if deep := _DEEP_KEY.search(text):
        line = text.count("\n", 0, deep.start()) + 1
        raise ValueError(f"line {line}: the key {deep[0][:40]}... has more than 30 parts; expected a key of a case")
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        raise
    except RecursionError:
        raise ValueError("its brackets are nested too deeply") from None
    except ValueError:
        raise ValueError(_TOO_LONG) from None
    _require_64_bits(data)
    return data


def _require_64_bits(value: Any) -> None:
    if isinstance(value, (dict, list)):
        for item in value.values() if isinstance(value, dict) else value:
            _require_64_bits(item)
    elif isinstance(value, int) and not -(2**63) <= value < 2**63:
        raise ValueError(_TOO_LONG)


def parsed_override(text: str) -> tuple[list[str], Any]:
    """The names of KEY and the value of ``KEY=VALUE``; a value that is not TOML is taken as text.

    Raises CaseError when there is no ``=`` or no key.
    """
    key, equals, value = text.partition("=")
    if not equals or not key.strip():
        raise CaseError(f"--set {text!r}: expected KEY=VALUE, like method.idw.alpha=0.3")
    try:
        (parsed,) = _toml(f"value = {value}").values()
    except ValueError:
        parsed = _number_or_text(value.strip())
    return key.strip().split("."), parsed


def override(data: Table, text: str) -> None:
    """Set the value of ``KEY=VALUE`` in ``data``, in place.

    Raises CaseError when there is no ``=``, or the key passes through a value or refers to an entry that does not
    exist.
    """
    (*path, last), parsed = parsed_override(text)
    if not path and last not in TABLES and last in data.get("constants", {}):
        raise CaseError(f"--set {text!r}: unknown key {last!r}; did you mean 'constants.{last}'?")
    target: Any = data
    for name in path:
        target = target.setdefault(name, {}) if isinstance(target, dict) else _entry(target, name, text)
        if not isinstance(target, (dict, list)):
            raise CaseError(f"--set {text!r}: {name!r} is a value, not a table")
    if isinstance(target, list):
        raise CaseError(
            f"--set {text!r}: {'.'.join(path)} is a list; name an entry and its key, like "
            f'boundary.wing.kind="fixed", or give the list as a whole'
        )
    target[last] = parsed


def _number_or_text(value: str) -> float | str:
    """A number or text; ``.1`` and ``1.`` are numbers, although not in TOML."""
    return float(value) if re.fullmatch(r"[+-]?(\d+\.|\.\d+)(e[+-]?\d+)?", value, re.IGNORECASE) else value


def _entry(entries: list[Any], name: str, text: str) -> Any:
    for number, entry in enumerate(entries, 1):
        if isinstance(entry, dict) and (entry.get("name") == name or str(number) == name):
            return entry
    known = [str(e.get("name", n)) for n, e in enumerate(entries, 1) if isinstance(e, dict)]
    raise CaseError(f"--set {text!r}: no entry {name!r}; known are {', '.join(known) or 'none'}")
