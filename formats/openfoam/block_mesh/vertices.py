"""The vertices of a blockMeshDict, by number or by name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from meshdeform_core.errors import suggestion
from meshdeform_core.grid import FloatArray

from .dictionary import Dictionary
from .entries import Reading, list_of


@dataclass(frozen=True)
class Vertices:
    """Points (n, 3) before scaling, and the numbers of those that have names."""

    points: FloatArray
    names: Mapping[str, int]

    def take(self, items: Reading) -> int:
        """Take the next vertex; returns its number."""
        word = items.next_word()
        if word is not None:
            if word not in self.names:
                items.fail(f"there is no vertex {word!r}{suggestion(word, self.names)}")
            return self.names[word]
        number = items.whole("the number of a vertex")
        if not 0 <= number < len(self.points):
            items.fail(f"there is no vertex {number}; the file has 0 to {len(self.points) - 1}")
        return number


def read_vertices(top: Dictionary) -> Vertices:
    """The list ``vertices``; projected vertices are refused."""
    items, names = list_of(top, "vertices"), dict[str, int]()
    points: list[tuple[float, float, float]] = []
    while items.more:
        word = items.next_word()
        if word == "name":
            names[items.word("the name of a vertex")] = len(points)
            word = items.next_word()
        if word is not None:
            items.fail(f"{word} is not supported in vertices; expected points (x y z)")
        points.append(items.point("a vertex"))
    return Vertices(np.array(points, dtype=np.float64).reshape(-1, 3), names)
