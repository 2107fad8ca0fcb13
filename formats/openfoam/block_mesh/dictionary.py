"""OpenFOAM dictionaries: comments, nested lists and dictionaries, and macros (``$name``).

A dictionary is data here: directives that compute (``#calc``) or read other files (``#include``) are refused.
Source: the OpenFOAM user guide, "Basic input/output file format".
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn

from meshdeform_core.errors import FormatError

from ...files import read_head, require_regular

_LARGEST_FILE = 64 * 2**20
_DEEPEST = 50
# Bounds the memory of nested macros.
_MOST_ITEMS = 5_000_000
_MOST_ENTRIES = 100_000

_TOKEN = re.compile(
    r"""(?P<blank>\s+|//[^\n]*|/\*.*?\*/)
    |(?P<open>/\*)
    |(?P<verbatim>\#\{.*?\#\})
    |(?P<text>"(?:\\.|[^"\\])*")
    |(?P<mark>[(){};\[\]])
    |(?P<word>\$\{[^{}\s]*\}|[^\s(){};\[\]"]+)
    """,
    re.VERBOSE | re.DOTALL,
)


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
    entries: dict[str, tuple[Item, ...] | Dictionary] = field(default_factory=dict)
    lines: dict[str, int] = field(default_factory=dict)

    def place(self, key: str) -> str:
        """File and line of a key, for messages."""
        return f"{self.path}, line {self.lines.get(key, self.line)}"


Item = Atom | Items | Dictionary


_CLASS = re.compile(rb"FoamFile\s*\{[^}]*?\bclass\s+(\w+)\s*;[^}]*\}")


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


class _Parser:
    """A recursive descent parser with one token of lookahead."""

    def __init__(self, text: str, path: Path):
        self._path = path
        self._tokens = self._scan(text)
        self._next = next(self._tokens, None)
        self._line, self._depth, self._items, self._entries = 1, 0, 0, 0

    def run(self) -> Dictionary:
        top = Dictionary(self._path, 1)
        while self._next is not None:
            self._entry(top)
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

    def _peek(self) -> str:
        return self._next.text if self._next else ""

    def _entry(self, scope: Dictionary) -> None:
        key = self._take()
        if key.text in "(){};[]":
            if key.text != ";":
                self._fail(f"found {key.text}, expected a keyword")
            return
        if key.text.startswith("#"):
            self._directive(key)
            return
        if key.text.startswith("$"):
            self._merge(scope, key)
            return
        self._count(entries=1)
        if self._peek() == "{":
            value: tuple[Item, ...] | Dictionary = self._dictionary(scope, self._take())
        else:
            value = self._values(scope, ";")
        scope.entries[_plain(key.text)] = value
        scope.lines[_plain(key.text)] = key.line

    def _directive(self, token: Atom) -> None:
        if token.text == "#inputMode":
            self._take()
            return
        self._fail(
            f"{token.text} is not evaluated here: dictionaries are read as data. Write the values themselves, for "
            f"example with `foamDictionary -expand {self._path.name}`",
            token.line,
        )

    def _merge(self, scope: Dictionary, token: Atom) -> None:
        """``$name;`` on its own adds the entries of another dictionary."""
        found = self._lookup(scope, token)
        if not isinstance(found, Dictionary):
            self._fail(f"{token.text} is not a dictionary, expected a keyword")
        self._count(entries=len(found.entries))
        scope.entries |= found.entries
        scope.lines |= found.lines

    def _dictionary(self, outer: Dictionary, brace: Atom) -> Dictionary:
        inner = Dictionary(self._path, brace.line, outer)
        self._enter()
        while self._peek() != "}":
            self._entry(inner)
        self._take()
        self._depth -= 1
        return inner

    def _values(self, scope: Dictionary, end: str) -> tuple[Item, ...]:
        """Items up to ``end``, which is taken too."""
        values: list[Item] = []
        self._enter()
        while self._peek() != end:
            self._value(scope, values, self._take())
        self._take()
        self._depth -= 1
        return tuple(values)

    def _value(self, scope: Dictionary, values: list[Item], token: Atom) -> None:
        if token.text in ("(", "["):
            values.append(Items(self._values(scope, ")" if token.text == "(" else "]"), token.line))
        elif token.text == "{":
            values.append(self._dictionary(scope, token))
        elif token.text in (")", "]", "}", ";"):
            self._fail(f"found {token.text} where a value or the end of a list is expected", token.line)
        elif token.text.startswith("#"):
            self._directive(token)
        elif token.text.startswith("$"):
            found = self._lookup(scope, token)
            self._count(items=len(found) if isinstance(found, tuple) else 1)
            values.extend(found if isinstance(found, tuple) else (found,))
        else:
            values.append(token)
        self._count(items=1)

    def _lookup(self, scope: Dictionary, token: Atom) -> tuple[Item, ...] | Dictionary:
        """The value of a macro: in this dictionary or those around it, ``$:name`` in the outermost, ``$a.b`` inside."""
        name = token.text[2:-1] if token.text.startswith("${") else token.text[1:]
        place: Dictionary | None = scope
        while name.startswith((":", "!")):
            name = name[1:]
            while place is not None and place.outer is not None:
                place = place.outer
        if name.startswith("."):
            # $.x is in this dictionary, $..x in the one around it.
            for _ in range(len(name) - len(name.lstrip(".")) - 1):
                place = place.outer if place is not None else None
            name = name.lstrip(".")
        while place is not None:
            found = _within(place, name)
            if found is not None:
                return found
            place = place.outer
        return self._fail(f"{token.text} refers to an entry that does not exist before it", token.line)

    def _enter(self) -> None:
        self._depth += 1
        if self._depth > _DEEPEST:
            self._fail(f"lists and dictionaries are nested more than {_DEEPEST} deep")

    def _count(self, items: int = 0, entries: int = 0) -> None:
        self._items += items
        self._entries += entries
        if self._items > _MOST_ITEMS or self._entries > _MOST_ENTRIES:
            self._fail("the dictionary has more values than any blockMeshDict")


def _within(place: Dictionary, name: str) -> tuple[Item, ...] | Dictionary | None:
    """An entry by its name or by a path of names."""
    if name in place.entries:
        return place.entries[name]
    for part in re.split(r"[./]", name):
        found = place.entries.get(part)
        if not isinstance(found, Dictionary):
            return found if found is not None and name.endswith(part) and part != name else None
        place = found
    return place


def _plain(text: str) -> str:
    return text[1:-1] if text.startswith('"') else text
