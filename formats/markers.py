"""What unstructured formats have in common: numbers of points, outside faces in named groups, periodic pairs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.errors import GridError
from meshdeform_core.grid import BoolArray, FloatArray, Grid, IntArray, Patch, Periodicity, Side
from meshdeform_core.grid.connections import connected_nodes, periodic_rotation
from meshdeform_core.grid.topology import Topology, quads_of_patches
from meshdeform_core.numerics.geometry.coincidence import equal_rows


@dataclass(frozen=True)
class Marker:
    """A named group of outside faces.

    Attributes
    ----------
    quads : (n,) face quads of the topology, ascending unless it is one side of a pair
    patch : the first declaration that it comes from; ``None`` where the file has no name for the faces
    partner : name of the marker that a periodic motion maps it onto, or that is mapped onto it; else empty
    motion : the motion from this marker to its partner, as of its first side
    """

    name: str
    quads: IntArray
    patch: Patch | None = None
    partner: str = ""
    motion: Periodicity | None = None


def find_markers(grid: Grid, topology: Topology) -> list[Marker]:
    """The outside faces by family, patch (without a family) or block face (without a patch), in the file's order.

    Faces that a declared periodic connection pairs are markers of their own, the second in the order of the first. They
    keep the name of their family if it has no other faces; else they come last. Patches that the file declares without
    faces are markers without quads.
    """
    # The names of families, patches and block faces, the first patch of each, and the number of every face quad's name.
    first: dict[str, Patch | None] = {}
    for patch in grid.patches:
        first.setdefault(patch.family or patch.name, patch)
    sides = [f"{name}.{side.label}" for name in grid.names for side in Side]
    for side_name in sides:
        first.setdefault(side_name, None)
    names, patches = list(first), list(first.values())
    index = {name: number for number, name in enumerate(names)}
    group = np.array([index[name] for name in sides], dtype=np.int64)[topology.quads.block_side]
    quads_with_patch, of_patch = quads_of_patches(topology.quads, grid.patches)
    families = np.array([index[each.family or each.name] for each in grid.patches], dtype=np.int64)
    group[quads_with_patch] = families[of_patch]
    group[~topology.external] = -1
    pairs = _pairs(grid, topology, np.where([patch is None for patch in patches], -1, np.arange(len(names)))[group])
    taken = set(names)
    markers: list[Marker] = []
    for own, donor, motion in pairs:
        labels = [_label(names, group, quads, taken, part) for quads, part in ((own, ""), (donor, "_donor"))]
        if labels[0] == labels[1]:
            labels = [f"{labels[0]}_1", f"{labels[0]}_2"]
        declared = [patches[group[quads[0]]] for quads in (own, donor)]
        markers.append(Marker(labels[0], own, declared[0], labels[1], motion))
        markers.append(Marker(labels[1], donor, declared[1], labels[0]))
    for own, donor, _ in pairs:
        group[own] = group[donor] = -1
    order = np.argsort(group, kind="stable")
    ends = np.searchsorted(group[order], np.arange(len(names) + 1))
    paired = {marker.name for marker in markers}
    markers += [
        Marker(name, order[a:b], patch)
        for name, patch, a, b in zip(names, patches, ends[:-1], ends[1:], strict=True)
        if (b > a or (patch is not None and not patch.windows)) and name not in paired
    ]
    return sorted(markers, key=lambda marker: index.get(marker.name, len(names)))


def _label(names: list[str], group: IntArray, quads: IntArray, taken: set[str], part: str) -> str:
    """The name of one side of a pair: its family's if that has no other faces, else a new one."""
    numbers = np.unique(group[quads])
    if len(numbers) == 1 and numbers[0] >= 0 and (group == numbers[0]).sum() == len(quads):
        return names[numbers[0]]
    count = 1
    while f"periodic{count}{part}" in taken:
        count += 1
    taken.add(f"periodic{count}{part}")
    return f"periodic{count}{part}"


def _pairs(grid: Grid, topology: Topology, group: IntArray) -> list[tuple[IntArray, IntArray, Periodicity]]:
    """Outside quads on both sides of the periodic connections, a pair of arrays for each motion and pair of patches;
    ``group`` (n_quads,) is the number of the patch of each."""
    free = topology.external.copy()
    found: list[tuple[FloatArray, Periodicity, list[tuple[IntArray, IntArray]]]] = []
    for connection in grid.connections:
        if connection.periodic is None:
            continue
        try:
            one, two = (topology.numbers_of(flat) for flat in connected_nodes(grid, connection))
        except GridError:
            # The set-up warns about ranges outside their block.
            continue
        own, donor = _paired(topology, free, one, two)
        if own.size == 0:
            continue
        free[own] = free[donor] = False
        of_patches = [
            own_group[0] if (own_group == own_group[0]).all() else -1 for own_group in (group[own], group[donor])
        ]
        # Numbers that are equal for equal motions: rotation, and translation relative to its size.
        shift = np.array(connection.periodic.translation)
        scale = max(float(np.abs(shift).max()), 1e-300)
        key = np.concatenate([periodic_rotation(connection.periodic).ravel(), shift / scale, of_patches])
        parts = next((parts for known, _, parts in found if np.allclose(known, key, rtol=0, atol=1e-9)), None)
        if parts is None:
            found.append((key, connection.periodic, [(own, donor)]))
        else:
            parts.append((own, donor))
    return [(np.concatenate([p for p, _ in parts]), np.concatenate([q for _, q in parts]), motion)
            for _, motion, parts in found]  # fmt: skip


def _paired(topology: Topology, free: BoolArray, one: IntArray, two: IntArray) -> tuple[IntArray, IntArray]:
    """Quads whose corners are all in ``one``, and those of their images in ``two``."""
    image = np.full(topology.n_unique, -1, dtype=np.int64)
    image[one] = two
    corners = topology.quads.corners
    quads = np.flatnonzero(free & (image[corners] >= 0).all(axis=1))
    candidates = np.flatnonzero(free)
    rows = np.sort(np.concatenate([image[corners[quads]], corners[candidates]]), axis=1)
    partner, _ = equal_rows(rows)
    partner = partner[: len(quads)] - len(quads)
    matched = partner >= 0
    own, donor = quads[matched], candidates[partner[matched]]
    # A quad is not its own image, and belongs to one side only.
    distinct = (own != donor) & ~np.isin(donor, own)
    return own[distinct], donor[distinct]


def point_numbers(grid: Grid, topology: Topology) -> tuple[NDArray[Any], IntArray]:
    """The point of every block node (n_nodes,), and the block node of every point (n_points,)."""
    number = np.full(grid.n_nodes, -1, dtype=np.int64)
    number[topology.face_nodes] = topology.number
    interior = np.flatnonzero(number < 0)
    number[interior] = topology.n_unique + np.arange(len(interior))
    return number, np.concatenate([topology.first, interior])
