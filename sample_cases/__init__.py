"""Sample cases: one folder each with a README.md, a case.toml and a generator with a size parameter.

A generator module offers ``generate(size) -> Grid``, ``DEFAULT_SIZE``, ``SIZE_HELP`` and ``SIZES``, sizes with names;
one whose motion is a table also ``tables(size) -> {file name: SurfaceData}``.
"""

from __future__ import annotations

import importlib
from importlib.resources import files
from importlib.resources.abc import Traversable
from types import ModuleType

SAMPLES = {
    "square": "square",
    "airfoil": "airfoil",
    "splitter-plate": "splitter_plate",
    "hemisphere": "hemisphere",
    "beam": "beam",
    "wing": "wing",
    "cascade": "cascade",
    "valve": "valve",
}
"""Name on the command line -> folder."""


def load(name: str) -> ModuleType:
    """The generator module of a sample."""
    return importlib.import_module(f"{__package__}.{SAMPLES[name]}")


def folder(name: str) -> Traversable:
    """Where a sample's README.md and case.toml lie."""
    return files(__package__) / SAMPLES[name]
