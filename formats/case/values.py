"""Checks of the values and keys of a case file.

``where`` names the location in messages; all functions raise ``CaseError`` with what was found and expected.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from meshdeform_core.boundary.motions.expression import Expression, expression
from meshdeform_core.errors import CaseError, suggestion
from meshdeform_core.wording import literal

Table = dict[str, Any]
_DEEPEST = 100


def fail(where: str, message: str) -> CaseError:
    """The error to raise for the content at ``where``."""
    return CaseError(f"{where}: {message}")


def plain(value: Any, depth: int = 0) -> Any:
    """Tables made in Python, converted to the types of TOML: dictionaries, lists, numbers, texts."""
    if depth > _DEEPEST:
        raise CaseError(f"its tables are nested more than {_DEEPEST} deep; expected a case like that of a case file")
    if isinstance(value, Mapping):
        return {key: plain(item, depth + 1) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item, depth + 1) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return str(value) if isinstance(value, Path) else value


def table_of(data: Table, key: str, prefix: str = "") -> Table:
    """The table of a key, empty if there is none; ``prefix`` is the dotted path of the enclosing tables."""
    value = data.get(key, {})
    if not isinstance(value, dict):
        raise fail(f"{prefix}{key}", f"expected a table [{prefix}{key}], found {literal(value)}")
    return value


def check_keys(table: Table, known: Iterable[str], where: str) -> None:
    """Refuse an unknown key, with the nearest known one."""
    known = list(known)
    for key in table:
        if key not in known:
            hint = suggestion(key, known) or f"; known are {', '.join(known)}"
            raise fail(where, f"unknown key {key!r}{hint}")


def three_of(value: Any, where: str) -> list[Any]:
    """A list of three values of any type."""
    if not isinstance(value, list) or len(value) != 3:
        raise fail(where, f"expected three values, found {literal(value)}")
    return value


def file_of(value: Any, folder: Path, where: str) -> Path:
    """A file name, relative to the folder of the case file."""
    if not isinstance(value, str) or not value or "\0" in value:
        raise fail(where, f"expected a file name, found {literal(value)}")
    return folder / value


def number_of(value: Any, where: str) -> float:
    """A finite number; booleans are refused."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) < float("inf"):
        raise fail(where, f"expected a finite number, found {literal(value)}")
    return float(value)


def formula_of(value: Any, known: Iterable[str], where: str) -> Expression:
    """A number or a formula of the names in ``known``."""
    try:
        return expression(value, known)
    except CaseError as error:
        raise fail(where, str(error)) from None
