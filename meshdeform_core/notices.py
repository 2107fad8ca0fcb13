"""Warnings and their kinds, by which repeated ones are recognised."""

from __future__ import annotations

from collections.abc import Iterable


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
