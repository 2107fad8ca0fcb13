"""Rows of numbers as text."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from numpy.typing import NDArray

_ROWS_AT_ONCE = 20_000


def text_rows(rows: NDArray[Any], line: str) -> Iterator[bytes]:
    """Rows (n, m) in pieces of text, each row by the ``%`` pattern ``line``."""
    for begin in range(0, len(rows), _ROWS_AT_ONCE):
        part = rows[begin : begin + _ROWS_AT_ONCE]
        yield (line * len(part) % tuple(part.ravel().tolist())).encode()
