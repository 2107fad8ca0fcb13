"""JSON output, indented, with one entry per line in long lists."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

_LONG = 100
"""Longer lists are written by the json library's compiled encoder, which does not indent."""


def json_text(record: Mapping[str, Any], allow_nan: bool = True) -> str:
    """``record`` as JSON text, indented by two.

    Raises
    ------
    ValueError
        For NaN and infinite numbers, which JSON lacks, unless ``allow_nan``.
    """
    rows = []
    for key, value in record.items():
        if isinstance(value, list) and len(value) > _LONG:
            entries = ",\n    ".join(json.dumps(entry, allow_nan=allow_nan) for entry in value)
            text = f"[\n    {entries}\n  ]"
        else:
            # Text never contains a line break of its own: it is escaped.
            text = json.dumps(value, indent=2, allow_nan=allow_nan).replace("\n", "\n  ")
        rows.append(f"  {json.dumps(key)}: {text}")
    return "{\n" + ",\n".join(rows) + "\n}" if rows else "{}"
