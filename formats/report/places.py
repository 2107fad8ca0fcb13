"""Invalid cells put together by place: block and nearest boundary."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Place:
    """Cells of one block near one boundary: smallest and largest i, j, k, mean centre, first step that broke any."""

    block: str
    patch: str
    cells: int
    low: tuple[int, ...]
    high: tuple[int, ...]
    center: tuple[float, ...]
    step: int


def places_of(cells: Sequence[Mapping[str, Any]]) -> list[Place]:
    """The places of the invalid cells of a report, the largest first."""
    groups: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for cell in cells:
        groups.setdefault((cell["block"], cell["nearest_patch"]), []).append(cell)
    places = [
        Place(
            block,
            patch,
            len(group),
            tuple(map(min, zip(*(cell["ijk"] for cell in group), strict=True))),
            tuple(map(max, zip(*(cell["ijk"] for cell in group), strict=True))),
            tuple(sum(x) / len(group) for x in zip(*(cell["center"] for cell in group), strict=True)),
            min(cell["step"] for cell in group),
        )
        for (block, patch), group in groups.items()
    ]
    return sorted(places, key=lambda place: -place.cells)
