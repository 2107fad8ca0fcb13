"""The JSON schema of reports, shipped with the code that writes them."""

from __future__ import annotations

import json
from importlib.resources import files
from typing import Any

from .measures import quality_schema


def report_schema() -> dict[str, Any]:
    """The schema (draft 2020-12) of the output of ``--report FILE.json``, as data."""
    text = files(__package__).joinpath("report.schema.json").read_text(encoding="utf-8")
    schema: dict[str, Any] = json.loads(text)
    schema["$defs"]["quality"] = quality_schema()
    return schema
