"""The components of an overset grid in a case: ``[grid] components``."""

from __future__ import annotations

import glob
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from meshdeform_core.grid.components import BY_PREFIX, Components
from meshdeform_core.wording import literal

from .values import Table, check_keys, fail, file_of

MAIN = "main"
"""Name of the component formed by the grid's own blocks if all other components are in separate files."""
_EXPECTED = (
    f'expected "{BY_PREFIX}", or names with block patterns, like {{ wing = ["wing*"], flap = ["flap*"] }}, or with a '
    f'file, like {{ flap = {{ file = "flap.cgns" }} }}'
)


@dataclass(frozen=True)
class ComponentFile:
    """A component in a separate file; ``boundary_file`` is its neutral map file."""

    path: Path
    boundary_file: Path | None = None


@dataclass(frozen=True)
class ComponentsEntry:
    """Block patterns of the components, and the separate files of some of them."""

    patterns: Components = ""
    files: Mapping[str, ComponentFile] = field(default_factory=dict)


def components_of(grid: Table, folder: Path) -> ComponentsEntry:
    """The entry ``components`` of the table ``[grid]``.

    Raises
    ------
    CaseError
        For anything else than the documented forms.
    """
    value = grid.get("components", "")
    if value in ("", BY_PREFIX):
        return ComponentsEntry(value)
    if not isinstance(value, dict) or not value:
        raise fail("grid.components", f"found {literal(value)}; {_EXPECTED}")
    files = {name: _file(name, entry, folder) for name, entry in value.items() if isinstance(entry, dict)}
    own = {name: _patterns(name, entry) for name, entry in value.items() if name not in files}
    if files and not own:
        if MAIN in files:
            raise fail("grid.components", f"{MAIN!r} is the name of the blocks of the grid itself; choose another one")
        own = {MAIN: ("*",)}
    return ComponentsEntry({**{name: (f"{glob.escape(name)}.*",) for name in files}, **own}, files)


def _file(name: str, entry: Table, folder: Path) -> ComponentFile:
    where = f"grid.components.{name}"
    check_keys(entry, ("file", "boundary_file"), where)
    if "file" not in entry:
        raise fail(where, f"names no file; {_EXPECTED}")
    path, table = (file_of(entry[key], folder, where) if key in entry else None for key in ("file", "boundary_file"))
    assert path is not None
    return ComponentFile(path, table)


def _patterns(name: str, entry: Any) -> tuple[str, ...]:
    patterns = [entry] if isinstance(entry, str) else entry
    if not isinstance(patterns, list) or not patterns or not all(isinstance(each, str) for each in patterns):
        raise fail(f"grid.components.{name}", f"found {literal(entry)}; {_EXPECTED}")
    return tuple(patterns)
