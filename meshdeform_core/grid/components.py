"""Which blocks of a grid form the components of an overset grid."""

from __future__ import annotations

import dataclasses
import fnmatch
import re
from collections.abc import Mapping, Sequence

from ..errors import CaseError, suggestion
from ..wording import listed
from .blocks import Grid

BY_PREFIX = "zone prefix"
"""Components are the blocks whose names differ in the number at their end only: ``flap.00001``, ``flap.00002``."""
_NUMBER = re.compile(r"[ ._-]*\d+$")

Components = str | Mapping[str, Sequence[str]]
"""``BY_PREFIX``, or patterns of block names by the name of the component; the first one that fits counts."""


def with_components(grid: Grid, components: Components) -> Grid:
    """The grid divided into the components that the case defines; unchanged if it defines none.

    Raises
    ------
    CaseError
        When they do not divide the blocks into two or more groups, or a pattern matches no block.
    """
    if not components:
        return grid
    if isinstance(components, str):
        names = [_NUMBER.sub("", name) or name for name in grid.names]
    else:
        names = _by_patterns(grid, components)
    if len(set(names)) < 2:
        raise CaseError(
            f"grid.components: all {grid.n_blocks} blocks belong to the component {names[0]!r}; expected two or more "
            f"(blocks: {listed(grid.names)})"
        )
    return dataclasses.replace(grid, components=tuple(names))


def _by_patterns(grid: Grid, components: Mapping[str, Sequence[str]]) -> list[str]:
    names = [""] * grid.n_blocks
    for component, patterns in components.items():
        for pattern in patterns:
            fitting = [b for b, name in enumerate(grid.names) if fnmatch.fnmatchcase(name, pattern)]
            if not fitting:
                raise CaseError(
                    f"grid.components: {pattern!r} of {component!r} matches no block; blocks are "
                    f"{listed(grid.names)}{suggestion(pattern, grid.names)}"
                )
            for block in fitting:
                names[block] = names[block] or component
        if component not in names:
            raise CaseError(f"grid.components: all blocks of {component!r} belong to components named before it")
    rest = [grid.names[b] for b, name in enumerate(names) if not name]
    if rest:
        raise CaseError(
            f"grid.components: {len(rest)} blocks belong to no component: {listed(rest)}; "
            f'name them, or let the last component take the rest with "*"'
        )
    return names
