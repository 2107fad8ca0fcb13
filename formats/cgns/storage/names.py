"""Valid names of CGNS nodes."""

from __future__ import annotations

from collections.abc import Iterable

from .tree import NAME_LENGTH


def unique_names(names: Iterable[str], otherwise: str, taken: Iterable[str] = ()) -> tuple[str, ...]:
    """The names without slashes, cut to 32 bytes, numbered where they repeat each other or ``taken`` ones.

    ``otherwise`` replaces empty names.
    """
    used, counts = set(taken), dict[str, int]()
    result = []
    for name in names:
        base = _cut(name.replace("/", "_").strip(), NAME_LENGTH).strip(". ") or otherwise
        unique, count = base, counts.get(base, 1)
        while unique in used:
            count += 1
            unique = f"{_cut(base, NAME_LENGTH - len(str(count)) - 1)}_{count}"
        counts[base] = count
        used.add(unique)
        result.append(unique)
    return tuple(result)


def _cut(text: str, length: int) -> str:
    return text.encode()[:length].decode(errors="ignore")
