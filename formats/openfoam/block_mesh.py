"""blockMeshDict files, and the nodes that blockMesh generates from them.

Nodes inside a block are blended from its twelve edges, each divided by its own grading and, where it is curved, placed
on its curve. Source: C. Greenshields, "OpenFOAM user guide", section "Mesh generation with blockMesh"; positions agree
with those of OpenFOAM's own program to round-off.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

import numpy as np
import scipy

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Connection, FloatArray, Grid, Patch, Periodicity, Window
from meshdeform_core.grid.connections import periodic_image
from meshdeform_core.memory import machine_memory, readable
from meshdeform_core.numerics.geometry.coincidence import connected_components

from .block_mesh_dict import SIDE_VERTICES, BlockMeshDict, BlockSide, FoamPatch, HexBlock, Section, divide, straight

_CORNERS = ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1))
# Local vertices at the ends of the twelve edges: four along i, four along j, four along k.
_EDGES = ((0, 1), (3, 2), (7, 6), (4, 5), (0, 3), (1, 2), (5, 6), (4, 7), (0, 4), (1, 5), (2, 6), (3, 7))
# Bytes per node while nodes are generated, and number of nodes generated at a time.
_NODE_BYTES = 40
_AT_ONCE = 50_000
_TOLERANCE = 1e-3
"""Largest distance between the nodes of two blocks on a common edge, relative to the local spacing."""
_CYCLIC_TOLERANCE = 1e-5
"""Largest distance between the corner of a cyclic patch and its image, relative to the size of the patches."""

Edge = tuple[FloatArray, FloatArray]
"""Parameters (n + 1,) and positions (n + 1, 3) of the nodes of a block edge."""


def block_mesh(layout: BlockMeshDict) -> Grid:
    """The blocks with their patches, in metres (``convertToMeters`` and ``scale`` applied)."""
    shapes = [(a + 1, b + 1, c + 1) for a, b, c in (block.cells for block in layout.blocks)]
    nodes, available = sum(math.prod(shape) for shape in shapes), machine_memory()
    if nodes * _NODE_BYTES > available.size:
        raise FormatError(
            f"{layout.path} describes {nodes:,} nodes, which take about {readable(nodes * _NODE_BYTES)}; "
            f"{available.source} {readable(available.size)}. Check the numbers of cells"
        )
    edges = [list[Edge]() for _ in layout.blocks]
    for block, own in zip(layout.blocks, edges, strict=True):
        for number, (a, b) in enumerate(_EDGES):
            first, last = block.vertices[a], block.vertices[b]
            cells, grading = block.cells[number // 4], block.gradings[number]
            if (last, first) in layout.curves:
                # The grading as seen from the other end of the edge.
                turned = [Section(part.length, part.cells, 1.0 / part.ratio) for part in reversed(grading)]
                backwards = divide(cells, turned)
                own.append((1.0 - backwards[::-1], layout.curves[last, first](backwards)[::-1]))
            else:
                at = divide(cells, grading)
                curve = layout.curves.get((first, last)) or straight(layout.vertices[first], layout.vertices[last])
                own.append((at, curve(at)))
    _require_matching(layout, edges)
    names = [block.name for block in layout.blocks]
    # Patches have their names as families, too; some have no faces.
    patches = []
    for patch in layout.patches:
        windows = []
        for number, side in patch.sides:
            a, b = (layout.blocks[number].cells[axis] for axis in side.tangential)
            windows.append(Window(number, side, (0, 0), (a, b)))
        patches.append(Patch(patch.name, tuple(windows), patch.name, patch.type))
    connections, notes = _cyclic(layout)
    grid = Grid.allocate(
        shapes, names, patches=tuple(patches), connections=connections, notes=notes, path=layout.path,
        components=_regions(layout),
    )  # fmt: skip
    grid.fill(lambda b: _blend(grid.block(b), layout.vertices[list(layout.blocks[b].vertices)], edges[b], layout.scale))
    return grid


def _regions(layout: BlockMeshDict) -> tuple[str, ...]:
    """The component of each block where the blocks form several that no common side joins, such as rotor and stator;
    it has the name of the cell zone of its blocks, or a number."""
    region = connected_components(len(layout.blocks), np.array(layout.joined, dtype=np.int64).reshape(-1, 2)).tolist()
    if len(set(region)) == 1:
        return ()
    zones = {own: {block.zone for block, of in zip(layout.blocks, region, strict=True) if of == own} for own in region}
    alone = Counter(zone for found in zones.values() for zone in found)
    names = {
        own: zone if len(found) == 1 and (zone := next(iter(found))) and alone[zone] == 1 else f"region{number}"
        for number, (own, found) in enumerate(zones.items(), start=1)
    }
    return tuple(names[own] for own in region)


def _require_matching(layout: BlockMeshDict, edges: Sequence[Sequence[Edge]]) -> None:
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


def _blend(out: FloatArray, corners: FloatArray, edges: Sequence[Edge], scale: FloatArray) -> None:
    """Fill a block ``out`` (ni, nj, nk, 3) from its corners (8, 3) and edges, a few layers along i at a time.

    The position is the sum over the three axes of the weighted mean of the four edges along each, less two thirds of
    that of the straight lines in their place. The weight of an edge is one at its own nodes and falls to zero at the
    opposite edges.
    """
    layers = max(_AT_ONCE // max(out.shape[1] * out.shape[2], 1), 1)
    for begin in range(0, len(out), layers):
        rows = slice(begin, begin + layers)
        at = [
            (values[rows] if number < 4 else values).reshape([-1 if axis == number // 4 else 1 for axis in range(3)])
            for number, (values, _) in enumerate(edges)
        ]
        # Of each corner: the product of the parameters, towards it, of the three edges there.
        near = [
            math.prod(
                at[edge] if ends[1] == corner else 1.0 - at[edge] for edge, ends in enumerate(_EDGES) if corner in ends
            )
            for corner in range(8)
        ]
        weights = [near[first] + near[last] for first, last in _EDGES]
        found = np.zeros(out[rows].shape)
        for number, (first, last) in enumerate(_EDGES):
            own = 4 * (number // 4)
            line = corners[first] + at[number][..., None] * (corners[last] - corners[first])
            points = edges[number][1][rows] if own == 0 else edges[number][1]
            weight = np.asarray(weights[number] / sum(weights[own : own + 4]))
            found += weight[..., None] * (points.reshape(line.shape) - 2.0 / 3.0 * line)
        out[rows] = found * scale


def _cyclic(layout: BlockMeshDict) -> tuple[tuple[Connection, ...], tuple[str, ...]]:
    """The connections of cyclic patches, and a note for each pair whose faces do not fit."""
    patches = {patch.name: patch for patch in layout.patches}
    connections, notes, done = list[Connection](), list[str](), set[str]()
    for name, patch in patches.items():
        neighbour = patch.content.text("neighbourPatch") if patch.type == "cyclic" else ""
        if not neighbour or neighbour in done:
            continue
        done.add(name)
        other = patches.get(neighbour)
        if other is None or other.content.text("neighbourPatch") != name:
            raise FormatError(
                f"{layout.path}: cyclic patch {name} has the neighbour {neighbour}, which does not have it"
            )
        found = _cyclic_pairs(layout, patch, other)
        connections += found
        if not found and (patch.sides or other.sides):
            notes.append(f"{layout.path}: no motion maps cyclic patch {name} onto {neighbour}; they are not connected")
    return tuple(connections), tuple(notes)


def _cyclic_pairs(layout: BlockMeshDict, one: FoamPatch, two: FoamPatch) -> list[Connection]:
    """A connection for each block side of ``one``; none if any has no partner."""
    if len(one.sides) != len(two.sides) or not one.sides:
        return []
    vertices = layout.vertices * layout.scale
    corners = {(block, side): vertices[[layout.blocks[block].vertices[v] for v in SIDE_VERTICES[side]]]
               for block, side in (*one.sides, *two.sides)}  # fmt: skip
    # The rotation about the declared axis, else the translation, that maps one mean point onto the other.
    mean, image = (np.mean([corners[place] for place in patch.sides], axis=(0, 1)) for patch in (one, two))
    if one.content.text("transform") != "rotational" and "rotationAxis" not in one.content.entries:
        motion = Periodicity(translation=tuple((image - mean).tolist()))
    else:
        axis, center = (
            np.array(declared.point(key)) if (declared := one.content.reading(key)).more else np.array(default)
            for key, default in (("rotationAxis", (0.0, 0.0, 1.0)), ("rotationCentre", (0.0, 0.0, 0.0)))
        )
        axis = axis / max(float(np.linalg.norm(axis)), 1e-30)
        a, b = (x - center - ((x - center) @ axis) * axis for x in (mean, image))
        turn = scipy.spatial.transform.Rotation.from_rotvec(np.arctan2(np.cross(a, b) @ axis, a @ b) * axis)
        # Lower case: about the fixed axes x, y, z in turn.
        motion = Periodicity(*(tuple(values.tolist()) for values in (center, turn.as_euler("xyz", degrees=True))))
    size = float(np.ptp(np.concatenate(list(corners.values())), axis=0).max())
    found = []
    for number, own in enumerate(one.sides):
        for donor in two.sides:
            gaps = np.linalg.norm(periodic_image(corners[own], motion)[:, None] - corners[donor], axis=2)
            nearest = gaps.argmin(axis=1).tolist()
            if gaps.min(axis=1).max() <= _CYCLIC_TOLERANCE * size and len(set(nearest)) == 4:
                found.append(_cyclic_connection(layout, f"{one.name}-{number + 1}", own, donor, nearest, motion))
                break
    return found if len(found) == len(one.sides) else []


def _cyclic_connection(
    layout: BlockMeshDict, name: str, own: BlockSide, donor: BlockSide, image: Sequence[int], motion: Periodicity
) -> Connection:
    """The connection of two block sides, from the corners of the second that are the images of those of the first."""
    here, there = (
        np.array(_CORNERS)[list(SIDE_VERTICES[side])] * layout.blocks[block].cells for block, side in (own, donor)
    )
    there = there[list(image)]
    transform = [0, 0, 0]
    # The direction out of one side leads into the other.
    transform[own[1].axis] = own[1].into(donor[1])
    for corner in (1, 3):
        step = there[corner] - there[0]
        along = int(np.flatnonzero(step)[0])
        transform[int(np.flatnonzero(here[corner] - here[0])[0])] = (along + 1) * int(np.sign(step[along]))
    begin, end, first, last = (tuple(index.tolist()) for index in (here[0], here[2], there[0], there[2]))
    i, j, k = transform
    return Connection(name, own[0], begin, end, donor[0], first, last, (i, j, k), motion)
