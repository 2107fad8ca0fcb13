"""OpenFOAM dictionaries: comments, nested lists and dictionaries, macros (``$name``), and typed access to the values.

A dictionary is data here: directives that compute (``#calc``) or read other files (``#include``) are refused.
Source: the OpenFOAM user guide, "Basic input/output file format".
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn

from meshdeform_core.errors import FormatError, suggestion

from ..files import read_head, require_regular

_LARGEST_FILE = 64 * 2**20
_DEEPEST = 50
_MOST = 5_000_000
"""Values and entries, which bounds the memory of nested macros."""

_TOKEN = re.compile(
    r"""(?P<blank>\s+|//[^\n]*|/\*.*?\*/)
    |(?P<open>/\*)
    |(?P<verbatim>\#\{.*?\#\})
    |(?P<text>"(?:\\.|[^"\\])*")
    |(?P<mark>[(){};\[\]])
    |(?P<word>\$\{[^{}\s]*\}|(?:(?!//|/\*)[^\s(){};\[\]"])+)
    """,
    re.VERBOSE | re.DOTALL,
)
_CLASS = re.compile(rb"FoamFile\s*\{[^}]*?\bclass\s+(\w+)\s*;[^}]*\}")
_MODES = ("merge", "overwrite", "protect")


@dataclass(frozen=True)
class Atom:
    """A word, number or text in quotes, as written."""

    text: str
    line: int


@dataclass(frozen=True)
class Items:
    """A list in parentheses."""

    values: tuple[Item, ...]
    line: int


@dataclass
class Dictionary:
    """Entries by key; the value of a key is a sequence of items, or a dictionary."""

    path: Path
    line: int
    outer: Dictionary | None = None
    entries: dict[str, Value] = field(default_factory=dict)
    lines: dict[str, int] = field(default_factory=dict)

    def place(self, key: str) -> str:
        """File and line of a key, for messages."""
        return f"{self.path}, line {self.lines.get(key, self.line)}"

    def put(self, key: str, value: Value, line: int, mode: str) -> None:
        """Add an entry; where there is one, ``mode`` decides as OpenFOAM's ``#inputMode`` does."""
        known = self.entries.get(key)
        if known is not None and mode == "protect":
            return
        if isinstance(known, Dictionary) and isinstance(value, Dictionary) and mode == "merge":
            for inner, one in value.entries.items():
                known.put(inner, one, value.lines[inner], mode)
            return
        self.entries[key], self.lines[key] = value, line

    def reading(self, key: str) -> Reading:
        """A cursor over the items of an entry; over none if it does not exist."""
        value = self.entries.get(key, ())
        items = (value,) if isinstance(value, Dictionary) else value
        return Reading(self.path, items, self.lines.get(key, self.line))

    def list(self, key: str) -> Reading:
        """The list of an entry; empty if it does not exist."""
        found = self.reading(key)
        return found.list(f"the list of {key}") if found.more else found

    def text(self, key: str, default: str = "") -> str:
        """The word of an entry."""
        found = self.reading(key)
        return found.word(f"a word for {key}") if found.more else default


Item = Atom | Items | Dictionary
Value = tuple[Item, ...] | Dictionary


def read_dictionary(path: Path) -> Dictionary:
    """Read a dictionary file.

    Raises
    ------
    FormatError
        With file and line, for faults of syntax, unknown macros, and directives.
    """
    require_regular(path)
    header = _CLASS.search(read_head(path))
    if header and header[1] != b"dictionary":
        kind = header[1].decode("ascii", "replace")
        raise FormatError(
            f"{path} is an OpenFOAM file of class {kind}; expected a blockMeshDict, or the folder of a case that has "
            "one"
        )
    if path.stat().st_size > _LARGEST_FILE:
        raise FormatError(f"{path} is larger than any OpenFOAM dictionary ({_LARGEST_FILE >> 20} MiB)")
    return parse_dictionary(path.read_bytes().decode("utf-8", "replace"), path)


def parse_dictionary(text: str, path: Path) -> Dictionary:
    """The content of a dictionary file; ``path`` is for messages."""
    return _Parser(text, path).run()


def item_text(item: Item | Value) -> str:
    """An item, or the value of an entry, as it is written in a dictionary."""
    if isinstance(item, Atom):
        return item.text
    if isinstance(item, Dictionary):
        return "{ " + "".join(entry_text(key, value) + " " for key, value in item.entries.items()) + "}"
    values = item.values if isinstance(item, Items) else item
    text = " ".join(item_text(value) for value in values)
    return f"({text})" if isinstance(item, Items) else text


def entry_text(key: str, value: Value) -> str:
    """An entry as it is written in a dictionary."""
    return f"{key} {item_text(value)}" + ("" if isinstance(value, Dictionary) else ";")


class _Parser:
    """A recursive descent parser with one token of lookahead.

    ``scope`` is the dictionary in which macros are looked up: within a list, also in the dictionaries of its items, the
    one that has the list as an entry.
    """

    def __init__(self, text: str, path: Path):
        self._path = path
        self._tokens = self._scan(text)
        self._next = next(self._tokens, None)
        self._line, self._depth, self._count, self._mode = 1, 0, 0, _MODES[0]

    def run(self) -> Dictionary:
        top = Dictionary(self._path, 1)
        while self._next is not None:
            self._entry(top, top)
        return top

    def _scan(self, text: str) -> Iterator[Atom]:
        at, line = 0, 1
        while at < len(text):
            found = _TOKEN.match(text, at)
            if found is None or found.lastgroup == "open":
                what = "a comment" if found else "a text in quotes"
                raise FormatError(f"{self._path}, line {line}: {what} begins here and does not end")
            if found.lastgroup != "blank":
                yield Atom(found[0], line)
            line += found[0].count("\n")
            at = found.end()

    def _take(self) -> Atom:
        token = self._next
        if token is None:
            raise FormatError(f"{self._path} ends within an entry or a list; a ; ) or }} is missing")
        self._line = token.line
        self._next = next(self._tokens, None)
        return token

    def _fail(self, message: str, line: int | None = None) -> NoReturn:
        raise FormatError(f"{self._path}, line {line or self._line}: {message}")

    def _until(self, end: str) -> Iterator[None]:
        """Once for each value or entry before the token ``end``, which is taken, too."""
        self._depth += 1
        if self._depth > _DEEPEST:
            self._fail(f"lists and dictionaries are nested more than {_DEEPEST} deep")
        while self._next is None or self._next.text != end:
            yield
        self._take()
        self._depth -= 1

    def _add(self, count: int) -> None:
        self._count += count
        if self._count > _MOST:
            self._fail("the dictionary has more values than any blockMeshDict")

    def _entry(self, home: Dictionary, scope: Dictionary) -> None:
        """Read an entry into ``home``, which is ``scope`` but in the items of a list."""
        key = self._take()
        if key.text in "(){};[]":
            if key.text != ";":
                self._fail(f"found {key.text}, expected a keyword")
            return
        if key.text == "#inputMode" and home is scope:
            mode = self._take().text
            self._mode = _MODES[0] if mode == "default" else mode
            if self._mode not in _MODES:
                self._fail(f"#inputMode {mode} is not supported; expected {', '.join(_MODES)}")
            return
        if key.text.startswith("#"):
            self._refuse_directive(key)
        if key.text.startswith("$"):
            found = self._lookup(scope, key)
            if not isinstance(found, Dictionary):
                self._fail(f"{key.text} is not a dictionary, expected a keyword")
            self._add(len(found.entries))
            for name, value in found.entries.items():
                home.put(name, value, found.lines[name], self._mode)
            return
        self._add(1)
        value: Value
        if self._next is not None and self._next.text == "{":
            value = self._dictionary(self._take(), scope, within_list=home is not scope)
        else:
            value = self._values(scope, ";")
        home.put(key.text.strip('"'), value, key.line, self._mode)

    def _refuse_directive(self, token: Atom) -> NoReturn:
        self._fail(
            f"{token.text} is not evaluated here: dictionaries are read as data. Write the values themselves, for "
            f"example with `foamDictionary -expand {self._path.name}`",
            token.line,
        )

    def _dictionary(self, brace: Atom, scope: Dictionary, within_list: bool) -> Dictionary:
        inner = Dictionary(self._path, brace.line, scope)
        for _ in self._until("}"):
            self._entry(inner, scope if within_list else inner)
        return inner

    def _values(self, scope: Dictionary, end: str) -> tuple[Item, ...]:
        """Items up to ``end``, which is taken, too."""
        values: list[Item] = []
        for _ in self._until(end):
            token = self._take()
            self._add(1)
            if token.text in ("(", "["):
                values.append(Items(self._values(scope, ")" if token.text == "(" else "]"), token.line))
            elif token.text == "{":
                values.append(self._dictionary(token, scope, within_list=True))
            elif token.text in (")", "]", "}", ";"):
                self._fail(f"found {token.text} where a value or the end of a list is expected", token.line)
            elif token.text.startswith("#"):
                self._refuse_directive(token)
            elif token.text.startswith("$"):
                found = self._lookup(scope, token)
                more = found if isinstance(found, tuple) else (found,)
                self._add(len(more))
                values.extend(more)
            else:
                values.append(token)
        return tuple(values)

    def _lookup(self, scope: Dictionary, token: Atom) -> Value:
        """The value of a macro: in this dictionary or those around it, ``$:name`` in the outermost, ``$a.b`` inside."""
        name = token.text[2:-1] if token.text.startswith("${") else token.text[1:]
        place: Dictionary | None = scope
        if name.startswith((":", "!")):
            name = name.lstrip(":!")
            while place is not None and place.outer is not None:
                place = place.outer
        # $.x is in this dictionary, $..x in the one around it.
        for _ in range(len(name) - len(name.lstrip(".")) - 1):
            place = place.outer if place is not None else None
        name = name.lstrip(".")
        while place is not None:
            found = _at(place, name)
            if found is not None:
                return found
            place = place.outer
        return self._fail(f"{token.text} refers to an entry that does not exist before it", token.line)


def _at(place: Dictionary, name: str) -> Value | None:
    """An entry by its name or by a path of names."""
    if name in place.entries:
        return place.entries[name]
    *path, last = re.split(r"[./]", name)
    for part in path:
        inner = place.entries.get(part)
        if not isinstance(inner, Dictionary):
            return None
        place = inner
    return place.entries.get(last)


class Reading:
    """A cursor over items, with messages that name file and line."""

    def __init__(self, path: Path, items: Sequence[Item], line: int):
        self._path, self._items, self._at, self._line = path, items, 0, line

    def __len__(self) -> int:
        return len(self._items)

    @property
    def more(self) -> bool:
        return self._at < len(self._items)

    @property
    def line(self) -> int:
        """Line of the next item, or of the last one."""
        return self._items[self._at].line if self.more else self._line

    def fail(self, message: str) -> NoReturn:
        raise FormatError(f"{self._path}, line {self.line}: {message}")

    def _refuse(self, expected: str) -> NoReturn:
        """Say what is found in the place of what is ``expected``."""
        item = self._items[self._at] if self.more else None
        found = "the end of the list" if item is None else repr(item.text) if isinstance(item, Atom) else (
            "a list" if isinstance(item, Items) else "a dictionary")  # fmt: skip
        self.fail(f"expected {expected}, found {found}")

    def _taken(self) -> None:
        self._line = self.line
        self._at += 1

    def next_word(self) -> str | None:
        """Take the next item if it is a word and not a number."""
        item = self._items[self._at] if self.more else None
        if not isinstance(item, Atom) or _number(item.text) is not None:
            return None
        self._taken()
        return item.text.strip('"')

    def next_number(self) -> float | None:
        """Take the next item if it is a number."""
        item = self._items[self._at] if self.more else None
        value = _number(item.text) if isinstance(item, Atom) else None
        if value is not None:
            self._taken()
        return value

    def word(self, expected: str) -> str:
        item = self._items[self._at] if self.more else None
        if not isinstance(item, Atom):
            self._refuse(expected)
        self._taken()
        return item.text.strip('"')

    def number(self, expected: str) -> float:
        value = self.next_number()
        if value is None:
            self._refuse(expected)
        return value

    def whole(self, expected: str) -> int:
        value = self.number(expected)
        if value != int(value):
            self.fail(f"expected {expected}, found {value:g}")
        return int(value)

    def list(self, expected: str) -> Reading:
        # OpenFOAM itself writes the length in front of a list.
        if self._at + 1 < len(self._items) and isinstance(self._items[self._at + 1], Items):
            self.next_number()
        item = self._items[self._at] if self.more else None
        if not isinstance(item, Items):
            self._refuse(f"{expected} in parentheses")
        self._taken()
        return Reading(self._path, item.values, item.line)

    def dictionary(self, expected: str) -> Dictionary:
        item = self._items[self._at] if self.more else None
        if not isinstance(item, Dictionary):
            self._refuse(f"{expected} in braces")
        self._taken()
        return item

    def point(self, expected: str) -> tuple[float, float, float]:
        values = self.list(expected)
        x, y, z = (values.number(f"three coordinates of {expected}") for _ in range(3))
        if values.more:
            values.fail(f"{expected} has more than three coordinates")
        return x, y, z

    def numbered(self, kind: str, names: dict[str, int], count: int) -> int:
        """Take the next item as the number of one of ``count`` things of this kind, or its name."""
        word = self.next_word()
        if word is not None:
            if word not in names:
                self.fail(f"there is no {kind} {word!r}{suggestion(word, names)}")
            return names[word]
        number = self.whole(f"the number of a {kind}")
        if not 0 <= number < count:
            self.fail(f"there is no {kind} {number}; the file has 0 to {count - 1}")
        return number


def _number(text: str) -> float | None:
    """The finite number that a word spells, or ``None``."""
    try:
        value = float(text)
    except ValueError:
        return None
    # Python also reads 1_000, inf and nan.
    return value if math.isfinite(value) and "_" not in text else None
