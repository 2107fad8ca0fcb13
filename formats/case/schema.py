"""The JSON schema of case files, derived from the reader's checks, with which editors complete and check cases."""

from __future__ import annotations

import dataclasses
import inspect
import re
from collections.abc import Mapping
from typing import Any

from meshdeform_core.boundary import Kind
from meshdeform_core.boundary.tables.matching import HOW
from meshdeform_core.grid.components import BY_PREFIX
from meshdeform_core.methods import ALIASES, CATALOGUE, IDW, RBF, TFI, Options
from meshdeform_core.methods.scattered.centres import SOLVERS
from meshdeform_core.methods.scattered.idw import ROTATIONS, WEIGHTS
from meshdeform_core.methods.scattered.rbf import ERRORS, GREEDY
from meshdeform_core.methods.scattered.summation import SUMMATIONS
from meshdeform_core.numerics.exact.basis import BASES

Schema = dict[str, Any]
VERSION = 1
_CHOICES = {
    "rotation": ROTATIONS,
    "weights": WEIGHTS,
    "basis": tuple(BASES),
    "solver": SOLVERS,
    "greedy": GREEDY,
    "greedy_error": ERRORS,
    "summation": SUMMATIONS,
    "remove_mean": (True, False, "auto"),
}
_FORMULA: Schema = {"type": ["number", "string"], "description": "a number, or a formula of x, y, z, t and constants"}
_THREE_FORMULAS = {"type": "array", "items": {"$ref": "#/$defs/formula"}, "minItems": 3, "maxItems": 3}
_THREE_NUMBERS = {"type": "array", "items": {"type": "number"}, "minItems": 3, "maxItems": 3}


