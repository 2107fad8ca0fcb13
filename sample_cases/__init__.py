"""Sample cases: one folder each with a README.md, a case.toml and a generator with a size parameter.

A generator module defines ``generate(size) -> Grid``, ``DEFAULT_SIZE``, ``SIZE_HELP`` and ``SIZES`` (named sizes), and
``tables(size) -> {file name: SurfaceData}`` if its motion is a table.
"""

from __future__ import annotations

import importlib
import tomllib
from collections.abc import Mapping
from importlib.resources import files
from importlib.resources.abc import Traversable
from types import ModuleType
from typing import TYPE_CHECKING, Any

from meshdeform_core.errors import CaseError, suggestion

if TYPE_CHECKING:
    from meshdeform_core.boundary.tables import SurfaceData
    from meshdeform_core.grid import Grid

_LARGEST = 10
"""Samples are at most so many times finer than the finest that has a name."""

SAMPLES = {
    "square": "square",
    "airfoil": "airfoil",
    "splitter-plate": "splitter_plate",
    "hemisphere": "hemisphere",
    "beam": "beam",
    "wing": "wing",
    "cascade": "cascade",
    "valve": "valve",
    "workshop-cylinder": "workshop_cylinder",
}
"""Name on the command line -> folder."""


def load(name: str) -> ModuleType:
    """The generator module of a sample."""
    if name not in SAMPLES:
        raise CaseError(f"sample {name!r} is unknown; known are {', '.join(SAMPLES)}{suggestion(name, SAMPLES)}")
    return importlib.import_module(f"{__package__}.{SAMPLES[name]}")


def folder(name: str) -> Traversable:
    """The folder with a sample's README.md and case.toml."""
    return files(__package__) / SAMPLES[name]


def generate(name: str, size: int | str | None = None) -> tuple[Grid, dict[str, SurfaceData]]:
    """The grid of a sample and the tables of its motion, by file name."""
    module = load(name)
    text, named = str(module.DEFAULT_SIZE if size is None else size), module.SIZES
    # ASCII only: Python also accepts digits of other scripts, which are hardly intended.
    if text not in named and not (text.isascii() and text.lstrip("-").isdigit()):
        raise CaseError(f"sample {name}: --size {text!r}; expected a whole number or one of {', '.join(named)}")
    number = named[text] if text in named else int(text)
    largest = _LARGEST * max(module.SIZES.values())
    if number > largest:
        raise CaseError(f"sample {name}: size = {number}; expected at most {largest}")
    try:
        return module.generate(number), module.tables(number) if hasattr(module, "tables") else {}
    except ValueError as error:
        raise CaseError(f"sample {name}: {error}") from error


def case_content(name: str, tables: Mapping[str, SurfaceData]) -> dict[str, Any]:
    """The content of a sample's case file, with ``tables`` in place of their files."""
    content = tomllib.loads((folder(name) / "case.toml").read_text(encoding="utf-8"))
    for entry in content["boundary"]:
        for step in entry.get("motion", ()):
            if step.get("file") in tables:
                step["file"] = tables[step["file"]]
    return content
