"""Selection by the patterns of a case file: of face quads by patch names, families, block faces and windows; of blocks
that form the components of an overset grid by their names."""

from __future__ import annotations

import dataclasses
import fnmatch
import re
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from ..errors import CaseError, suggestion
from ..numerics.geometry.coincidence import distinct
from ..wording import listed
from .blocks import Grid, IntArray
from .parts import Side, Window
from .topology import FaceQuads, Topology, quads_of_windows

_FACE = re.compile(r"(?P<block>.+)\.(?P<side>[ijk*?][a-z*?]*)(?:\[(?P<window>[^\]]*)\])?", re.DOTALL)
BY_PREFIX = "zone prefix"
"""Components are the blocks whose names differ in the number at their end only: ``flap.00001``, ``flap.00002``."""
_NUMBER = re.compile(r"[ ._-]*\d+$")

Components = str | Mapping[str, Sequence[str]]
"""``BY_PREFIX``, or patterns of block names by the name of the component; the first one that fits counts."""


def select_quads(grid: Grid, topology: Topology, patterns: Iterable[str], owner: str) -> IntArray:
    """External face quads that match any of ``patterns``, ascending.

    A pattern is a patch name, a family name, ``block/patch``, ``block/family``, or a block face ``block.side`` with an
    optional window ``[a:b,c:d]`` of nodes (1-based, inclusive); ``*`` and ``?`` are wildcards. ``owner`` names the
    boundary entry in messages. Raises CaseError when a pattern matches nothing, or only faces that other blocks share.
    """
    chosen: list[IntArray] = []
    for pattern in patterns:
        quads = quads_of_pattern(grid, topology.quads, pattern, owner)
        chosen.append(quads)
        if not topology.external[quads].any():
            raise CaseError(
                f"boundary {owner!r}: {pattern!r} selects only faces that are shared with other blocks; "
                f"expected faces on the outside of the grid (see `meshdeform info`)"
            )
    selected = distinct(np.concatenate(chosen), len(topology.partner))
    return selected[topology.external[selected]]


def quads_of_pattern(grid: Grid, quads: FaceQuads, pattern: str, owner: str) -> IntArray:
    """Face quads, shared or not, that a pattern selects; see :func:`select_quads`."""
    if pattern == "*":
        return np.arange(len(quads.corners))
    # By the name or family of a patch; with ``BLOCK/`` before it, in that block.
    names = [(name, window) for patch in grid.patches for name in (patch.name, patch.family) if name
             for window in patch.windows]  # fmt: skip
    named = [window for name, window in names if fnmatch.fnmatchcase(name, pattern)
             or fnmatch.fnmatchcase(f"{grid.names[window.block]}/{name}", pattern)]  # fmt: skip
    if named:
        return quads_of_windows(quads, named)[0]
    windows = list(_face_windows(grid, pattern, owner))
    if not windows:
        known = sorted({name for patch in grid.patches for name in (patch.name, patch.family) if name})
        hint = suggestion(pattern, [*known, *(f"{n}.{s.label}" for n in grid.names for s in Side)], 3)
        if not hint:
            patches = f"patches are {listed(known)}" if known else "the grid has no named patches"
            hint = f"; {patches}, block faces are written like {grid.names[0]}.{next(iter(Side)).label}"
        raise CaseError(f"boundary {owner!r}: {pattern!r} matches no patch, family or block face{hint}")
    found = quads_of_windows(quads, windows)[0]
    if found.size == 0:
        raise CaseError(f"boundary {owner!r}: {pattern!r} contains no cell face (a window needs two nodes each way)")
    return found


def _face_windows(grid: Grid, pattern: str, owner: str) -> Iterable[Window]:
    match = _FACE.fullmatch(pattern)
    if not match:
        return
    sides = [(side, side.axis, *side.tangential) for side in Side if fnmatch.fnmatchcase(side.label, match["side"])]
    for block, (name, shape) in enumerate(zip(grid.names, grid.shapes, strict=True)):
        if not fnmatch.fnmatchcase(name, match["block"]):
            continue
        for side, axis, a, b in sides:
            if shape[axis] > 1:
                size = (shape[a], shape[b])
                low, high = _window_bounds(match["window"], size, f"boundary {owner!r}: {pattern!r} on {name}")
                yield Window(block, side, low, high)


def _window_bounds(text: str | None, size: tuple[int, int], where: str) -> tuple[tuple[int, int], tuple[int, int]]:
    if text is None:
        return (0, 0), (size[0] - 1, size[1] - 1)
    parts = [part.strip() for part in text.split(",")]
    if len(parts) == 1 and 1 in size:
        parts.insert(size.index(1), "*")
    if len(parts) != 2:
        raise CaseError(f"{where}: window [{text}] has {len(parts)} ranges; expected two, like [1:65,*]")
    bounds = []
    for part, n in zip(parts, size, strict=True):
        match = re.fullmatch(r"(\d*|\*)(?::(\d*|\*))?", part)
        if not match or (part not in ("*", ":") and ":" not in part):
            raise CaseError(f"{where}: {part!r} is not a range of nodes; expected a:b, a:*, *:b or *")
        low = int(match[1]) if match[1] not in ("", "*") else 1
        high = int(match[2]) if match[2] not in (None, "", "*") else n
        if not 1 <= low <= high <= n:
            raise CaseError(f"{where}: range {part!r} lies outside the face; expected 1 <= first <= last <= {n}")
        bounds.append((low - 1, high - 1))
    return (bounds[0][0], bounds[1][0]), (bounds[0][1], bounds[1][1])


def with_components(grid: Grid, components: Components) -> Grid:
    """The grid divided into the components that the case defines; unchanged if it defines none. Raises CaseError when
    they do not divide the blocks into two or more groups, or a pattern matches no block."""
    if not components:
        return grid
    if isinstance(components, str):
        names = [_NUMBER.sub("", name) or name for name in grid.names]
    else:
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
    if len(set(names)) < 2:
        raise CaseError(
            f"grid.components: all {grid.n_blocks} blocks belong to the component {names[0]!r}; expected two or more "
            f"(blocks: {listed(grid.names)})"
        )
    return dataclasses.replace(grid, components=tuple(names))
