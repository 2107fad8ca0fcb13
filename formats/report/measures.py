"""The quality measures by name, in the order in which all reports show them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

_MEASURES = (
    ("f_skew harmonic mean", ("f_skew", "harmonic_mean")),
    ("f_skew mean", ("f_skew", "mean")),
    ("f_skew 1% quantile", ("f_skew", "p01")),
    ("f_skew minimum", ("f_skew", "min")),
    ("smallest scaled Jacobian", ("min_scaled_jacobian",)),
    ("smallest relative Jacobian", ("min_relative_jacobian",)),
    ("invalid cells", ("invalid_cells",)),
    ("inherited invalid cells", ("inherited_invalid_cells",)),
    ("negative volumes", ("negative_volumes",)),
    ("wall-normal deviation rms [deg]", ("wall_normal_deviation_deg", "rms")),
    ("wall-normal deviation max [deg]", ("wall_normal_deviation_deg", "max")),
    ("first cell height ratio min", ("first_cell_height_ratio", "min")),
    ("first cell height ratio max", ("first_cell_height_ratio", "max")),
    ("layer thickness ratio min", ("walls", "moving", "layer_thickness_ratio", "min")),
    ("layer thickness ratio max", ("walls", "moving", "layer_thickness_ratio", "max")),
    ("fixed walls: normal deviation rms [deg]", ("walls", "fixed", "wall_normal_deviation_deg", "rms")),
    ("fixed walls: normal deviation max [deg]", ("walls", "fixed", "wall_normal_deviation_deg", "max")),
    ("fixed walls: first cell ratio min", ("walls", "fixed", "first_cell_height_ratio", "min")),
    ("fixed walls: first cell ratio max", ("walls", "fixed", "first_cell_height_ratio", "max")),
    ("fixed walls: layer ratio min", ("walls", "fixed", "layer_thickness_ratio", "min")),
    ("fixed walls: layer ratio max", ("walls", "fixed", "layer_thickness_ratio", "max")),
    ("interface kink rms [deg]", ("interface_kink_deg", "rms")),
    ("interface kink max [deg]", ("interface_kink_deg", "max")),
    ("interface spacing jump rms", ("interface_spacing_jump", "rms")),
    ("interface spacing jump max", ("interface_spacing_jump", "max")),
    ("volume ratio min", ("volume_ratio", "min")),
    ("volume ratio max", ("volume_ratio", "max")),
    ("total volume", ("total_volume",)),
)
# Measures to which all cells contribute, so that they have no worst cell.
_OF_ALL = ("harmonic_mean", "mean", "p01", "rms")


@dataclass(frozen=True)
class MeasureRow:
    """One measure: value before (``None`` if there is none) and after, and the position of the worst as text."""

    name: str
    before: float | None
    after: float
    place: str

    @property
    def change(self) -> float | None:
        """Difference from the value before, ``None`` without one; round-off counts as no change."""
        if self.before is None:
            return None
        change = self.after - self.before
        return change if abs(change) > 1e-13 * abs(self.before) else 0.0


def measure_rows(quality: Mapping[str, Any]) -> list[MeasureRow]:
    """Every measure that the ``quality`` of a report has."""
    rows = []
    for name, keys in _MEASURES:
        before, after = (_pick(quality[when], keys) for when in ("before", "after"))
        if after is not None:
            rows.append(MeasureRow(name, before, after, _place(quality["after"], keys)))
    return rows


def _pick(quality: Mapping[str, Any], keys: tuple[str, ...]) -> Any:
    value: Any = quality
    for key in keys:
        value = None if value is None else value.get(key)
    return value


def _place(quality: Mapping[str, Any], keys: tuple[str, ...]) -> str:
    """Block and indices of the worst cell, for a measure that is an extreme."""
    if keys[0] == "walls":
        quality, keys = quality["walls"][keys[1]], keys[2:]
    places = quality.get("worst") or {}
    worst = places.get("_".join(keys)) or places.get(keys[0])
    return "" if not worst or keys[-1] in _OF_ALL else place_text(worst)


def place_text(worst: Mapping[str, Any]) -> str:
    """Block and indices of a cell."""
    return f"{worst['block']} ({', '.join(map(str, worst['ijk']))})"
