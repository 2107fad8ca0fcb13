"""Outside faces close to others without coinciding: gaps, interfaces that do not match, overlaps (:mod:`.overset`).

Nothing is welded by mere proximity, so such a face is a wall, and a motion would tear the grid there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..numerics.arrays import extent
from ..numerics.geometry.coincidence import close_pairs, distinct, equal_rows
from ..numerics.geometry.distance import distance_to_faces
from .blocks import FloatArray, Grid, IntArray, Side, Window
from .overset import Overlap, find_overlaps
from .topology import Topology
from .windows import windows_of_quads

NEAR = 0.25
"""Nodes closer than this part of the shortest edge at either of them look like one node."""
_ABUTTING = 0.1
"""Faces whose middle lies closer than this part of its shortest edge to another face touch it."""
_SAMPLES = 48
_FEWEST = 2

Box = tuple[FloatArray, FloatArray]
"""Smallest and largest coordinates."""


@dataclass(frozen=True)
class Opening:
    """Outside faces of one block side that nearly coincide with those of another.

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
        low, high = self.window.low, self.window.high
        ranges = ",".join(f"{a + 1}:{b + 1}" for a, b in zip(low, high, strict=True))
        one, two = f"{grid.names[self.block]}.{self.side.label}", f"{grid.names[self.other]}.{self.other_side.label}"
        where = f"{one}[{ranges}] ({len(self.quads)} quads) and {two}"
        if self.matching:
            return (
                f"{where} nearly coincide: the gap is up to {self.gap:.3g}, {self.relative:.2%} of the local edge; "
                f"grid.tolerance = {self.tolerance:g} closes it"
            )
        return f"{where} touch, at most {self.gap:.3g} apart, but their nodes do not match (patched blocks)"


def find_openings(grid: Grid, topology: Topology) -> tuple[Opening | Overlap, ...]:
    """Outside faces that nearly coincide with others or lie inside other blocks, largest first.

    Each pair of sides once if its nodes match.
    """
    outside = np.flatnonzero(topology.external)
    if outside.size == 0:
        return ()
    paired, gap, relative = _near_partners(grid, topology, outside)
    found: list[Opening | Overlap] = [*_matching(grid, topology, paired, gap, relative)]
    found += _abutting(grid, topology, paired)
    found += find_overlaps(grid, topology)
    return tuple(sorted(found, key=lambda opening: -len(opening.quads)))


def _near_partners(grid: Grid, topology: Topology, outside: IntArray) -> tuple[IntArray, FloatArray, FloatArray]:
    """The outside quad (n_quads,) with nearly the same corners, or -1; how far nodes (n_unique,) are apart, and over
    the edge.
    """
    corners = topology.quads.corners
    nodes = distinct(corners[outside], topology.n_unique)
    points, edge = grid.points[topology.first[nodes]], topology.edge[nodes]
    one, two = close_pairs(points, NEAR * edge).T
    distance = np.linalg.norm(points[one] - points[two], axis=1)
    label = np.arange(topology.n_unique)
    # Interfaces have two sides; each pair is represented by its smaller number.
    np.minimum.at(label, nodes[np.maximum(one, two)], nodes[np.minimum(one, two)])
    gap, relative = np.zeros(topology.n_unique), np.zeros(topology.n_unique)
    for end in (one, two):
        np.maximum.at(gap, nodes[end], distance)
        np.maximum.at(relative, nodes[end], distance / np.minimum(edge[one], edge[two]))
    paired = np.full(len(corners), -1)
    rows = np.sort(label[corners[outside]], axis=1)
    sound = (np.diff(rows, axis=1) > 0).sum(axis=1) >= min(2, rows.shape[1] - 1)
    partner, _ = equal_rows(rows[sound])
    quads = outside[sound]
    paired[quads] = np.where(partner >= 0, quads[partner], -1)
    return paired, gap, relative


