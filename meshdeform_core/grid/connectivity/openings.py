"""Outside faces that nearly coincide with others, or touch them with other nodes; for overlaps see :mod:`.overset`.

Nodes are never merged by proximity alone. Such faces therefore remain boundaries, and a motion would tear the grid.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...numerics.arrays import BoolArray, batches, runs, spans, spread
from ...numerics.geometry.boxes import overlapping_boxes
from ...numerics.geometry.coincidence import close_pairs, connected_components, distinct, equal_rows
from ...numerics.geometry.vectors import distance_to_faces
from ...wording import counted, listed
from ..blocks import FloatArray, Grid, IntArray
from ..faces.roles import Role, role_of_patch
from ..parts import Side, Window
from ..topology import Topology, quads_of_patches
from ..windows import largest_rectangles, rectangles
from .overset import Overlap, find_overlaps

NEAR = 0.25
"""Nodes closer than this fraction of the shortest edge at either of them were probably meant to coincide."""
_ABUTTING = 0.1
"""A quad whose centre is closer to another face than this fraction of its shortest edge touches that face."""
_ROUND_OFF = 1e-9
_SAMPLES = 48
_FEWEST = 2
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
        return f"{where} touch{_apart([self])}, but their nodes do not match (patched blocks)"

    @property
    def sides(self) -> tuple[tuple[int, Side], tuple[int, Side]]:
        """The two block sides."""
        return (self.block, self.side), (self.other, self.other_side)


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
        f"{len(sides)} faces touch each other{_apart(patched)}, but their nodes do not match (patched blocks, for "
        f"example a rotor and a stator): {names}"
    )


def _apart(openings: Sequence[Opening]) -> str:
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
    walls = _Walls.of(grid, topology, rest)
    pieces: dict[int, tuple[Window, IntArray]] = {}
    found = []
    for own, other in walls.candidates():
        touching, gap, relative = walls.touching(own, other)
        if touching >= _FEWEST:
            pieces = pieces or largest_rectangles(grid, topology.quads, rest)
            window, quads = pieces[int(walls.side[own])]
            block, side = divmod(int(walls.side[other]), 6)
            found.append(Opening(quads, window, window.block, window.side, block, Side(side), gap, relative, False))
    return found


@dataclass(frozen=True)
class _Walls:
    """Face quads ordered by block side, and samples of them.

    Attributes
    ----------
    grid, topology : to which they belong
    side : (m,) block sides
    quads : (n,) of all sides
    start : (m + 1,) first quad of each
    low, high : (m, 3) their extent
    middle, edge : (k, 3), (k,) of the samples: mean of the corners, shortest edge
    sample : (m + 1,) first sample of each side
    """

    grid: Grid
    topology: Topology
    side: IntArray
    quads: IntArray
    start: IntArray
    low: FloatArray
    high: FloatArray
    middle: FloatArray
    edge: FloatArray
    sample: IntArray

    @classmethod
    def of(cls, grid: Grid, topology: Topology, quads: IntArray) -> _Walls:
        side = topology.quads.block_side[quads]
        first, last = runs(side)
        low, high = np.empty((2, len(first), 3))
        for lo, hi in batches(last - first, _TOGETHER):
            corners = _corners(grid, topology, quads[first[lo] : last[hi - 1]])
            low[lo:hi] = np.minimum.reduceat(corners.min(axis=1), first[lo:hi] - first[lo])
            high[lo:hi] = np.maximum.reduceat(corners.max(axis=1), first[lo:hi] - first[lo])
        run, place = spread(last - first, _SAMPLES)
        some = _corners(grid, topology, quads[first[run] + place])
        edges = np.linalg.norm(some - np.roll(some, 1, axis=1), axis=2)
        edge = np.where(edges > 0, edges, np.inf).min(axis=1)
        sample = np.append(0, np.cumsum(np.bincount(run)))
        start, middle = np.append(first, len(quads)), some.mean(axis=1)
        return cls(grid, topology, side[first], quads, start, low, high, middle, edge, sample)

    def candidates(self) -> IntArray:
        """Pairs (p, 2) of different sides where enough samples of the first lie in the bounding box of the second."""
        slack = 1e-6 * np.linalg.norm(self.high - self.low, axis=1)[:, None]
        pairs = overlapping_boxes((self.low - slack, self.high + slack), (self.low, self.high))
        part = self.grid.component_numbers[self.side[pairs] // 6]
        pairs = pairs[(pairs[:, 0] != pairs[:, 1]) & (part[:, 0] == part[:, 1])]
        counts = np.diff(self.sample)[pairs[:, 0]]
        enough = [self._within(pairs[lo:hi], counts[lo:hi]) >= _FEWEST for lo, hi in batches(counts, _TOGETHER)]
        return pairs[np.concatenate([np.empty(0, dtype=bool), *enough])]

    def _within(self, pairs: IntArray, counts: IntArray) -> IntArray:
        """(p,) number of samples of the first side of each pair that lie in the bounding box of the second."""
        run, place = spans(counts)
        own, other = pairs[run].T
        return np.bincount(run[self._inside(self.sample[own] + place, other)], minlength=len(pairs))

    def _inside(self, sample: IntArray, other: IntArray) -> BoolArray:
        """Which samples lie in the bounding boxes of the sides ``other``."""
        middle, slack = self.middle[sample], _ABUTTING * self.edge[sample, None]
        within = (middle >= self.low[other] - slack) & (middle <= self.high[other] + slack)
        return np.asarray(within.all(axis=1))

    def touching(self, own: int, other: int) -> tuple[int, float, float]:
        """Number of samples of one side on quads of another; their largest distance, also relative to the edge."""
        sample = np.arange(self.sample[own], self.sample[own + 1])
        edge = self.edge[sample]
        inside = self._inside(sample, np.full(len(sample), other))
        distance = np.full(len(sample), np.inf)
        faces = _corners(self.grid, self.topology, self.quads[self.start[other] : self.start[other + 1]])
        distance[inside] = distance_to_faces(self.middle[sample[inside]], faces)
        hit = distance < _ABUTTING * edge
        # Two walls that meet at a sharp edge are close to each other at a few quads only.
        if hit.sum() < max(_FEWEST, 0.1 * len(sample)):
            return 0, 0.0, 0.0
        return int(hit.sum()), float(distance[hit].max()), float((distance / edge)[hit].max())


def _corners(grid: Grid, topology: Topology, quads: IntArray) -> FloatArray:
    """Coordinates (n, 4, 3), in 2-D (n, 2, 3), of the corners of face quads (n,)."""
    return np.asarray(grid.nodes.at(topology.first[topology.quads.corners[quads]]))
