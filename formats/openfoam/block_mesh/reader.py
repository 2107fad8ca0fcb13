"""blockMeshDict files, and the nodes that blockMesh generates from them.

Nodes inside a block are blended from its twelve edges, each divided by its own grading and, where it is curved, placed
on its curve. Source: C. Greenshields, "OpenFOAM user guide", section "Mesh generation with blockMesh"; positions agree
with those of OpenFOAM's own program to round-off.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import FloatArray, Grid, Patch, Window
from meshdeform_core.memory import machine_memory, readable

from .curves import straight
from .cyclic import cyclic_connections
from .dictionary import read_dictionary
from .divisions import divide, reversed_grading
from .layout import HexBlock, Layout, read_layout

# Local vertices at the ends of the twelve edges: four along i, four along j, four along k.
_EDGES = ((0, 1), (3, 2), (7, 6), (4, 5), (0, 3), (1, 2), (5, 6), (4, 7), (0, 4), (1, 5), (2, 6), (3, 7))
# Bytes per node while nodes are generated, and number of nodes generated at a time.
_NODE_BYTES = 40
_AT_ONCE = 50_000
_TOLERANCE = 1e-3
"""Largest distance between the nodes of two blocks on a common edge, relative to the local spacing."""


def read_block_mesh(path: Path) -> Grid:
    """The blocks of a blockMeshDict with its patches, in metres (``convertToMeters`` and ``scale`` applied).

    Raises
    ------
    FormatError
        When the dictionary is damaged, uses what is not supported, or blocks do not fit together.
    """
    layout = read_layout(read_dictionary(path))
    shapes = [(a + 1, b + 1, c + 1) for a, b, c in (block.cells for block in layout.blocks)]
    _require_memory(path, sum(math.prod(shape) for shape in shapes))
    edges = [_edges(layout, block) for block in layout.blocks]
    _require_matching(layout, edges)
    grid = Grid.allocate(shapes, [block.name for block in layout.blocks], patches=_patches(layout), path=path)
    grid.fill(lambda b: _blend(grid.block(b), layout.vertices[list(layout.blocks[b].vertices)], edges[b], layout.scale))
    return cyclic_connections(grid, layout)


def _require_memory(path: Path, nodes: int) -> None:
    available = machine_memory()
    if nodes * _NODE_BYTES > available.size:
        raise FormatError(
            f"{path} describes {nodes:,} nodes, which take about {readable(nodes * _NODE_BYTES)}; "
            f"{available.source} {readable(available.size)}. Check the numbers of cells"
        )


def _edges(layout: Layout, block: HexBlock) -> list[tuple[FloatArray, FloatArray]]:
    """Parameters (n + 1,) and positions (n + 1, 3) of the nodes of the twelve edges."""
    found = []
    for number, (a, b) in enumerate(_EDGES):
        first, last = block.vertices[a], block.vertices[b]
        cells, grading = block.cells[number // 4], block.gradings[number]
        if (last, first) in layout.curves:
            backwards = divide(cells, reversed_grading(grading))
            found.append((1.0 - backwards[::-1], layout.curves[last, first](backwards)[::-1]))
        else:
            at = divide(cells, grading)
            curve = layout.curves.get((first, last)) or straight(layout.vertices[first], layout.vertices[last])
            found.append((at, curve(at)))
    return found


def _require_matching(layout: Layout, edges: Sequence[Sequence[tuple[FloatArray, FloatArray]]]) -> None:
    """Refuse blocks whose nodes differ from their neighbours' on a common edge: blockMesh joins blocks by vertices."""
    seen: dict[tuple[int, int], tuple[HexBlock, FloatArray]] = {}
    for block, own in zip(layout.blocks, edges, strict=True):
        for (a, b), (_, points) in zip(_EDGES, own, strict=True):
            first, last = block.vertices[a], block.vertices[b]
            if first == last:
                continue
            if first > last:
                first, last, points = last, first, points[::-1]
            other, known = seen.setdefault((first, last), (block, points))
            place = f"{layout.path}, line {block.line}: {block.name} and {other.name} (line {other.line})"
            if len(known) != len(points):
                raise FormatError(
                    f"{place} have {len(points) - 1} and {len(known) - 1} cells on their common edge {first} {last}; "
                    "expected equal numbers"
                )
            gap = np.linalg.norm(points - known, axis=1).max()
            if gap > _TOLERANCE * np.linalg.norm(np.diff(known, axis=0), axis=1).min():
                raise FormatError(
                    f"{place} divide their common edge {first} {last} differently (by up to {gap:.3g} before scaling);"
                    " expected the same grading"
                )


def _blend(
    out: FloatArray, corners: FloatArray, edges: Sequence[tuple[FloatArray, FloatArray]], scale: FloatArray
) -> None:
    """Fill a block ``out`` (ni, nj, nk, 3) from its corners (8, 3) and edges, a few layers along i at a time."""
    layers = max(_AT_ONCE // max(out.shape[1] * out.shape[2], 1), 1)
    for begin in range(0, len(out), layers):
        rows = slice(begin, begin + layers)
        total = np.zeros(out[rows].shape)
        for weight, position in _contributions(rows, corners, edges):
            total += weight[..., None] * position
        out[rows] = total * scale


def _contributions(
    rows: slice, corners: FloatArray, edges: Sequence[tuple[FloatArray, FloatArray]]
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Weights (ni, nj, nk) and positions of the edges, for some layers.

    The weights of the four edges of one direction add up to one. Straight edges count a third in each direction; the
    deviations of curved edges count in full.
    """
    at = [
        (values[rows] if number < 4 else values).reshape([-1 if axis == number // 4 else 1 for axis in range(3)])
        for number, (values, _) in enumerate(edges)
    ]
    for axis in range(3):
        own = range(4 * axis, 4 * axis + 4)
        weights = [_weight(at, number) for number in own]
        total = sum(weights)
        for number, weight in zip(own, weights, strict=True):
            first, last = (corners[vertex] for vertex in _EDGES[number])
            line = first + at[number][..., None] * (last - first)
            points = edges[number][1][rows] if axis == 0 else edges[number][1]
            yield weight / total, points.reshape(line.shape) - 2.0 / 3.0 * line


def _weight(at: Sequence[FloatArray], number: int) -> FloatArray:
    """The weight of an edge at the nodes: one at its own nodes, falling to zero at the opposite edges.

    At each of its ends it is the product of the parameters, towards that end, of the other two edges there.
    """
    total: FloatArray | float = 0.0
    for end, vertex in enumerate(_EDGES[number]):
        part = at[number] if end else 1.0 - at[number]
        for other, pair in enumerate(_EDGES):
            if other != number and vertex in pair:
                part = part * (at[other] if pair[1] == vertex else 1.0 - at[other])
        total = total + part
    return np.asarray(total)


def _patches(layout: Layout) -> tuple[Patch, ...]:
    """Patches under their names, which are their families, too."""
    found = []
    for patch in layout.patches:
        windows = []
        for block, side in patch.sides:
            a, b = (layout.blocks[block].cells[axis] for axis in side.tangential)
            windows.append(Window(block, side, (0, 0), (a, b)))
        if windows:
            found.append(Patch(patch.name, tuple(windows), patch.name, patch.type))
    return tuple(found)
