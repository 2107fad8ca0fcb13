"""Typed access to the values of an OpenFOAM dictionary, with messages that name file and line."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NoReturn

from meshdeform_core.errors import FormatError

from .dictionary import Atom, Dictionary, Item, Items


class Reading:
    """A cursor over the items of a list."""

    def __init__(self, dictionary: Dictionary, items: Sequence[Item], line: int):
        self._dictionary, self._items, self._at, self._line = dictionary, items, 0, line

    def __len__(self) -> int:
        return len(self._items)

    @property
    def more(self) -> bool:
        return self._at < len(self._items)

    @property
    def line(self) -> int:
        """Line of the next item, or of the last one."""
        return getattr(self._items[self._at], "line", self._line) if self.more else self._line

    def fail(self, message: str) -> NoReturn:
        raise FormatError(f"{self._dictionary.path}, line {self.line}: {message}")

    def take(self, expected: str) -> Item:
        if not self.more:
            self.fail(f"the list ends, expected {expected}")
        item = self._items[self._at]
        self._line = self.line
        self._at += 1
        return item

    def word(self, expected: str) -> str:
        item = self.take(expected)
        if not isinstance(item, Atom):
            self._at -= 1
            self.fail(f"expected {expected}, found {describe(item)}")
        return item.text.strip('"')

    def next_word(self) -> str | None:
        """Take the next item if it is a word and not a number."""
        item = self._items[self._at] if self.more else None
        if not isinstance(item, Atom) or number_in(item.text) is not None:
            return None
        self._at += 1
        return item.text.strip('"')

    def next_number(self) -> float | None:
        """Take the next item if it is a number."""
        item = self._items[self._at] if self.more else None
        value = number_in(item.text) if isinstance(item, Atom) else None
        self._at += value is not None
        return value

    def number(self, expected: str) -> float:
        value = self.next_number()
        if value is None:
            found = describe(self._items[self._at]) if self.more else "the end of the list"
            self.fail(f"expected {expected}, found {found}")
        return value

    def whole(self, expected: str) -> int:
        value = self.number(expected)
        if value != int(value):
            self.fail(f"expected {expected}, found {value:g}")
        return int(value)

    def list(self, expected: str) -> Reading:
        item = self.take(expected)
        if isinstance(item, Atom) and number_in(item.text) is not None and self.more:
            # OpenFOAM itself writes the length in front of a list.
            item = self.take(expected)
        if not isinstance(item, Items):
            self._at -= 1
            self.fail(f"expected {expected} in parentheses, found {describe(item)}")
        return Reading(self._dictionary, item.values, item.line)

    def dictionary(self, expected: str) -> Dictionary:
        item = self.take(expected)
        if not isinstance(item, Dictionary):
            self._at -= 1
            self.fail(f"expected {expected} in braces, found {describe(item)}")
        return item

    def point(self, expected: str) -> tuple[float, float, float]:
        values = self.list(expected)
        x, y, z = (values.number(f"three coordinates of {expected}") for _ in range(3))
        if values.more:
            values.fail(f"{expected} has more than three coordinates")
        return x, y, z


def number_in(text: str) -> float | None:
    """The finite number that a word spells, or ``None``."""
    try:
        value = float(text)
    except ValueError:
        return None
    # Python also reads 1_000, inf and nan.
    return value if math.isfinite(value) and "_" not in text else None


def describe(item: Item) -> str:
    """An entry in words, for messages on what was found in its place."""
    if isinstance(item, Atom):
        return repr(item.text)
    return "a list" if isinstance(item, Items) else "a dictionary"


def reading_of(dictionary: Dictionary, key: str) -> Reading:
    """A cursor over the items of an entry; over none if it does not exist."""
    value = dictionary.entries.get(key, ())
    items = (value,) if isinstance(value, Dictionary) else value
    return Reading(dictionary, items, dictionary.lines.get(key, dictionary.line))


def list_of(dictionary: Dictionary, key: str) -> Reading:
    """The list of an entry; empty if it does not exist."""
    found = reading_of(dictionary, key)
    return found.list(f"the list of {key}") if found.more else found


def text_of(dictionary: Dictionary, key: str, default: str = "") -> str:
    """The word of an entry."""
    found = reading_of(dictionary, key)
    return found.word(f"a word for {key}") if found.more else default
