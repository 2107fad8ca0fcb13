"""Checks of what a case file holds: every value by its key, every key against those known."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from meshdeform_core.errors import CaseError
from meshdeform_core.expression import Expression, expression

Table = dict[str, Any]


def fail(where: str, message: str) -> CaseError:
    return CaseError(f"{where}: {message}")


def table_of(data: Table, key: str, prefix: str = "") -> Table:
    value = data.get(key, {})
    if not isinstance(value, dict):
        raise fail(f"{prefix}{key}", f"expected a table [{prefix}{key}], found {value!r}")
    return value


def check_keys(table: Table, known: Iterable[str], where: str) -> None:
    known = list(known)
    for key in table:
        if key not in known:
            hint = nearest(key, known) or f"; known are {', '.join(known)}"
            raise fail(where, f"unknown key {key!r}{hint}")


def nearest(word: Any, known: Iterable[str]) -> str:
    close = difflib.get_close_matches(str(word), list(known), 1)
    return f"; did you mean {close[0]!r}?" if close else ""


def three_of(value: Any, where: str) -> list[Any]:
    if not isinstance(value, list) or len(value) != 3:
        raise fail(where, f"expected three values, found {value!r}")
    return value


def file_of(value: Any, folder: Path, where: str) -> Path:
    if not isinstance(value, str) or not value or "\0" in value:
        raise fail(where, f"expected a file name, found {value!r}")
    return folder / value


def number_of(value: Any, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) < float("inf"):
        raise fail(where, f"expected a finite number, found {value!r}")
    return float(value)


def formula_of(value: Any, known: Iterable[str], where: str) -> Expression:
    try:
        return expression(value, known)
    except CaseError as error:
        raise fail(where, str(error)) from None