def case_schema() -> Schema:
    """The schema (draft 2020-12) of a case file, as data."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": f"urn:meshdeform:case:{VERSION}",
        "title": "meshdeform case file",
        **_table(
            "",
            grid=_table(
                "How to read the grid.",
                boundary_file=_text("NASA neutral map file (.nmf) with the boundaries, relative to the case file."),
                tolerance=_number("Largest distance between coincident nodes, as a fraction of the local edge."),
                open={
                    "type": ["boolean", "array"],
                    "items": {"type": "string"},
                    "description": "Outside faces that are meant to lie close to others (true: all).",
                },
                plates={
                    "type": "array",
                    "items": {"type": "string"},
                    "description": "Faces between blocks that are thin plates: walls on both sides.",
                },
                components=_components(),
            ),
            constants={
                "type": "object",
                "description": "Names for numbers, usable in every formula.",
                "additionalProperties": {"type": "number"},
            },
            boundary={"type": "array", "items": _boundary(), "description": "Parts of the boundary."},
            method=_method(),
            repair=_table(
                "Treatment of cells that become invalid.",
                mode={
                    "enum": ["auto", "off", "polish"],
                    "description": "auto: repair them; off: never; polish: also improve the worst cells.",
                },
                min_jacobian=_number("Cells with a corner Jacobian below this fraction of its original are invalid."),
                time_limit=_number("No further repair or attempt begins after so many seconds."),
            ),
        ),
        "$defs": {"formula": _FORMULA, "motion": _motion()},
    }


def _components() -> Schema:
    own_file = _table(
        "A component in a file of its own.",
        file=_text("Grid file, relative to the case file."),
        boundary_file=_text("Its neutral map file (.nmf)."),
    )
    patterns = {"type": "array", "items": {"type": "string"}, "minItems": 1}
    named = {"anyOf": [{"type": "string"}, patterns, {**own_file, "required": ["file"]}]}
    return {
        "description": "Components of an overset grid: by the prefix of block names, or by patterns of block names.",
        "anyOf": [{"const": BY_PREFIX}, {"type": "object", "additionalProperties": named, "minProperties": 1}],
    }


def _table(description: str, **properties: Schema) -> Schema:
    table: Schema = {"type": "object", "properties": properties, "additionalProperties": False}
    return {**table, "description": description} if description else table


def _text(description: str) -> Schema:
    return {"type": "string", "description": description}


def _number(description: str) -> Schema:
    return {"type": "number", "description": description}


def _boundary() -> Schema:
    kinds = [kind.label for kind in reversed(Kind) if kind is not Kind.INTERFACE]
    names = {"type": "array", "items": {"type": "string"}, "minItems": 1}
    steps = {"type": "array", "items": {"$ref": "#/$defs/motion"}}
    return _table(
        "One part of the boundary.",
        name=_text("Its name in reports."),
        select={
            "anyOf": [{"type": "string"}, names],
            "description": 'Patches, families or block faces like "block3.jmin[1:65,*]"; default: all outside faces.',
        },
        where=_text("Only faces all of whose corners satisfy this, e.g. x > 0.5 and abs(y) < 0.2."),
        kind={"enum": kinds, "description": "Kind of its nodes; default: moving if there is a motion."},
        motion={"anyOf": [{"$ref": "#/$defs/motion"}, steps], "description": "Motions, applied in order."},
    )


def _motion() -> Schema:
    match = {"enum": list(HOW), "description": "How table points are matched to grid nodes."}
    table = {"match": match, "tolerance": _number("Largest distance of a match, in the unit of the grid.")}
    times = {
        "description": 'Times of the files: "START:STOP:STEP" or ascending numbers.',
        "anyOf": [{"type": "string"}, {"type": "array", "items": {"type": "number"}}],
    }
    pattern = {
        "description": "Displacement tables over time: a pattern like surface_*.csv, or a list.",
        "anyOf": [{"type": "string"}, {"type": "array", "items": {"type": "string"}}],
    }
    rotate = _table(
        "Rotation about an axis.",
        angle={"$ref": "#/$defs/formula", "description": "Degrees."},
        axis={**_THREE_NUMBERS, "description": "Direction of the axis; default [0, 0, 1]."},
        center={**_THREE_FORMULAS, "description": "A point on the axis; default the origin."},
    )
    kinds = (
        _table("", rotate={**rotate, "required": ["angle"]}),
        _table("", translate={**_THREE_FORMULAS, "description": "The same displacement for all nodes."}),
        _table("", displace={**_THREE_FORMULAS, "description": "Displacement as formulas of x, y, z, t."}),
        _table("", file=_text("Displacement table, relative to the case file."), **table),
        _table("", files=pattern, times=times, **table),
        *_given_motions(pattern, times, table),
    )
    return {"oneOf": [{**kind, "required": [next(iter(kind["properties"]))]} for kind in kinds]}


def _lattice() -> Schema:
    """The box of a free-form deformation."""
    place = {"anyOf": [{"type": "integer", "minimum": 1}, {"const": "*"}]}
    move = _table(
        "Control points, counted from 1 (* for all of them), and their displacement.",
        at={"type": "array", "items": place, "minItems": 3, "maxItems": 3},
        by={**_THREE_FORMULAS, "description": "Displacement as formulas of t."},
    )
    counts = {"type": "array", "items": {"type": "integer", "minimum": 2}, "minItems": 3, "maxItems": 3}
    edges = {"type": "array", "items": _THREE_NUMBERS, "minItems": 3, "maxItems": 3}
    return _table(
        "Free-form deformation: a box of control points carries along the nodes inside it.",
        origin={**_THREE_NUMBERS, "description": "A corner of the box."},
        edges={**edges, "description": "Its three edges from there."},
        points={**counts, "description": "Control points along each edge."},
        move={"type": "array", "items": {**move, "required": ["at", "by"]}, "minItems": 1},
    )


def _given_motions(pattern: Schema, times: Schema, table: Mapping[str, Schema]) -> tuple[Schema, ...]:
    """Motions defined by TOML tables; ``pattern``: file names, ``times``: their times, ``table``: their matching."""
    rigid = _table(
        "A rigid body with six degrees of freedom.",
        file=_text("Table with t, x y z, and rx ry rz (degrees) or qx qy qz qw."),
        order=_text('Sequence of the axes of the angles: "xyz" about fixed axes, "XYZ" about those of the body.'),
        center={**_THREE_NUMBERS, "description": "The point about which it turns; default the origin."},
    )
    amplitudes = {
        "description": "A formula of t for each shape, or a table with t and a column for each.",
        "anyOf": [
            {"type": "array", "items": {"$ref": "#/$defs/formula"}},
            {**_table("", file=_text("Table of amplitudes.")), "required": ["file"]},
        ],
    }
    modes = _table(
        "A sum of shapes, each times its amplitude.",
        files=pattern,
        file=_text("Result file of CalculiX (.frd) or Nastran (.op2) with several shapes."),
        geometry=_text("Bulk data file (.bdf) with the nodes of an .op2 file."),
        shapes={"type": "array", "items": {"type": "integer", "minimum": 1}, "description": "Numbers of the shapes."},
        amplitudes=amplitudes,
    )
    positions = _table(
        "New positions by the numbers of the points, like SU2's surface_positions.dat.",
        file=_text("Lines of a number and coordinates, relative to the case file."),
        files=pattern,
        times=times,
    )
    airfoil = _table(
        "A new shape of an airfoil.",
        file=_text("Coordinates in Selig's or Lednicer's form."),
        plane=_text('Axes along the chord and upwards; default "xy".'),
        fit={"enum": ["chord", "none"], "description": "chord (default): leading and trailing edge stay."},
    )
    return (
        _table("", ffd={**_lattice(), "required": ["origin", "edges", "points", "move"]}),
        _table("", rigid={**rigid, "required": ["file"]}),
        _table("", modes={**modes, "required": ["amplitudes"]}, **table),
        _table("", airfoil={**airfoil, "required": ["file"]}),
        _table("", positions=positions),
    )


def _method() -> Schema:
    parts = {kind.__name__.lower(): _options(kind) for kind in (IDW, RBF, TFI)}
    names = {"enum": [*CATALOGUE, *ALIASES], "default": Options().name, "description": "See `meshdeform methods`."}
    return _table("The method and its options.", name=names, **parts)


def _options(kind: type) -> Schema:
    texts = _descriptions(inspect.cleandoc(kind.__doc__ or ""))
    keys = {
        field.name: {**_value(field), "default": field.default, "description": texts[field.name]}
        for field in dataclasses.fields(kind)
    }
    return _table(f"Options of {kind.__name__}.", **keys)


def _value(field: dataclasses.Field[Any]) -> Schema:
    if field.name in _CHOICES:
        return {"enum": list(_CHOICES[field.name])}
    if isinstance(field.default, bool):
        return {"type": "boolean"}
    number = {"type": "integer" if isinstance(field.default, int) else "number", "minimum": 0}
    return {"anyOf": [number, {"const": "auto"}]} if "auto" in str(field.type) else number


def _descriptions(text: str) -> dict[str, str]:
    """The entries of the section ``Attributes`` of a docstring."""
    found: dict[str, str] = {}
    for entry in re.split(r"\n(?=\w)", text.split("----\n", 1)[1]):
        names, _, meaning = entry.partition(" : ")
        for name in names.split(", "):
            found[name] = " ".join(meaning.replace("``", "").split())
    return found
