"""Outside faces that nearly coincide with others, touch them with other nodes, or lie inside another block.

Nodes are never merged by proximity alone. Such faces therefore remain boundaries, and a motion would tear the grid.
Faces inside other blocks are those of overset grids, or of blocks that overlap by mistake: a solver for overset grids
interpolates there. Here it would count as a fixed boundary within the other block, and a motion would pull the two
blocks apart, unless they belong to different components.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..numerics.arrays import BoolArray, batches, runs, spans, spread
from ..numerics.geometry.boxes import overlapping_boxes
from ..numerics.geometry.coincidence import close_pairs, connected_components, distinct, equal_rows
from ..numerics.geometry.vectors import distance_to_faces, plane_winding, winding
from ..wording import counted, listed
from .blocks import FloatArray, Grid, IntArray
from .faces import Role, role_of_patch
from .parts import Side, Window
from .planes import FLATNESS, block_extents, plane_normal
from .topology import Topology, quads_of_patches, side_nodes
from .windows import largest_rectangles, rectangles

NEAR = 0.25
"""Nodes closer than this fraction of the shortest edge at either of them were probably meant to coincide."""
_ABUTTING = 0.1
"""A quad whose centre is closer to another face than this fraction of its shortest edge touches that face."""
_ROUND_OFF = 1e-9
_SAMPLES, _FEWEST = 48, 2
"""Quads of a side that are looked at, half as many for overlaps, and how many of them must touch another one or lie in
another block, ..."""
_PART = 0.1
"""... as a fraction of the samples, at least."""
_DEEP = 0.1
"""A quad is inside if its centre is farther from the other block's surface than this fraction of its longest edge."""
_COARSE = 12
"""Cells per direction of the coarse surface that rules out most blocks."""
_SOME, _SURE = 0.1, 0.9
_TOGETHER = 300_000
"""Samples compared at a time, which bounds the memory."""


@dataclass(frozen=True)
class Opening:
    """Outside quads of one block side that nearly coincide with those of another, or touch them.

    Attributes
    ----------
    quads : (n,) face quads of the side
    window : their nodes
    block, side, other, other_side : the two block sides
    gap : largest distance (grid length unit)
    relative : the same relative to the local edge
    matching : whether the nodes match one to one, so that a tolerance closes the gap
    """

    quads: IntArray
    window: Window
    block: int
    side: Side
    other: int
    other_side: Side
    gap: float
    relative: float
    matching: bool

    @property
    def tolerance(self) -> float | None:
        """The ``grid.tolerance`` that closes it, or ``None``."""
        return float(f"{1.05 * self.relative:.1e}") if self.matching else None

    def describe(self, grid: Grid) -> str:
        """One line: position, gap, and the tolerance that closes it."""
        one, two = f"{grid.names[self.block]}.{self.side.label}", f"{grid.names[self.other]}.{self.other_side.label}"
        where = f"{one}[{self.window.ranges}] ({counted(len(self.quads), 'quad')}) and {two}"
        if self.matching:
            return (
                f"{where} nearly coincide: the gap is up to {self.gap:.3g}, {self.relative:.2g} of the local edge; "
                f"grid.tolerance = {self.tolerance:g} closes it"
            )
        return f"{where} touch{_distance_phrase([self])}, but their nodes do not match (patched blocks)"

    @property
    def sides(self) -> tuple[tuple[int, Side], tuple[int, Side]]:
        """The two block sides."""
        return (self.block, self.side), (self.other, self.other_side)


@dataclass(frozen=True)
class Overlap:
    """Outside faces of one block side that lie inside another block.

    Attributes
    ----------
    quads : (n,) face quads of the side that are outside
    window : their nodes
    block, side, other : which side lies in which block
    share : fraction of the sampled quads that lies inside
    depth : largest distance of these from the surface of the other block (grid length unit)
    """

    quads: IntArray
    window: Window
    block: int
    side: Side
    other: int
    share: float
    depth: float
    matching: bool = False

    def describe(self, grid: Grid) -> str:
        """One line: where, how much of it, how deep."""
        face = f"{grid.names[self.block]}.{self.side.label}[{self.window.ranges}] ({counted(len(self.quads), 'quad')})"
        return (
            f"{face} lies inside {grid.names[self.other]}, {self.share:.0%} of it up to {self.depth:.3g} deep "
            f"(overset or overlapping blocks)"
        )


