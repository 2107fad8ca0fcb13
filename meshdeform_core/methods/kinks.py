"""Why a derivative is not that of the displacement field itself: what is held fixed, and where there is none."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

import numpy as np

from ..grid import FloatArray, IntArray
from ..numerics.tape import largest

Kinks = Counter[str]
"""Number of places by kind, one of the texts below, in which ``{}`` stands for the number."""

EDGES = "{} nodes that slide on curved surfaces are at edges of their flat faces, where there is no derivative"
CHOSEN = (
    "the greedy reduction chooses centres for each displacement; the derivative is that of the interpolation with all "
    "centres"
)
HALF_TURNS = (
    "{} wall nodes turn by 180 degrees, where the direction of rotation jumps; the derivative is that on one side"
)
FOLDED = "{} wall nodes have faces that are folded onto each other, where normals jump"
LARGEST = "{} sources share the largest displacement, which sets alpha; the mean of their derivatives is taken"
BETWEEN = (
    "{} wall nodes are equally far from two nodes across a closing gap, whose direction jumps from one to the other"
)
_HALF_TURN = 1e-6
"""Relative difference from half a turn."""


def tied(size: FloatArray, owner: IntArray) -> int:
    """Number of sources whose ``size`` (n,) is the largest, zero if it is one; images of an ``owner`` count once."""
    found = len(np.unique(owner[largest(size)]))
    return found if found > 1 else 0


def half_turns(turn: FloatArray, owner: IntArray) -> int:
    """Number of sources that turn by 180 degrees; ``turn`` (n,) are the angles of their images, radians."""
    return len(np.unique(owner[np.abs(turn - np.pi) < _HALF_TURN * np.pi]))


def kinks_of(counts: Iterable[tuple[str, int]]) -> Kinks:
    """The kinks that occur at all."""
    return Counter({text: count for text, count in counts if count})


def reason_of(kinks: Kinks) -> str:
    """All of them in words; empty if there are none."""
    return "; ".join(text.replace("{}", f"{count:,}", 1) for text, count in kinks.items())
