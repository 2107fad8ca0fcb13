"""Outside faces that nearly coincide with others, touch them with other nodes, or lie inside another block.

Nodes are never merged by proximity alone. Such faces therefore remain boundaries, and a motion would tear the grid.
Faces inside other blocks are those of overset grids, or of blocks that overlap by mistake: a solver for overset grids
interpolates there. Here it would count as a fixed boundary within the other block, and a motion would pull the two
blocks apart, unless they belong to different components.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, partial
from itertools import pairwise

import numpy as np

from ..numerics.arrays import batches, runs, spans, spread
from ..numerics.geometry.boxes import Boxes, overlapping_boxes
from ..numerics.geometry.coincidence import close_pairs, distinct, equal_rows
from ..numerics.geometry.vectors import distance_to_faces, plane_winding, winding
from ..wording import counted, listed
from .blocks import FloatArray, Grid, IntArray
from .faces import Role, role_of_patch
from .parts import Side, Window
from .planes import FLATNESS, block_extents, plane_normal
from .topology import Topology, quads_of_patches
from .windows import rectangles

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
    """Outside quads of one block side that nearly coincide with those of another, touch them, or lie in another block.

    Attributes
    ----------
    quads : (n,) face quads of the side
    window : their nodes
    other, other_side : the other block and its side; no side if the quads lie inside the block
    gap : largest distance from the other side, or depth in the other block (grid length unit)
    relative : the same relative to the local edge; of quads inside the other block, their fraction of those sampled
    matching : whether the nodes match one to one, so that a tolerance closes the gap
    """

    quads: IntArray
    window: Window
    other: int
    other_side: Side | None
    gap: float
    relative: float
    matching: bool

    @property
    def inside(self) -> bool:
        """Whether the quads lie inside the other block."""
        return self.other_side is None

    @property
    def tolerance(self) -> float | None:
        """The ``grid.tolerance`` that closes it, or ``None``."""
        return float(f"{1.05 * self.relative:.1e}") if self.matching else None

    def describe(self, grid: Grid) -> str:
        """One line: position, gap, and the tolerance that closes it."""
        side, other = f"{grid.names[self.window.block]}.{self.window.side.label}", grid.names[self.other]
        where = f"{side}[{self.window.ranges}] ({counted(len(self.quads), 'quad')})"
        if self.other_side is None:
            return (
                f"{where} lies inside {other}, {self.relative:.0%} of it up to {self.gap:.3g} deep "
                f"(overset or overlapping blocks)"
            )
        where += f" and {other}.{self.other_side.label}"
        if self.matching:
            return (
                f"{where} nearly coincide: the gap is up to {self.gap:.3g}, {self.relative:.2g} of the local edge; "
                f"grid.tolerance = {self.tolerance:g} closes it"
            )
        return f"{where} touch{_distance_phrase([self])}, but their nodes do not match (patched blocks)"


def describe_openings(grid: Grid, openings: Sequence[Opening], advice: str = "") -> list[str]:
    """A line for each opening, one for all faces that touch others with other nodes; ``advice`` is added to those of
    faces inside other blocks."""
    patched = [each for each in openings if not (each.matching or each.inside)]
    lines = [each.describe(grid) + advice * each.inside for each in openings if each.matching or each.inside]
    ends = [((o.window.block, o.window.side), (o.other, o.other_side)) for o in patched]
    sides = {f"{grid.names[block]}.{side.label}": None for pair in ends for block, side in pair if side is not None}
    if len(sides) > 2:
        lines.append(
            f"{len(sides)} faces touch each other{_distance_phrase(patched)}, but their nodes do not match (patched "
            f"blocks, for example a rotor and a stator): {listed(sides)}"
        )
    return lines + [each.describe(grid) for each in patched[: len(sides) <= 2]]


def _distance_phrase(openings: Sequence[Opening]) -> str:
    """A phrase with the distance of the faces if it exceeds round-off, else empty."""
    gap = max(opening.gap for opening in openings)
    return f", at most {gap:.3g} apart" if max(opening.relative for opening in openings) > _ROUND_OFF else ""


def find_openings(grid: Grid, topology: Topology) -> tuple[Opening, ...]:
    """Outside faces that nearly coincide with others or lie inside other blocks, largest first.

    A pair of sides with matching nodes is listed once. Faces that the file declares as walls are left out, as the two
    sides of a thin wing are close to each other.
    """
    outside = np.flatnonzero(topology.external)
    if outside.size == 0:
        return ()
    paired, gap, relative = _near_partners(grid, topology, outside)
    quads = np.flatnonzero(paired >= 0)
    own, other = (topology.quads.block_side[some] for some in (quads, paired[quads]))
    # Each pair of sides once, from the one with the lower number; within one side, each pair of quads once.
    chosen = (own < other) | ((own == other) & (quads < paired[quads]))
    label = np.full(len(paired), -1)
    label[quads[chosen]] = other[chosen]
    near, pieces = list[Opening](), rectangles(grid, topology.quads, label)
    for number, window in enumerate(pieces.windows()):
        quads = pieces.quads_of(number)
        corners = topology.quads.corners[quads]
        worst = float(gap[corners].max()), float(relative[corners].max())
        block, side = divmod(int(pieces.label[number]), 6)
        near.append(Opening(quads, window, block, Side(side), *worst, True))
    near += _abutting(grid, topology, paired)
    wall = np.zeros(len(topology.partner), dtype=bool)
    walls = [patch for patch in grid.patches if role_of_patch(patch) is Role.WALL]
    wall[quads_of_patches(topology.quads, walls)[0]] = True
    found = [opening for opening in near if not wall[opening.quads].all()] + find_overlaps(grid, topology)
    return tuple(sorted(found, key=lambda opening: -len(opening.quads)))


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


class _Samples:
    """Some of the outside ``quads`` of every block side, at most ``most`` of each.

    Attributes
    ----------
    side : (s,) ``6 * block + side``
    first, last : (s,) ends of the quads of each side among ``quads``
    start : (s + 1,) number of the first sample of each side
    corners, middle : (n, 4, 3), in 2-D (n, 2, 3), and (n, 3) coordinates of the samples
    """

    def __init__(self, grid: Grid, topology: Topology, quads: IntArray, most: int):
        self._grid, self._topology, self.quads = grid, topology, quads
        side = topology.quads.block_side[quads]
        self.first, self.last = runs(side)
        self.side = side[self.first]
        run, place = spread(self.last - self.first, most)
        self.start = np.append(0, np.cumsum(np.bincount(run, minlength=len(self.side))))
        self.corners = self.points_of(quads[self.first[run] + place])
        self.middle = self.corners.mean(axis=1)

    def points_of(self, quads: IntArray) -> FloatArray:
        """Coordinates of the corners of face quads, as above."""
        return np.asarray(self._grid.nodes.at(self._topology.first[self._topology.quads.corners[quads]]))

    @cached_property
    def largest(self) -> dict[int, tuple[IntArray, Window]]:
        """The largest rectangle of quads on every side, and its nodes."""
        label = np.full(len(self._topology.partner), -1)
        label[self.quads] = 0
        every = rectangles(self._grid, self._topology.quads, label)
        order = np.lexsort((np.arange(len(every)), -every.sizes, every.side))
        some = every.chosen(order[runs(every.side[order])[0]])
        return {int(s): (some.quads_of(n), w) for n, (s, w) in enumerate(zip(some.side, some.windows(), strict=True))}

    def candidates(
        self, pairs: IntArray, boxes: Boxes, reach: FloatArray, part: float
    ) -> Iterator[tuple[int, int, IntArray, float]]:
        """Those of the ``pairs`` (p, 2) of which enough samples of the first are within their ``reach`` (n,) of the box
        of the second, which samples these are, and how many are enough: ``part`` of all, at least two."""
        counts, (low, high) = np.diff(self.start)[pairs[:, 0]], boxes
        for lo, hi in batches(counts, _TOGETHER):
            some, (run, place) = pairs[lo:hi], spans(counts[lo:hi])
            sample, other = self.start[some[run, 0]] + place, some[run, 1]
            x, margin = self.middle[sample], reach[sample, None]
            within = ((x > low[other] - margin) & (x < high[other] + margin)).all(axis=1)
            ends, least = np.append(0, np.cumsum(counts[lo:hi])), np.maximum(_FEWEST, part * counts[lo:hi])
            for number in np.flatnonzero(np.bincount(run, weights=within, minlength=len(some)) >= least):
                mine = slice(ends[number], ends[number + 1])
                yield int(some[number, 0]), int(some[number, 1]), sample[mine][within[mine]], float(least[number])


def _abutting(grid: Grid, topology: Topology, paired: IntArray) -> list[Opening]:
    """Block sides that touch others with non-matching nodes, found from samples of their quads."""
    rest = np.flatnonzero(topology.external & (paired < 0))
    if rest.size == 0:
        return []
    samples = _Samples(grid, topology, rest, _SAMPLES)
    first, last = samples.first, samples.last
    low, high = np.empty((2, len(first), 3))
    for lo, hi in batches(last - first, _TOGETHER):
        corners = samples.points_of(rest[first[lo] : last[hi - 1]])
        low[lo:hi] = np.minimum.reduceat(corners.min(axis=1), first[lo:hi] - first[lo])
        high[lo:hi] = np.maximum.reduceat(corners.max(axis=1), first[lo:hi] - first[lo])
    edges = np.linalg.norm(samples.corners - np.roll(samples.corners, 1, axis=1), axis=2)
    edge = np.where(edges > 0, edges, np.inf).min(axis=1)
    slack = 1e-6 * np.linalg.norm(high - low, axis=1)[:, None]
    pairs, part = overlapping_boxes((low - slack, high + slack), (low, high)), grid.component_numbers[samples.side // 6]
    pairs = pairs[(pairs[:, 0] != pairs[:, 1]) & (part[pairs[:, 0]] == part[pairs[:, 1]])]
    found = []
    # Far from the origin the reach is smaller than the round-off of the coordinates: points on the box are in it.
    boxes = np.nextafter(low, -np.inf), np.nextafter(high, np.inf)
    for own, other, near, _ in samples.candidates(pairs, boxes, _ABUTTING * edge, 0.0):
        distance = distance_to_faces(samples.middle[near], samples.points_of(rest[first[other] : last[other]]))
        relative = distance / edge[near]
        hit = relative < _ABUTTING
        # Two walls that meet at a sharp edge are close to each other at a few quads only.
        if hit.sum() >= max(_FEWEST, 0.1 * (samples.start[own + 1] - samples.start[own])):
            (block, side), gap = divmod(int(samples.side[other]), 6), float(distance[hit].max())
            largest = samples.largest[int(samples.side[own])]
            found.append(Opening(*largest, block, Side(side), gap, float(relative[hit].max()), False))
    return found


def find_overlaps(grid: Grid, topology: Topology) -> list[Opening]:
    """Outside faces inside other blocks, found from samples of the quads of each block side."""
    outside = np.flatnonzero(topology.external)
    if outside.size == 0:
        return []
    samples = _Samples(grid, topology, outside, _SAMPLES // 2)
    middle, block, (low, high) = samples.middle, samples.side // 6, block_extents(grid)
    # A 2-D grid is plane only up to the precision of its file.
    slack = FLATNESS * float((high.max(axis=0) - low.min(axis=0)).max())
    own_box = np.minimum.reduceat(middle, samples.start[:-1]), np.maximum.reduceat(middle, samples.start[:-1])
    pairs, part = overlapping_boxes(own_box, (low - slack, high + slack)), grid.component_numbers
    pairs = pairs[(block[pairs[:, 0]] != pairs[:, 1]) & (part[block[pairs[:, 0]]] == part[pairs[:, 1]])]
    surface = cache(partial(_surface, grid, topology))
    normal, found = plane_normal(grid), []
    plane = low == high
    boxes = np.where(plane, -np.inf, low), np.where(plane, np.inf, high)
    for own, other, within, least in samples.candidates(pairs, boxes, np.zeros(len(middle)), _PART):
        x, quads = middle[within], samples.corners[within]
        # Inside the coarse surface of the block, then inside the exact one.
        some = np.flatnonzero(_winding(surface(other, _COARSE), normal, x) > _SOME)
        if some.size == 0:
            continue
        some = some[_winding(surface(other, None), normal, x[some]) > _SURE]
        distance = distance_to_faces(x[some], surface(other, None))
        longest = np.linalg.norm(quads[some] - np.roll(quads[some], 1, axis=1), axis=2).max(axis=1)
        deep = distance[distance > _DEEP * longest]
        if len(deep) >= least:
            share = len(deep) / (samples.start[own + 1] - samples.start[own])
            largest = samples.largest[int(samples.side[own])]
            found.append(Opening(*largest, other, None, float(deep.max()), share, False))
    return found


def _surface(grid: Grid, topology: Topology, block: int, cells: int | None) -> FloatArray:
    """Corners (m, 4, 3), in 2-D (m, 2, 3), of a block's faces, all wound alike; at most ``cells`` per direction."""
    found = []
    for side in range(6 * block, 6 * block + 6):
        if grid.sides.has_quads[side]:
            sizes = grid.sides.nodes[side]
            u, v = (np.unique(np.linspace(0, n - 1, min(n, (cells or n) + 1)).round().astype(int)) for n in sizes)
            x = grid.points[grid.sides.at(side, u[:, None], v)]
            line = x.reshape(-1, 3)
            faces = (
                np.stack([line[:-1], line[1:]], axis=1)
                if 1 in sizes
                else np.stack([x[:-1, :-1], x[1:, :-1], x[1:, 1:], x[:-1, 1:]], axis=2).reshape(-1, 4, 3)
            )
            found.append(faces if topology.quads.in_order.ravel()[side] else faces[:, ::-1])
    return np.concatenate(found)


