"""Tables in another length unit, or with another origin, than the nodes that they should match."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import scipy

from ..grid import FloatArray

# In which other frame a table would fit (thresholds that were tuned together, tests/core/test_tables.py):
FRAME_SAMPLE = 2000
"""Largest number of the table's points that are tried in every frame."""
FITS = 0.9
"""A frame is proposed if this share of the points would lie on the nodes, ..."""
GAIN = 0.25
"""... and if this share exceeds that of the points as given by at least this much."""
SPREAD = 0.2
"""Points that fit must extend over at least this fraction of the diagonal of the nodes, or of the wall around them, as
a table shrunk to a point lies on any wall."""
PROBES, ON_NODE = 12, 0.05
"""Number of points by which a shift onto nodes is found, and its tolerance as a fraction of the shortest edge there."""
_UNITS = {"millimetres": 1e-3, "centimetres": 1e-2, "micrometres": 1e-6, "inches": 0.0254, "feet": 0.3048}
"""Length units in metres."""
_MISTAKES = [*((unit, "metres") for unit in _UNITS), *(("metres", unit) for unit in _UNITS)]
_MISTAKES += [("inches", "millimetres"), ("millimetres", "inches")]
"""The unit of the table, and that of the grid."""


def other_frame(points: FloatArray, nodes: Any) -> str:
    """A hint on what would make table points match the nodes (:class:`.tables.BoundaryNodes`), with the share of points
    that would then lie on them.

    Tried are length units and shifts. Of those that fit, the one with the smallest distances is named.

    Returns
    -------
    The end of a message, empty if nothing fits.
    """
    some = points[:: max(1, len(points) // FRAME_SAMPLE)]
    tree = scipy.spatial.cKDTree(nodes.points)
    here, _ = _fit(some, nodes, tree)
    best, share, distance = "", max(FITS, here + GAIN), np.inf
    for change, candidate in _candidates(some, nodes, tree):
        hit, off = _fit(candidate, nodes, tree)
        # A later candidate must be clearly nearer, as frames that differ by a symmetry of the wall fit equally well.
        if hit >= share and off < 0.9 * distance - 1e-12:
            best, distance = f" ({change[0]}, {hit:.0%} of its points would lie on the nodes: {change[1]}?)", off
    if best:
        return best
    sizes = [float(np.linalg.norm(np.ptp(p, axis=0))) for p in (points, nodes.points)]
    if min(sizes) > 0 and not 1 / 30 < sizes[0] / sizes[1] < 30:
        return f" (sizes differ by a factor {max(sizes) / min(sizes):.3g}: different length units?)"
    return ""


def _fit(points: FloatArray, nodes: Any, tree: scipy.spatial.cKDTree) -> tuple[float, float]:
    """Share of points that lie on the nodes, 0 if they do not spread over them, and their mean distance in edges."""
    distance, nearest = tree.query(points)
    near = distance <= nodes.longest[nearest]
    if not near.any():
        return 0.0, np.inf
    found = nodes.points[np.unique(nearest[near])]
    extent = float(np.linalg.norm(np.ptp(points, axis=0)))
    whole = float(np.linalg.norm(np.ptp(nodes.points, axis=0)))
    spread = float(np.linalg.norm(np.ptp(found, axis=0)))
    # Far-field nodes among those selected must not set the scale: many faces in each direction are as good.
    wide = spread >= SPREAD * whole or len(found) >= max(4, len(points) // 2)
    if not wide or spread < 0.5 * extent:
        return 0.0, np.inf
    return float(near.mean()), float((distance[near] / nodes.longest[nearest[near]]).mean())


def _candidates(
    points: FloatArray, nodes: Any, tree: scipy.spatial.cKDTree
) -> Iterator[tuple[tuple[str, str], FloatArray]]:
    """Changes with the likely reason, and the changed points."""
    for table, grid in _MISTAKES:
        factor = _UNITS.get(table, 1.0) / _UNITS.get(grid, 1.0)
        mistake = f"different length units, in {table} where the grid is in {grid}"
        yield (f"multiplied by {factor:.6g}", mistake), points * factor
    x = nodes.points
    shifts = [(x.min(axis=0) + x.max(axis=0) - points.min(axis=0) - points.max(axis=0)) / 2]
    # Of part of a wall, the first point may lie on any node; each further point rules out most of the remaining shifts.
    probes = points[np.unique(np.linspace(0, len(points) - 1, PROBES).astype(np.int64))]
    onto_node = x - probes[0]
    for probe in probes[1:]:
        distance, nearest = tree.query(probe + onto_node)
        onto_node = onto_node[distance <= ON_NODE * nodes.edge[nearest]]
    if len(probes) > 3 and len(onto_node):
        shifts.append(onto_node[int(np.argmin(np.linalg.norm(onto_node, axis=1)))])
    for shift in shifts:
        yield (f"shifted by ({', '.join(f'{x:.6g}' for x in shift)})", "another origin"), points + shift
