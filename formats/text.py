"""Text that several formats and the command line write: JSON, exact numbers, rows of numbers, distinct names."""

from __future__ import annotations

import io
import json
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from numpy.typing import NDArray

_ROWS_AT_ONCE = 20_000
_LONG = 100
"""Longer lists are written by the json library's compiled encoder, which does not indent."""


def json_text(record: Mapping[str, Any], allow_nan: bool = True) -> str:
    """``record`` as JSON text, indented by two.

    Raises ValueError for NaN and infinite numbers, which JSON lacks, unless ``allow_nan``.
    """
    rows = []
    for key, value in record.items():
        if isinstance(value, list) and len(value) > _LONG:
            entries = ",\n    ".join(json.dumps(entry, allow_nan=allow_nan) for entry in value)
            text = f"[\n    {entries}\n  ]"
        else:
            # Text never contains a line break of its own: it is escaped.
            text = json.dumps(value, indent=2, allow_nan=allow_nan).replace("\n", "\n  ")
        rows.append(f"  {json.dumps(key)}: {text}")
    return "{\n" + ",\n".join(rows) + "\n}" if rows else "{}"


def number_lines(values: NDArray[Any]) -> memoryview:
    """The values one per line, each with the fewest digits that represent it exactly in its own type.

    scipy's Matrix Market writer does this several times faster than ``repr``. ``values`` are real, or integers of 32 or
    64 bits; at least one.
    """
    from scipy.io import mmwrite  # takes longer to import than most files to write

    text = io.BytesIO()
    mmwrite(text, values.reshape(-1, 1), symmetry="general")
    sizes = b"\n%d 1\n" % values.size
    buffer = text.getbuffer()
    return buffer[bytes(buffer[:1000]).index(sizes) + len(sizes) :]


@contextmanager
def strict_numbers() -> Iterator[None]:
    """numpy's readers of text raise ValueError at what is not a number; before 2.3 they warn and stop there."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)
        try:
            yield
        except DeprecationWarning as error:
            raise ValueError(str(error)) from error


def text_rows(rows: NDArray[Any], line: str) -> Iterator[bytes]:
    """Rows (n, m) in pieces of text, each row by the ``%`` pattern ``line``."""
    for begin in range(0, len(rows), _ROWS_AT_ONCE):
        part = rows[begin : begin + _ROWS_AT_ONCE]
        yield (line * len(part) % tuple(part.ravel().tolist())).encode()


def distinct(names: Iterable[str], taken: Iterable[str] = (), longest: int = 1 << 20) -> tuple[str, ...]:
    """The names, cut to ``longest`` bytes, with a number where they repeat each other or ``taken`` ones: a, a_2, ..."""

    def cut(name: str, length: int) -> str:
        return name.encode()[:length].decode(errors="ignore")

    used, counts, found = set(taken), dict[str, int](), list[str]()
    for name in names:
        unique, count = cut(name, longest), counts.get(name, 1)
        while unique in used:
            count += 1
            unique = f"{cut(name, longest - len(str(count)) - 1)}_{count}"
        counts[name] = count
        used.add(unique)
        found.append(unique)
    return tuple(found)