def patched_groups(openings: Sequence[Opening | Overlap]) -> list[list[Opening | Overlap]]:
    """Groups of openings: the patched faces of one surface, such as the plane between a rotor and a stator, form a
    group; each other opening is one by itself."""
    patched = [opening for opening in openings if isinstance(opening, Opening) and not opening.matching]
    number = {side: n for n, side in enumerate(dict.fromkeys(side for opening in patched for side in opening.sides))}
    pairs = [[number[side] for side in opening.sides] for opening in patched]
    label = connected_components(len(number), np.array(pairs, dtype=np.int64).reshape(-1, 2))
    groups: dict[int, list[Opening | Overlap]] = {}
    for n, opening in enumerate(openings):
        first = isinstance(opening, Opening) and not opening.matching
        key = int(label[number[opening.sides[0]]]) if first and isinstance(opening, Opening) else len(number) + n
        groups.setdefault(key, []).append(opening)
    return list(groups.values())


def describe_group(grid: Grid, group: Sequence[Opening | Overlap]) -> str:
    """One line for openings that belong together."""
    first, patched = group[0], [opening for opening in group if isinstance(opening, Opening)]
    sides = list(dict.fromkeys(side for opening in patched for side in opening.sides))
    if len(sides) <= 2:
        return first.describe(grid)
    names = listed(f"{grid.names[block]}.{side.label}" for block, side in sides)
    return (
        f"{len(sides)} faces touch each other{_distance_phrase(patched)}, but their nodes do not match (patched "
        f"blocks, for example a rotor and a stator): {names}"
    )


def _distance_phrase(openings: Sequence[Opening]) -> str:
    """A phrase with the distance of the faces if it exceeds round-off, else empty."""
    gap = max(opening.gap for opening in openings)
    return f", at most {gap:.3g} apart" if max(opening.relative for opening in openings) > _ROUND_OFF else ""


def find_openings(grid: Grid, topology: Topology) -> tuple[Opening | Overlap, ...]:
    """Outside faces that nearly coincide with others or lie inside other blocks, largest first.

    A pair of sides with matching nodes is listed once. Faces that the file declares as walls are left out, as the two
    sides of a thin wing are close to each other.
    """
    outside = np.flatnonzero(topology.external)
    if outside.size == 0:
        return ()
    paired, gap, relative = _near_partners(grid, topology, outside)
    near = [*_matching(grid, topology, paired, gap, relative), *_abutting(grid, topology, paired)]
    wall = declared_walls(grid, topology)
    found: list[Opening | Overlap] = [opening for opening in near if not wall[opening.quads].all()]
    found += find_overlaps(grid, topology)
    return tuple(sorted(found, key=lambda opening: -len(opening.quads)))


def declared_walls(grid: Grid, topology: Topology) -> BoolArray:
    """(n_quads,) whether a face quad belongs to a patch that the file declares as a wall."""
    wall = np.zeros(len(topology.partner), dtype=bool)
    walls = [patch for patch in grid.patches if role_of_patch(patch) is Role.WALL]
    wall[quads_of_patches(topology.quads, walls)[0]] = True
    return wall


def _near_partners(grid: Grid, topology: Topology, outside: IntArray) -> tuple[IntArray, FloatArray, FloatArray]:
    """(n_quads,) the outside quad with nearly the same corners, or -1; (n_unique,) the distances of the nodes, in
    length units and relative to the local edge.
    """
    corners = topology.quads.corners
    nodes = distinct(corners[outside], topology.n_unique)
    points, edge = grid.nodes.at(topology.first[nodes]), topology.edge[nodes]
    one, two = close_pairs(points, NEAR * edge).T
    part = grid.component_numbers[np.searchsorted(grid.offsets, topology.first[nodes], side="right") - 1]
    one, two = one[part[one] == part[two]], two[part[one] == part[two]]
    distance = np.linalg.norm(points[one] - points[two], axis=1)
    label = np.arange(topology.n_unique)
    # Interfaces have two sides; each pair is represented by its smaller number.
    np.minimum.at(label, nodes[np.maximum(one, two)], nodes[np.minimum(one, two)])
    gap, relative = np.zeros(topology.n_unique), np.zeros(topology.n_unique)
    for end in (one, two):
        np.maximum.at(gap, nodes[end], distance)
        np.maximum.at(relative, nodes[end], distance / np.minimum(edge[one], edge[two]))
    paired = np.full(len(corners), -1, dtype=topology.partner.dtype)
    # Without such nodes, outside quads with the same corners would be partners.
    near = np.zeros(topology.n_unique, dtype=bool)
    near[nodes[one]] = near[nodes[two]] = True
    outside = outside[near[corners[outside]].any(axis=1)] if near.any() else outside[:0]
    rows = np.sort(label[corners[outside]], axis=1)
    sound = (np.diff(rows, axis=1) > 0).sum(axis=1) >= min(2, rows.shape[1] - 1)
    partner, _ = equal_rows(rows[sound])
    quads = outside[sound]
    paired[quads] = np.where(partner >= 0, quads[partner], -1)
    return paired, gap, relative


