"""Words of messages and reports."""

from __future__ import annotations

from collections.abc import Iterable


def counted(count: int, noun: str, plural: str = "") -> str:
    """A number of things: ``1 block``, ``2 blocks``."""
    return f"{count:,} {noun}" if count == 1 else f"{count:,} {plural or noun + 's'}"


def vector(values: Iterable[float], digits: int = 10) -> str:
    """``(0.3, 0, -1)``: a point or vector in a message."""
    return f"({', '.join(f'{value + 0.0:.{digits}g}' for value in values)})"
