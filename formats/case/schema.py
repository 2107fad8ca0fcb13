"""The JSON schema of case files, derived from the reader's forms, with which editors complete and check cases."""

from __future__ import annotations

from typing import Any

from meshdeform_core.grid.components import BY_PREFIX
from meshdeform_core.methods import ALIASES, CATALOGUE, Options, declared

from .forms import schema_of
from .motions import KINDS
from .reader import PARTS, CaseForm, ComponentForm

Schema = dict[str, Any]
VERSION = 1


def case_schema() -> Schema:
    """The schema (draft 2020-12) of a case file, as data."""
    schema, component = schema_of(CaseForm), schema_of(ComponentForm)
    definitions = {**schema["$defs"], **component["$defs"]}
    definitions["MotionStep"]["oneOf"] = [{"required": [name]} for name in KINDS]
    patterns = {"type": "array", "items": {"type": "string"}, "minItems": 1}
    own = {"anyOf": [{"type": "string"}, patterns, {"$ref": component["$ref"]}]}
    definitions["GridForm"]["properties"]["components"]["anyOf"] = [
        {"const": BY_PREFIX},
        {"type": "object", "additionalProperties": own, "minProperties": 1},
    ]
    definitions["CaseForm"]["properties"]["method"] = _method()
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": f"urn:meshdeform:case:{VERSION}",
        "$ref": schema["$ref"],
        "$defs": definitions,
    }


def _method() -> Schema:
    names = {"enum": [*CATALOGUE, *ALIASES], "default": Options().name, "description": "See `meshdeform methods`."}
    parts = {name: _table(f"Options of {kind.__name__}.", _options(kind)) for name, kind in PARTS.items()}
    return _table("The method and its options.", {"name": names, **parts})


def _table(description: str, properties: Schema) -> Schema:
    return {
        "type": "object", "description": description, "properties": properties, "additionalProperties": False,
    }  # fmt: skip


def _options(kind: type) -> Schema:
    found = {}
    for name, option in declared(kind).items():
        value: Schema = {"enum": list(option.choices)}
        if option.number is not None:
            number: Schema = {"type": "integer" if option.number is int else "number"}
            number["exclusiveMinimum" if option.open_low else "minimum"] = option.low
            if option.high < float("inf"):
                number["maximum"] = option.high
            value = {"anyOf": [number, value]} if option.choices else number
        found[name] = {**value, "default": option.default, "description": option.meaning}
    return found
