"""Rotations divided into steps with new weights in each (Sen et al. eqs. 26-28), at m times the cost of one step."""

from __future__ import annotations

from ..arrays import FloatArray
from ..geometry.quaternions import rotate


def division_path(start: FloatArray, values: FloatArray, m: int) -> tuple[FloatArray, ...]:
    """Source positions at the start of each of ``m`` steps (eq. 26): each source repeats its own rigid motion."""
    part, translation = values[:4].T.copy(), values[4:].T
    path = [start]
    for _ in range(m - 1):
        path.append(rotate(part, path[-1]) + translation)
    return tuple(path)
