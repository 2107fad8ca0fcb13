"""The quality measures: names for people, what they mean, in the order in which all reports show them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

_MEASURES: tuple[tuple[str, tuple[str, ...], bool], ...] = (
    ("f_skew harmonic mean", ("f_skew", "harmonic_mean"), False),
    ("f_skew mean", ("f_skew", "mean"), False),
    ("f_skew 1% quantile", ("f_skew", "p01"), False),
    ("f_skew minimum", ("f_skew", "min"), False),
    ("smallest scaled Jacobian", ("min_scaled_jacobian",), False),
    ("smallest relative Jacobian", ("min_relative_jacobian",), True),
    ("invalid cells", ("invalid_cells",), False),
    ("inherited invalid cells", ("inherited_invalid_cells",), False),
    ("negative volumes", ("negative_volumes",), False),
    ("wall-normal deviation rms [deg]", ("wall_normal_deviation_deg", "rms"), False),
    ("wall-normal deviation max [deg]", ("wall_normal_deviation_deg", "max"), False),
    ("first cell height ratio min", ("first_cell_height_ratio", "min"), True),
    ("first cell height ratio max", ("first_cell_height_ratio", "max"), True),
    ("layer thickness ratio min", ("walls", "moving", "layer_thickness_ratio", "min"), True),
    ("layer thickness ratio max", ("walls", "moving", "layer_thickness_ratio", "max"), True),
    ("fixed walls: normal deviation rms [deg]", ("walls", "fixed", "wall_normal_deviation_deg", "rms"), False),
    ("fixed walls: normal deviation max [deg]", ("walls", "fixed", "wall_normal_deviation_deg", "max"), False),
    ("fixed walls: first cell ratio min", ("walls", "fixed", "first_cell_height_ratio", "min"), True),
    ("fixed walls: first cell ratio max", ("walls", "fixed", "first_cell_height_ratio", "max"), True),
    ("fixed walls: layer ratio min", ("walls", "fixed", "layer_thickness_ratio", "min"), True),
    ("fixed walls: layer ratio max", ("walls", "fixed", "layer_thickness_ratio", "max"), True),
    ("interface kink rms [deg]", ("interface_kink_deg", "rms"), False),
    ("interface kink max [deg]", ("interface_kink_deg", "max"), False),
    ("interface spacing jump rms", ("interface_spacing_jump", "rms"), False),
    ("interface spacing jump max", ("interface_spacing_jump", "max"), False),
    ("volume ratio min", ("volume_ratio", "min"), True),
    ("volume ratio max", ("volume_ratio", "max"), True),
    ("total volume", ("total_volume",), False),
)
"""Name, keys in the report, and whether it compares with another grid."""
DEFINITIONS = {
    "invalid_cells": "a corner Jacobian that was positive became zero or negative",
    "inherited_invalid_cells": "were invalid in the input",
    "min_scaled_jacobian": "smallest corner Jacobian over its edge lengths",
    "min_relative_jacobian": "smallest corner Jacobian over that of the input",
    "wall_normal_deviation_deg": "angle between the first grid line and the wall normal at moving walls",
    "first_cell_height_ratio": "height of the first cell at moving walls over that of the input",
    "layer_thickness_ratio": "thickness of the first layers of cells over that of the input",
    "interface_kink_deg": "angle of grid lines at block interfaces; after: its change",
    "interface_spacing_jump": "logarithm of the spacing ratio at block interfaces; after: its change",
    "volume_ratio": "cell volume over that of the input",
}
# Measures to which all cells contribute, so that they have no worst cell.
_OF_ALL = ("harmonic_mean", "mean", "p01", "rms")


def measure_values(quality: Mapping[str, Any]) -> Iterator[tuple[str, bool, Any, Any, str]]:
    """Every measure that the ``quality`` of a report has: its name, whether it compares with another grid, its values
    before (``None`` if there is none) and after, and the position of the worst cell as text."""
    for name, keys, compared in _MEASURES:
        before, after = (_pick(quality[when], keys) for when in ("before", "after"))
        if after is not None:
            yield name, compared, before, after, _place_of_worst(quality["after"], keys)


def change_of(before: float | None, after: float) -> float | None:
    """Difference from the value before, ``None`` without one; round-off counts as no change."""
    if before is None:
        return None
    return after - before if abs(after - before) > 1e-13 * abs(before) else 0.0


def _pick(quality: Mapping[str, Any], keys: tuple[str, ...]) -> Any:
    value: Any = quality
    for key in keys:
        value = None if value is None else value.get(key)
    return value


def _place_of_worst(quality: Mapping[str, Any], keys: tuple[str, ...]) -> str:
    """Block and indices of the worst cell, for a measure that is an extreme."""
    if keys[0] == "walls":
        quality, keys = quality["walls"][keys[1]], keys[2:]
    places = quality.get("worst") or {}
    worst = places.get("_".join(keys)) or places.get(keys[0])
    return "" if not worst or keys[-1] in _OF_ALL else place_text(worst)


def place_text(worst: Mapping[str, Any]) -> str:
    """Block and indices of a cell."""
    return f"{worst['block']} ({', '.join(map(str, worst['ijk']))})"
