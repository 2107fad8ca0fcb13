"""Wording of messages and reports: counts, lists, points, values; warnings and their kinds, by which repeated ones are
recognised."""

from __future__ import annotations

import datetime
import math
from collections.abc import Iterable
from typing import Any

_LISTED = 6


def counted(count: int, noun: str, plural: str = "") -> str:
    """A count with its noun: ``1 block``, ``2 blocks``."""
    return f"{count:,} {noun}" if count == 1 else f"{count:,} {plural or noun + 's'}"


def listed(texts: Iterable[str], separator: str = ", ", noun: str = "") -> str:
    """The first six texts and the number of further ones (of ``noun``): ``a, b, c, d, e, f and 3 more``."""
    all_texts = list(texts)
    rest = len(all_texts) - _LISTED
    return separator.join(all_texts[:_LISTED]) + (f" and {rest} more{noun and ' ' + noun}" if rest > 0 else "")


def vector(values: Iterable[float]) -> str:
    """``(0.3, 0, -1)``: a point or vector in a message."""
    return f"({', '.join(f'{value + 0.0:.10g}' for value in values)})"


def literal(value: Any) -> str:
    """A value in a message, as TOML writes it: ``true``, ``{ angle = 5 }``, ``1979-05-27 (a date)``."""
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{key} = {literal(item)}' for key, item in value.items())} }}" if value else "{}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(literal(item) for item in value)}]"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float) and math.isinf(value):
        return "infinity" if value > 0 else "-infinity"
    if isinstance(value, datetime.date | datetime.time):
        return f"{value.isoformat()} (a {'time' if isinstance(value, datetime.time) else 'date'})"
    return repr(value)


class Notice(str):
    """Text of a warning that may be repeated with other numbers, for example at every level of a series.

    ``kind`` names the finding and what it concerns (patches, blocks), without numbers; users see only the first warning
    of each kind. A plain string is its own kind.
    """

    __slots__ = ("kind",)
    kind: str

    def __new__(cls, text: str, kind: str) -> Notice:
        notice = super().__new__(cls, text)
        notice.kind = kind
        return notice

    def __getnewargs__(self) -> tuple[str, str]:  # type: ignore[override]
        return str(self), self.kind


def kind_of(warning: str) -> str:
    """The kind of a warning; of a plain string the text itself."""
    return warning.kind if isinstance(warning, Notice) else warning


def first_of_each_kind(warnings: Iterable[str], known: Iterable[str] = ()) -> list[str]:
    """The warnings whose kind is not in ``known``, the first one of each kind."""
    seen, new = set(known), []
    for warning in warnings:
        if kind_of(warning) not in seen:
            seen.add(kind_of(warning))
            new.append(warning)
    return new
