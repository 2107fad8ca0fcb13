"""Shell completion: methods, samples, patches and blocks of the grid, keys of the case file."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import click
from click.shell_completion import CompletionItem

from .measures import MEASURES


def methods(context: click.Context, parameter: click.Parameter, typed: str) -> list[CompletionItem]:
    """Names of methods."""
    from meshdeform_core.methods import ALIASES, CATALOGUE

    return _items([*ALIASES, *CATALOGUE], typed)


def samples(context: click.Context, parameter: click.Parameter, typed: str) -> list[CompletionItem]:
    """Names of samples."""
    from meshdeform_samples import SAMPLES

    return _items(SAMPLES, typed)


def settings(context: click.Context, parameter: click.Parameter, typed: str) -> list[CompletionItem]:
    """Keys of the case file's method tables, with their text values."""
    import dataclasses

    from meshdeform_core.methods import IDW, RBF, TFI

    parts = {"idw": IDW, "rbf": RBF, "tfi": TFI}
    keys = [f"method.{name}.{field.name}=" for name, part in parts.items() for field in dataclasses.fields(part)]
    return _items(["method.name=", *keys], typed)


def fields(context: click.Context, parameter: click.Parameter, typed: str) -> list[CompletionItem]:
    """Names of fields that can be written to files."""
    return _items((*MEASURES, "invalid", "all"), typed)


def patches(context: click.Context, parameter: click.Parameter, typed: str) -> list[CompletionItem]:
    """Patches, families and block faces of the grid on the command line."""
    grid = _grid(context)
    if grid is None:
        return []
    named = {name for patch in grid.patches for name in (patch.family, patch.name) if name}
    sides = ("imin", "imax", "jmin", "jmax", "kmin", "kmax")
    return _items([*sorted(named), *(f"{block}.{side}" for block in grid.names for side in sides)], typed)


def blocks(context: click.Context, parameter: click.Parameter, typed: str) -> list[CompletionItem]:
    """Blocks of the grid on the command line."""
    grid = _grid(context)
    return [] if grid is None else _items(grid.names, typed)


def _grid(context: click.Context):  # type: ignore[no-untyped-def]
    """The grid on the command line, if it can be read; completion ignores errors."""
    from meshdeform_core.errors import MeshDeformError
    from meshdeform_formats.grids import read_grid_with_boundaries

    # An option without its value ends the parsing before arguments have their names.
    path = context.params.get("grid") or next(iter(context.args), None)
    boundaries = context.params.get("boundary_file")
    if path is None:
        return None
    try:
        return read_grid_with_boundaries(Path(path), None if boundaries is None else Path(boundaries))
    except (MeshDeformError, OSError):
        return None


def _items(names: Iterable[str], typed: str) -> list[CompletionItem]:
    return [CompletionItem(name) for name in names if name.startswith(typed)]