def _matching(grid: Grid, topology: Topology, paired: IntArray, gap: FloatArray, relative: FloatArray) -> list[Opening]:
    near = np.flatnonzero(paired >= 0)
    own, other = (topology.quads.block_side[quads] for quads in (near, paired[near]))
    # Each pair of sides once, from the one with the lower number; within one side, each pair of quads once.
    chosen = (own < other) | ((own == other) & (near < paired[near]))
    label = np.full(len(paired), -1)
    label[near[chosen]] = other[chosen]
    found = []
    pieces = rectangles(grid, topology.quads, label)
    for number, window in enumerate(pieces.windows()):
        quads = pieces.quads_of(number)
        corners = topology.quads.corners[quads]
        worst = float(gap[corners].max()), float(relative[corners].max())
        partner = divmod(int(pieces.label[number]), 6)
        found.append(Opening(quads, window, window.block, window.side, partner[0], Side(partner[1]), *worst, True))
    return found


def _abutting(grid: Grid, topology: Topology, paired: IntArray) -> list[Opening]:
    """Block sides that touch others with non-matching nodes, found from samples of their quads."""
    rest = np.flatnonzero(topology.external & (paired < 0))
    if rest.size == 0:
        return []
    side = topology.quads.block_side[rest]
    first, last = runs(side)
    low, high = np.empty((2, len(first), 3))
    for lo, hi in batches(last - first, _TOGETHER):
        corners = _corner_points(grid, topology, rest[first[lo] : last[hi - 1]])
        low[lo:hi] = np.minimum.reduceat(corners.min(axis=1), first[lo:hi] - first[lo])
        high[lo:hi] = np.maximum.reduceat(corners.max(axis=1), first[lo:hi] - first[lo])
    some, start = _samples(grid, topology, rest, first, last, _SAMPLES)
    edges, middle = np.linalg.norm(some - np.roll(some, 1, axis=1), axis=2), some.mean(axis=1)
    edge = np.where(edges > 0, edges, np.inf).min(axis=1)
    slack = 1e-6 * np.linalg.norm(high - low, axis=1)[:, None]
    pairs = overlapping_boxes((low - slack, high + slack), (low, high))
    pairs = pairs[(pairs[:, 0] != pairs[:, 1]) & _same_component(grid, *(side[first] // 6)[pairs].T)]

    def inside_other(sample: IntArray, other: IntArray) -> BoolArray:
        x, reach = middle[sample], _ABUTTING * edge[sample, None]
        return np.asarray(((x >= low[other] - reach) & (x <= high[other] + reach)).all(axis=1))

    pieces: dict[int, tuple[Window, IntArray]] = {}
    found = []
    for own, other, within in _candidates(pairs, start, inside_other, lambda counts: np.full(len(counts), _FEWEST)):
        sample = slice(start[own], start[own + 1])
        distance = np.full(len(within), np.inf)
        faces = _corner_points(grid, topology, rest[first[other] : last[other]])
        distance[within] = distance_to_faces(middle[sample][within], faces)
        hit, relative = distance < _ABUTTING * edge[sample], distance / edge[sample]
        # Two walls that meet at a sharp edge are close to each other at a few quads only.
        if hit.sum() >= max(_FEWEST, 0.1 * len(within)):
            pieces = pieces or largest_rectangles(grid, topology.quads, rest)
            window, quads = pieces[int(side[first[own]])]
            two, gap = divmod(int(side[first[other]]), 6), (float(distance[hit].max()), float(relative[hit].max()))
            found.append(Opening(quads, window, window.block, window.side, two[0], Side(two[1]), *gap, False))
    return found


def _corner_points(grid: Grid, topology: Topology, quads: IntArray) -> FloatArray:
    """Coordinates (n, 4, 3), in 2-D (n, 2, 3), of the corners of face quads (n,)."""
    return np.asarray(grid.nodes.at(topology.first[topology.quads.corners[quads]]))


def _samples(
    grid: Grid, topology: Topology, quads: IntArray, first: IntArray, last: IntArray, most: int
) -> tuple[FloatArray, IntArray]:
    """Corners of up to ``most`` of the ``quads`` of each side, which begin at ``first`` and end at ``last``, and the
    number of the first sample of each side."""
    run, place = spread(last - first, most)
    start = np.append(0, np.cumsum(np.bincount(run, minlength=len(first))))
    return _corner_points(grid, topology, quads[first[run] + place]), start


def _same_component(grid: Grid, one: IntArray, two: IntArray) -> BoolArray:
    """Whether pairs of blocks belong to one component."""
    return np.asarray(grid.component_numbers[one] == grid.component_numbers[two])


def _candidates(
    pairs: IntArray,
    start: IntArray,
    inside: Callable[[IntArray, IntArray], BoolArray],
    least: Callable[[IntArray], FloatArray | IntArray],
) -> Iterator[tuple[int, int, BoolArray]]:
    """Those of the ``pairs`` (p, 2) of which enough samples of the first are ``inside`` the box of the second, and
    which samples; ``start`` is the first sample of each, ``least`` how many of so many are enough."""
    counts = np.diff(start)[pairs[:, 0]]
    for lo, hi in batches(counts, _TOGETHER):
        some, (run, place) = pairs[lo:hi], spans(counts[lo:hi])
        within = inside(start[some[run, 0]] + place, some[run, 1])
        ends = np.append(0, np.cumsum(counts[lo:hi]))
        enough = np.bincount(run, weights=within, minlength=len(some)) >= least(counts[lo:hi])
        for number in np.flatnonzero(enough):
            yield int(some[number, 0]), int(some[number, 1]), within[ends[number] : ends[number + 1]]


def find_overlaps(grid: Grid, topology: Topology) -> list[Overlap]:
    """Outside faces inside other blocks, found from samples of the quads of each block side."""
    outside = np.flatnonzero(topology.external)
    if outside.size == 0:
        return []
    side = topology.quads.block_side[outside]
    first, last = runs(side)
    corners, start = _samples(grid, topology, outside, first, last, _SAMPLES // 2)
    middle, block = corners.mean(axis=1), side[first] // 6
    low, high = block_extents(grid)
    # A 2-D grid is plane only up to the precision of its file.
    slack = FLATNESS * float((high.max(axis=0) - low.min(axis=0)).max())
    own_box = np.minimum.reduceat(middle, start[:-1]), np.maximum.reduceat(middle, start[:-1])
    pairs = overlapping_boxes(own_box, (low - slack, high + slack))
    pairs = pairs[(block[pairs[:, 0]] != pairs[:, 1]) & _same_component(grid, block[pairs[:, 0]], pairs[:, 1])]

    def inside_other(sample: IntArray, other: IntArray) -> BoolArray:
        x = middle[sample]
        return np.asarray(((x > low[other]) & (x < high[other]) | (low[other] == high[other])).all(axis=1))

    def least(counts: IntArray) -> FloatArray:
        return np.maximum(_FEWEST, _PART * counts)

    pieces: dict[int, tuple[Window, IntArray]] = {}
    surfaces: dict[int, _Surface] = {}
    normal, found = plane_normal(grid), []
    for own, other, within in _candidates(pairs, start, inside_other, least):
        sample = slice(start[own], start[own + 1])
        if other not in surfaces:
            surfaces[other] = _Surface(grid, other, normal)
        depth = surfaces[other].depth(corners[sample][within], middle[sample][within])
        deep = int((depth > 0).sum())
        if deep >= least(np.array(len(within))):
            pieces = pieces or largest_rectangles(grid, topology.quads, outside)
            window, quads = pieces[int(side[first[own]])]
            share = float(deep / len(within))
            found.append(Overlap(quads, window, window.block, window.side, other, share, float(depth.max())))
    return found


def coincident_blocks(grid: Grid, topology: Topology) -> list[str]:
    """A message for each block all of whose face nodes are those of an earlier one: both lie in the same place."""
    if grid.n_blocks == 1:
        return []
    corners, first = topology.quads.corners, topology.quads.start[:, 0]
    # Equal sums and sums of squares of their unique numbers rule out nearly all other pairs.
    sums = np.zeros((2, grid.n_blocks), dtype=np.int64)
    for column in corners.T:
        sums[0] += np.add.reduceat(column, first, dtype=np.int64)
        sums[1] += np.add.reduceat(np.multiply(column, column, dtype=np.int64), first)
    _, group = np.unique(sums.T, axis=0, return_inverse=True)
    earlier: dict[int, list[int]] = {}
    pairs = []
    for block in np.flatnonzero(np.bincount(group.ravel())[group.ravel()] > 1).tolist():
        nodes = _face_numbers(topology, block)
        candidates = earlier.setdefault(int(group.ravel()[block]), [])
        pairs += [(one, block) for one in candidates if np.array_equal(_face_numbers(topology, one), nodes)][:1]
        candidates.append(block)
    return [
        f"blocks {grid.names[one]!r} and {grid.names[two]!r} lie in the same place: all their faces coincide, so that "
        f"none of them is an outside face; remove one of the blocks, or assign them to components ([grid] components)"
        for one, two in pairs
    ]


def _face_numbers(topology: Topology, block: int) -> IntArray:
    """Unique numbers of the nodes on the faces of a block, ascending."""
    first = topology.quads.start[block, 0]
    count = int(topology.quads.counts[block].prod(axis=1).sum())
    return np.unique(topology.quads.corners[first : first + count])


class _Surface:
    """The closed surface of a block: a coarse one for a first test, and the exact one."""

    def __init__(self, grid: Grid, block: int, normal: FloatArray | None):
        self._grid, self._block, self._normal = grid, block, normal
        # The sides of this axis are wound the other way round; see _wound_outwards.
        shape = grid.shapes[block]
        self._second = 1 if self._normal is None else max(axis for axis in range(3) if shape[axis] > 1)
        self._coarse = self._faces(_COARSE)
        self._fine: FloatArray | None = None

    def depth(self, corners: FloatArray, middle: FloatArray) -> FloatArray:
        """Depth (k,) of the centres of quads below the block's surface; 0 outside and close to it."""
        depth = np.zeros(len(middle))
        some = np.flatnonzero(self._winding(self._coarse, middle) > _SOME)
        if some.size == 0:
            return depth
        if self._fine is None:
            self._fine = self._faces(None)
        sure = some[self._winding(self._fine, middle[some]) > _SURE]
        if sure.size:
            distance = distance_to_faces(middle[sure], self._fine)
            longest = np.linalg.norm(corners[sure] - np.roll(corners[sure], 1, axis=1), axis=2).max(axis=1)
            depth[sure] = np.where(distance > _DEEP * longest, distance, 0.0)
        return depth

    def _winding(self, faces: FloatArray, places: FloatArray) -> FloatArray:
        if self._normal is not None:
            return np.abs(plane_winding(faces[:, 0], faces[:, 1], self._normal, places))
        points = faces.reshape(-1, 3)
        at = np.arange(0, len(points), 4)[:, None]
        return np.abs(winding(points, np.concatenate([at + [0, 1, 2], at + [2, 3, 0]]), places))

    def _faces(self, cells: int | None) -> FloatArray:
        """Corners (m, 4, 3) of the faces, in 2-D (m, 2, 3), all wound alike; at most ``cells`` per direction."""
        grid, found = self._grid, []
        for side in Side:
            if grid.shapes[self._block][side.axis] == 1:
                continue
            nodes = side_nodes(grid, self._block, side)
            for axis in (0, 1):
                n = nodes.shape[axis]
                if cells is not None and n > cells + 1:
                    nodes = np.take(nodes, np.unique(np.linspace(0, n - 1, cells + 1).round().astype(int)), axis=axis)
            found.append(_wound_outwards(grid.points[nodes], side, self._second))
        return np.concatenate(found)


def _wound_outwards(x: FloatArray, side: Side, second: int) -> FloatArray:
    """Corners of the quads of a side (na, nb, 3), wound so that all sides have outward normals, or all inward ones.

    The tangential axes ascend: (j, k), (i, k), (i, j); the second pair is not cyclic. In 2-D the sides of the first
    axis and those of the second are wound differently.
    """
    if 1 in x.shape[:2]:
        line = x.reshape(-1, 3)
        faces = np.stack([line[:-1], line[1:]], axis=1)
    else:
        faces = np.stack([x[:-1, :-1], x[1:, :-1], x[1:, 1:], x[:-1, 1:]], axis=2).reshape(-1, 4, 3)
    reverse = (side % 2 == 0) != (side.axis == second)
    return faces[:, ::-1] if reverse else faces