def _matching(grid: Grid, topology: Topology, paired: IntArray, gap: FloatArray, relative: FloatArray) -> list[Opening]:
    found = []
    sides = topology.quads.block_side
    near = np.flatnonzero(paired >= 0)
    for own in np.unique(sides[near]):
        block, side = int(own) // 6, Side(int(own) % 6)
        span = topology.quads.of_side(block, side)
        partner = paired[span]
        others = np.where(partner >= 0, sides[np.maximum(partner, 0)], -1)
        for other in np.unique(others[others >= own]):
            mine = others == other
            if other == own:
                # A seam within one side: each pair once.
                mine &= partner > np.arange(span.start, span.stop)
            for window, quads in _windows(grid, topology, block, side, mine):
                partner_side = int(other) // 6, Side(int(other) % 6)
                corners = topology.quads.corners[quads]
                worst = float(gap[corners].max()), float(relative[corners].max())
                found.append(Opening(quads, window, block, side, *partner_side, *worst, matching=True))
    return found


def _windows(grid: Grid, topology: Topology, block: int, side: Side, mine: np.ndarray) -> list[tuple[Window, IntArray]]:
    """Rectangles of the marked quads of a side, and the quads in each."""
    counts = tuple(int(n) for n in topology.quads.counts[block, side])
    numbers = np.arange(topology.quads.start[block, side], topology.quads.start[block, side] + len(mine))
    found = []
    for window in windows_of_quads(grid.shapes[block], block, side, mine.reshape(counts)):
        inside = np.zeros(counts, dtype=bool)
        (a, b), (c, d) = window.low, window.high
        inside[a : max(c, a + 1), b : max(d, b + 1)] = True
        found.append((window, numbers[(inside.ravel()) & mine]))
    return found


def _abutting(grid: Grid, topology: Topology, paired: IntArray) -> list[Opening]:
    """Block sides that touch others with non-matching nodes, found from samples of their quads."""
    rest = topology.external & (paired < 0)
    sides = np.unique(topology.quads.block_side[rest])
    points = grid.points[topology.first]
    patches = {int(own): np.flatnonzero(rest[_span(topology, own)]) + _span(topology, own).start for own in sides}
    corners = {own: points[topology.quads.corners[quads]] for own, quads in patches.items()}
    boxes = {own: extent(x) for own, x in corners.items()}
    found = []
    for own, quads in patches.items():
        for other in patches:
            if other == own or not _overlap(boxes[own], boxes[other]):
                continue
            touching, gap, relative = _touching(corners[own], corners[other], boxes[other])
            if len(touching) >= _FEWEST:
                block, side = own // 6, Side(own % 6)
                mine = np.isin(np.arange(_span(topology, own).start, _span(topology, own).stop), quads)
                window, chosen = max(_windows(grid, topology, block, side, mine), key=lambda each: len(each[1]))
                found.append(Opening(chosen, window, block, side, other // 6, Side(other % 6), gap, relative, False))
    return found


def _span(topology: Topology, own: int) -> slice:
    return topology.quads.of_side(int(own) // 6, Side(int(own) % 6))


def _overlap(one: Box, two: Box) -> bool:
    slack = 1e-6 * float(np.linalg.norm(one[1] - one[0]))
    return bool((one[0] <= two[1] + slack).all() and (two[0] <= one[1] + slack).all())


def _touching(own: FloatArray, other: FloatArray, box: Box) -> tuple[IntArray, float, float]:
    """Samples of quads (n, c, 3) whose middles lie on the quads (m, c, 3), the largest distance, also over the edge.

    ``box``: extent of the quads (m, c, 3).
    """
    sample = np.unique(np.linspace(0, len(own) - 1, min(len(own), _SAMPLES)).astype(int))
    edges = np.linalg.norm(own[sample] - np.roll(own[sample], 1, axis=1), axis=2)
    edge = np.where(edges > 0, edges, np.inf).min(axis=1)
    middle = own[sample].mean(axis=1)
    slack = _ABUTTING * edge[:, None]
    inside = ((middle >= box[0] - slack) & (middle <= box[1] + slack)).all(axis=1)
    distance = np.full(len(sample), np.inf)
    if inside.sum() >= _FEWEST:
        distance[inside] = distance_to_faces(middle[inside], other)
    hit = distance < _ABUTTING * edge
    # Two walls that meet in a sharp edge are close to each other in only a few quads.
    if hit.sum() < max(_FEWEST, 0.1 * len(sample)):
        return np.empty(0, dtype=np.int64), 0.0, 0.0
    return sample[hit], float(distance[hit].max()), float((distance / edge)[hit].max())