def _winding(faces: FloatArray, normal: FloatArray | None, places: FloatArray) -> FloatArray:
    """Absolute winding number (k,) of a closed surface about ``places`` (k, 3)."""
    if normal is not None:
        return np.abs(plane_winding(faces[:, 0], faces[:, 1], normal, places))
    at = np.arange(0, 4 * len(faces), 4)[:, None]
    return np.abs(winding(faces.reshape(-1, 3), np.concatenate([at + [0, 1, 2], at + [2, 3, 0]]), places))


def coincident_blocks(grid: Grid, topology: Topology) -> list[str]:
    """A message for each block all of whose face nodes are those of an earlier one: both lie in the same place."""
    if grid.n_blocks == 1:
        return []
    ends, earlier, pairs = [*topology.quads.start[:, 0].tolist(), None], dict[bytes, int](), []
    for block, (first, last) in enumerate(pairwise(ends)):
        nodes = distinct(topology.quads.corners[first:last], topology.n_unique)
        one = earlier.setdefault(nodes.tobytes(), block)
        pairs += [(one, block)] if one != block else []
    return [
        f"blocks {grid.names[one]!r} and {grid.names[two]!r} lie in the same place: all their faces coincide, so that "
        f"none of them is an outside face; remove one of the blocks, or assign them to components ([grid] components)"
        for one, two in pairs
    ]
