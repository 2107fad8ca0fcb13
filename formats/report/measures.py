"""The quality measures: names for people, what they mean, in the order in which all reports show them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
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
_COUNTS = ("invalid_cells", "inherited_invalid_cells", "negative_volumes")
_ALWAYS = ("f_skew", "volume_ratio")
_SINCE = ("min_relative_jacobian", "walls")


@dataclass(frozen=True)
class MeasureRow:
    """One measure: value before (``None`` if there is none) and after, the position of the worst as text, and whether
    it compares with another grid."""

    name: str
    before: float | None
    after: float
    place: str
    compared: bool = False

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
    for name, keys, compared in _MEASURES:
        before, after = (_pick(quality[when], keys) for when in ("before", "after"))
        if after is not None:
            rows.append(MeasureRow(name, before, after, _place_of_worst(quality["after"], keys), compared))
    return rows


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


def report_schema() -> dict[str, Any]:
    """The schema (draft 2020-12) of the output of ``--report FILE.json``, as data."""
    text = files(__package__).joinpath("report.schema.json").read_text(encoding="utf-8")
    schema: dict[str, Any] = json.loads(text)
    schema["$defs"]["quality"] = _quality_schema()
    return schema


def _quality_schema() -> dict[str, Any]:
    """The JSON schema of the quality of one grid, from the table of measures."""
    properties: dict[str, Any] = {}
    of_walls: dict[str, Any] = {}
    for _, keys, _ in _MEASURES:
        into, keys = (of_walls, keys[2:]) if keys[0] == "walls" else (properties, keys)
        if keys[0] not in into:
            into[keys[0]] = _property(keys)
    worst = {"type": "object", "additionalProperties": {"$ref": "#/$defs/place"}}
    walls = {"type": "object", "properties": of_walls | {"worst": worst}, "additionalProperties": False}
    told = "at moving walls and at fixed ones (by role: no far field); null where there are none"
    either = {name: _or_null(walls) for name in ("moving", "fixed")}
    properties["walls"] = {
        "type": "object", "description": told, "properties": either, "additionalProperties": False
    }  # fmt: skip
    told = "the worst cell of each measure that is an extreme; with _min or _max where both ends matter"
    return {
        "type": "object",
        "description": "Quality of one grid; null where there is no moving wall or no interface",
        "properties": properties | {"worst": worst | {"description": told}},
        "required": [key for key in properties if key not in _SINCE],
        "additionalProperties": False,
    }


def _property(keys: tuple[str, ...]) -> dict[str, Any]:
    kind: dict[str, Any]
    if len(keys) == 1:
        kind = {"type": "integer", "minimum": 0} if keys[0] in _COUNTS else {"type": "number"}
    else:
        kind = {"$ref": f"#/$defs/{'skew' if keys[0] == 'f_skew' else 'spread' if keys[1] == 'rms' else 'range'}"}
        kind = kind if keys[0] in _ALWAYS else _or_null(kind)
    return kind | ({"description": DEFINITIONS[keys[0]]} if keys[0] in DEFINITIONS else {})


def _or_null(kind: dict[str, Any]) -> dict[str, Any]:
    return {"anyOf": [kind, {"type": "null"}]}
