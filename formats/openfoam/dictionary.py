"""OpenFOAM dictionaries: comments, nested lists and dictionaries, macros (``$name``), and typed access to the values.

A dictionary is data here: directives that compute (``#calc``) or read other files (``#include``) are refused.
Source: the OpenFOAM user guide, "Basic input/output file format".
"""

from __future__ import annotations

import math
import re
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn, TypeVar

from meshdeform_core.errors import FormatError

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


@dataclass(frozen=True)
class Atom:
    """A word, number or text in quotes, as written."""

    text: str
    line: int

    @property
    def number(self) -> float | None:
        """The finite number that it spells, or ``None``."""
        try:
            value = float(self.text)
        except ValueError:
            return None
        # Python also reads 1_000, inf and nan.
        return value if math.isfinite(value) and "_" not in self.text else None


@dataclass(frozen=True)
class Items:
    """A list in parentheses, or the items up to the end of an entry."""

    values: tuple[Item, ...]
    line: int


@dataclass
class Dictionary:
    """Entries by key."""

    path: Path
    line: int
    outer: Dictionary | None = None
    entries: dict[str, Items | Dictionary] = field(default_factory=dict)

    def place(self, key: str) -> str:
        """File and line of an entry, for messages."""
        return f"{self.path}, line {self.entries[key].line}"

    def put(self, key: str, value: Items | Dictionary) -> None:
        """Add an entry; a later one replaces an earlier one, unless both are dictionaries, which are merged."""
        known = self.entries.get(key)
        if isinstance(known, Dictionary) and isinstance(value, Dictionary):
            for inner, one in value.entries.items():
                known.put(inner, one)
        else:
            self.entries[key] = value

    def reading(self, key: str) -> Reading:
        """A cursor over the items of an entry; over none if it does not exist."""
        value = self.entries.get(key, Items((), self.line))
        return Reading(self.path, Items((value,), value.line) if isinstance(value, Dictionary) else value)

    def list(self, key: str) -> Reading:
        """The list of an entry; empty if it does not exist."""
        found = self.reading(key)
        return found.list(f"the list of {key}") if found.more else found

    def text(self, key: str, default: str = "") -> str:
        """The word of an entry."""
        found = self.reading(key)
        return found.word(f"a word for {key}") if found.more else default


Item = Atom | Items | Dictionary
_Some = TypeVar("_Some", Atom, Items, Dictionary)
_TITLES = {Items: "a list", Dictionary: "a dictionary", type(None): "the end of the list"}


def read_dictionary(path: Path) -> Dictionary:
    """Read a dictionary file."""
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


def written(item: Item) -> str:
    """An item as it is written in a dictionary."""
    if isinstance(item, Atom):
        return item.text
    if isinstance(item, Items):
        return f"({' '.join(written(value) for value in item.values)})"
    return "{ " + "".join(written_entry(key, value) + " " for key, value in item.entries.items()) + "}"


def written_entry(key: str, value: Items | Dictionary) -> str:
    """An entry as it is written in a dictionary."""
    return f"{key} {written(value)}" if isinstance(value, Dictionary) else f"{key} {written(value)[1:-1]};"


