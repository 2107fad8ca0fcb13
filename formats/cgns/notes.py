"""Remarks collected while reading: one line per kind, for any number of zones."""

from __future__ import annotations

_SHOWN = 4


class Notes:
    """Remarks for ``Grid.notes``; the same remark about several nodes becomes one line."""

    def __init__(self) -> None:
        # The places of each remark, in order and without repetition.
        self._places: dict[str, dict[str, None]] = {}

    def add(self, remark: str, place: str) -> None:
        self._places.setdefault(remark, {})[place] = None

    def lines(self) -> tuple[str, ...]:
        """One line per remark, e.g. ``rind planes are ...: zone 1, zone 2, and 7 more``."""
        return tuple(
            f"{remark}: {', '.join(list(places)[:_SHOWN])}"
            + (f" and {len(places) - _SHOWN} more" if len(places) > _SHOWN else "")
            for remark, places in self._places.items()
        )
