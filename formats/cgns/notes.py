"""Remarks collected while reading: one line per kind, for any number of zones."""

from __future__ import annotations

from meshdeform_core.wording import listed


class Notes:
    """Remarks for ``Grid.notes``; the same remark about several nodes becomes one line."""

    def __init__(self) -> None:
        # The places of each remark, in order and without repetition.
        self._places: dict[str, dict[str, None]] = {}

    def add(self, remark: str, place: str) -> None:
        self._places.setdefault(remark, {})[place] = None

    def lines(self) -> tuple[str, ...]:
        """One line per remark, e.g. ``rind planes are ...: zone 1, zone 2 ... and 7 more``."""
        return tuple(f"{remark}: {listed(places)}" for remark, places in self._places.items())