class _Parser:
    """A recursive descent parser with one token of lookahead.

    ``scope`` is the dictionary in which macros are looked up: within a list, also in the dictionaries of its items, the
    one that has the list as an entry.
    """

    def __init__(self, text: str, path: Path):
        self._path = path
        self._tokens = self._scan(text)
        self._next = next(self._tokens, None)
        self._line, self._depth, self._count = 1, 0, 0

    def run(self) -> Dictionary:
        top = Dictionary(self._path, 1)
        while self._next is not None:
            self._read_entry(top, top)
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

    def _token(self) -> Atom:
        token = self._next
        if token is None:
            raise FormatError(f"{self._path} ends within an entry or a list; a ; ) or }} is missing")
        self._line = token.line
        self._next = next(self._tokens, None)
        return token

    def _fail(self, message: str) -> NoReturn:
        raise FormatError(f"{self._path}, line {self._line}: {message}")

    def _until(self, end: str) -> Iterator[None]:
        """Once for each value or entry before the token ``end``, which is taken, too."""
        self._depth += 1
        if self._depth > _DEEPEST:
            self._fail(f"lists and dictionaries are nested more than {_DEEPEST} deep")
        while self._next is None or self._next.text != end:
            self._add(1)
            yield
        self._token()
        self._depth -= 1

    def _add(self, count: int) -> None:
        self._count += count
        if self._count > _MOST:
            self._fail("the dictionary has more values than any blockMeshDict")

    def _read_entry(self, home: Dictionary, scope: Dictionary) -> None:
        """Read an entry into ``home``, which is ``scope`` but in the items of a list."""
        key = self._token()
        if key.text in "(){};[]":
            if key.text != ";":
                self._fail(f"found {key.text}, expected a keyword")
        elif key.text == "#inputMode" and home is scope:
            mode = self._token().text
            if mode not in ("merge", "default"):
                self._fail(f"#inputMode {mode} is not supported; expected merge, as without it")
        elif key.text.startswith("#"):
            self._refuse_directive(key)
        elif key.text.startswith("$"):
            found = self._lookup(scope, key)
            if not isinstance(found, Dictionary):
                self._fail(f"{key.text} is not a dictionary, expected a keyword")
            self._add(len(found.entries))
            for name, value in found.entries.items():
                home.put(name, value)
        elif self._next is not None and self._next.text == "{":
            home.put(key.text.strip('"'), self._dictionary(scope, within_list=home is not scope))
        else:
            home.put(key.text.strip('"'), Items(self._values(scope, ";"), key.line))

    def _refuse_directive(self, token: Atom) -> NoReturn:
        self._fail(
            f"{token.text} is not evaluated here: dictionaries are read as data. Write the values themselves, for "
            f"example with `foamDictionary -expand {self._path.name}`"
        )

    def _dictionary(self, scope: Dictionary, within_list: bool) -> Dictionary:
        inner = Dictionary(self._path, self._token().line, scope)
        for _ in self._until("}"):
            self._read_entry(inner, scope if within_list else inner)
        return inner

    def _values(self, scope: Dictionary, end: str) -> tuple[Item, ...]:
        """Items up to ``end``, which is taken, too."""
        values: list[Item] = []
        for _ in self._until(end):
            if self._next is not None and self._next.text == "{":
                values.append(self._dictionary(scope, within_list=True))
                continue
            token = self._token()
            if token.text in ("(", "["):
                values.append(Items(self._values(scope, ")" if token.text == "(" else "]"), token.line))
            elif token.text in (")", "]", "}", ";"):
                self._fail(f"found {token.text} where a value or the end of a list is expected")
            elif token.text.startswith("#"):
                self._refuse_directive(token)
            elif token.text.startswith("$"):
                found = self._lookup(scope, token)
                more = found.values if isinstance(found, Items) else (found,)
                self._add(len(more))
                values.extend(more)
            else:
                values.append(token)
        return tuple(values)

    def _lookup(self, scope: Dictionary, token: Atom) -> Items | Dictionary:
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
        *path, last = re.split(r"[./]", name)
        while place is not None:
            if name in place.entries:
                return place.entries[name]
            inner: Items | Dictionary | None = place
            for part in path:
                inner = inner.entries.get(part) if isinstance(inner, Dictionary) else None
            if isinstance(inner, Dictionary) and last in inner.entries:
                return inner.entries[last]
            place = place.outer
        return self._fail(f"{token.text} refers to an entry that does not exist before it")


class Reading:
    """Items to be taken one after another, with messages that name file and line."""

    def __init__(self, path: Path, items: Items):
        self._path, self._left, self._line = path, deque(items.values), items.line

    def __len__(self) -> int:
        return len(self._left)

    @property
    def more(self) -> bool:
        return len(self._left) > 0

    @property
    def _next(self) -> Item | None:
        return self._left[0] if self._left else None

    @property
    def line(self) -> int:
        """Line of the next item, or of the last one."""
        return self._left[0].line if self._left else self._line

    def fail(self, message: str) -> NoReturn:
        raise FormatError(f"{self._path}, line {self.line}: {message}")

    def _expected(self, expected: str) -> NoReturn:
        """Say what is found where something else is ``expected``."""
        item = self._next
        self.fail(f"expected {expected}, found {repr(item.text) if isinstance(item, Atom) else _TITLES[type(item)]}")

    def _take(self, kind: type[_Some], expected: str) -> _Some:
        item = self._next
        if not isinstance(item, kind):
            self._expected(expected)
        self._line = item.line
        self._left.popleft()
        return item

    def word(self, expected: str) -> str:
        return self._take(Atom, expected).text.strip('"')

    def next_word(self) -> str | None:
        """Take the next item if it is a word and not a number."""
        return self.word("") if isinstance(self._next, Atom) and self._next.number is None else None

    def next_number(self) -> float | None:
        """Take the next item if it is a number."""
        number = self._next.number if isinstance(self._next, Atom) else None
        return None if number is None else self._take(Atom, "").number

    def number(self, expected: str) -> float:
        value = self.next_number()
        if value is None:
            self._expected(expected)
        return value

    def whole(self, expected: str) -> int:
        value = self.number(expected)
        if value != int(value):
            self.fail(f"expected {expected}, found {value:g}")
        return int(value)

    def list(self, expected: str) -> Reading:
        if len(self._left) > 1 and isinstance(self._left[1], Items):
            # OpenFOAM itself writes the length in front of a list.
            self.next_number()
        return Reading(self._path, self._take(Items, f"{expected} in parentheses"))

    def dictionary(self, expected: str) -> Dictionary:
        return self._take(Dictionary, f"{expected} in braces")

    def point(self, expected: str) -> tuple[float, float, float]:
        values = self.list(expected)
        x, y, z = (values.number(f"three coordinates of {expected}") for _ in range(3))
        if values.more:
            values.fail(f"{expected} has more than three coordinates")
        return x, y, z
