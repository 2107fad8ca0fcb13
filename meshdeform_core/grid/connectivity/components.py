"""Components of an overset grid: groups of blocks that may overlap each other and have no node in common."""

from __future__ import annotations

import dataclasses
import fnmatch
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...errors import CaseError, suggestion
from ...numerics.arrays import BoolArray, FloatArray, IntArray
from ...numerics.geometry.coincidence import distinct, equal_rows
from ...numerics.geometry.copies import coincident_groups
from ...parallel import Part, alike, empty
from ...wording import listed
from ..blocks import Grid
from ..near import NearNodes
from ..topology import RELATIVE_TOLERANCE, FaceQuads, Topology, quads_of_patches

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


@dataclass(frozen=True, eq=False, repr=False)
class Component:
    """One component as a grid of its own.

    Attributes
    ----------
    name : of the component
    blocks : (n,) its blocks in the whole grid, ascending
    grid, topology : of these blocks
    numbers : (n_unique,) its unique nodes in the whole grid, ascending
    quads : (n_quads,) its face quads in the whole grid, ascending
    """

    name: str
    blocks: IntArray
    grid: Grid
    topology: Topology
    numbers: IntArray
    quads: IntArray

    def rows(self, whole: Grid, values: FloatArray) -> FloatArray:
        """The component's rows of ``values`` (n_nodes, 3) of the whole grid, in parts if it is."""
        return _copied(self.grid, lambda block: whole.in_planes(int(self.blocks[block]), values))


def assembled(whole: Grid, parts: Sequence[tuple[Component, FloatArray]]) -> FloatArray:
    """Values (n_nodes, 3) of the whole grid from those of all of its components."""
    places = {int(b): (part, n) for part in parts for n, b in enumerate(part[0].blocks)}

    def planes(number: int) -> FloatArray:
        (component, values), place = places[number]
        return component.grid.in_planes(place, values)

    return _copied(whole, planes)


def _copied(grid: Grid, planes: Callable[[int], FloatArray]) -> FloatArray:
    """A new array (n_nodes, 3) filled with the values ``planes(b)`` (i, nj, nk, 3) of this rank's planes of every
    block of a grid."""
    found: FloatArray = alike(grid.points)
    for number in range(grid.n_blocks):
        grid.in_planes(number, found)[...] = planes(number)
    if isinstance(found, Part):
        found.keep_like(grid.points)
    return found


def split(grid: Grid, topology: Topology) -> tuple[Component, ...]:
    """The components of a grid, in the order of their first blocks; empty if the grid is not divided."""
    if not grid.component_numbers.any():
        return ()
    names = list(dict.fromkeys(grid.components))
    return tuple(_component(grid, topology, name, number) for number, name in enumerate(names))


def _component(grid: Grid, topology: Topology, name: str, number: int) -> Component:
    member = grid.component_numbers == number
    blocks = np.flatnonzero(member)
    alone = _alone(grid, blocks)
    quads, faces = np.flatnonzero(member[topology.quads.block_side // 6]), topology.quads
    own = np.flatnonzero(member[_blocks_of(grid, topology.face_nodes)])
    numbers = np.unique(topology.number[own])
    sizes = faces.counts[blocks].prod(axis=2)
    within = FaceQuads(
        (np.cumsum(sizes) - sizes.ravel()).reshape(sizes.shape),
        faces.counts[blocks],
        np.searchsorted(numbers, faces.corners[quads]).astype(topology.number.dtype),
        faces.in_order[blocks],
    )
    partner = topology.partner[quads]
    own_topology = Topology(
        _local(grid, alone, blocks, topology.face_nodes[own]),
        np.searchsorted(numbers, topology.number[own]).astype(topology.number.dtype),
        _local(grid, alone, blocks, topology.first[numbers]),
        topology.edge[numbers],
        within,
        np.where(partner >= 0, np.searchsorted(quads, partner), partner).astype(partner.dtype),
        topology.handedness[blocks],
        0,
    )
    return Component(name, blocks, alone, own_topology, numbers, quads)


def _alone(grid: Grid, blocks: IntArray) -> Grid:
    """Some blocks, ascending, as a grid of their own; of a grid in parts, every rank holds what it held before."""
    shapes, names = tuple(grid.shapes[b] for b in blocks), tuple(grid.names[b] for b in blocks)
    sizes, points = np.prod(shapes, axis=1), grid.points
    rows: FloatArray
    if isinstance(points, Part):
        bounds = np.clip(points.bounds[:, None] - grid.offsets[blocks], 0, sizes).sum(axis=1)
        rows = Part(points.ranks, bounds, (int(sizes.sum()), 3), np.float64)
    else:
        rows = empty((int(sizes.sum()), 3))
    alone = Grid(rows, shapes, names, format=grid.format, path=grid.path)
    for number, block in enumerate(blocks.tolist()):
        alone.in_planes(number)[...] = grid.in_planes(block)
    if isinstance(rows, Part):
        rows.keep(NearNodes.of(shapes, alone.offsets))
    return alone


def _blocks_of(grid: Grid, flat: IntArray) -> IntArray:
    return np.searchsorted(grid.offsets, flat, side="right") - 1


def _local(grid: Grid, alone: Grid, blocks: IntArray, flat: IntArray) -> IntArray:
    """Flat indices in ``alone``, the grid of ``blocks`` only, of nodes ``flat`` of the whole grid."""
    block = _blocks_of(grid, flat)
    return np.asarray(flat - grid.offsets[block] + alone.offsets[np.searchsorted(blocks, block)])


def require_apart(grid: Grid, topology: Topology) -> None:
    """Refuse components that share block faces other than declared patches: a motion would tear the grid there.

    Raises
    ------
    CaseError
        Naming two of the blocks.
    """
    alone = topology.external.copy()
    alone[quads_of_patches(topology.quads, grid.patches)[0]] = False
    outside = np.flatnonzero(alone)
    nodes = distinct(topology.quads.corners[outside], topology.n_unique)
    label = np.zeros(topology.n_unique, dtype=np.int64)
    tolerance = RELATIVE_TOLERANCE * topology.edge[nodes]
    label[nodes] = coincident_groups(grid.points[topology.first[nodes]], tolerance)
    corners = label[topology.quads.corners[outside]]
    partner, _ = equal_rows(np.sort(corners, axis=1))
    two = np.flatnonzero(partner >= 0)
    block = topology.quads.block_side[outside] // 6
    two = two[grid.component_numbers[block[two]] != grid.component_numbers[block[partner[two]]]]
    two = two[_opposite(corners[two], corners[partner[two]])]
    if two.size:
        pair = block[two[0]], block[partner[two[0]]]
        names, components = ([of[b] for b in pair] for of in (grid.names, grid.components))
        raise CaseError(
            f"grid.components: blocks {names[0]} of {components[0]!r} and {names[1]} of {components[1]!r} are "
            f"neighbours with common faces ({len(two) // 2} between components in all), at which a motion would tear "
            f"the grid; expected such blocks in one component"
        )


def _opposite(one: IntArray, two: IntArray) -> BoolArray:
    """Whether quads with the same corners (n, c) are wound in opposite directions, as those of two neighbours are."""
    count, row = one.shape[1], np.arange(len(one))
    start = (two == one[:, :1]).argmax(axis=1)
    return np.asarray(two[row, (start - 1) % count] == one[:, 1])
