"""Tables in another length unit or order of coordinates than the nodes that they should match."""

from __future__ import annotations

import numpy as np
import scipy

from ..grid import BoolArray, FloatArray
from .matching import Nodes

# Conversion factors between length units: m and mm, cm, km, inch, foot, and inch in mm.
_FACTORS = (1e-3, 1e3, 1e-2, 1e2, 1e-6, 1e6, 0.0254, 1 / 0.0254, 25.4, 1 / 25.4, 0.3048, 1 / 0.3048)
_ORDERS = ((0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0))
_SAMPLE = 5000


def far_points(points: FloatArray, nodes: Nodes) -> BoolArray:
    """(n,) bool: points that are farther from every node than the longest face edge there."""
    distance, nearest = scipy.spatial.cKDTree(nodes.points).query(points)
    return np.asarray(distance > nodes.longest[nearest])


def other_frame(points: FloatArray, nodes: Nodes) -> str:
    """A hint on what would make table points match the nodes: another length unit or order of coordinates.

    The end of a message, empty if neither helps.
    """
    some = points[:: max(1, len(points) // _SAMPLE)]
    here = 1.0 - far_points(some, nodes).mean()
    tried = {f"multiplied by {factor:.6g}, {{}}: different length units?": some * factor for factor in _FACTORS}
    tried |= {
        f"with its coordinates in the order {' '.join('xyz'[axis] for axis in order)}, {{}}": some[:, order]
        for order in _ORDERS
    }
    for text, there in tried.items():
        hit = 1.0 - far_points(there, nodes).mean()
        if hit >= 0.9 and here < 0.5:
            return f" ({text.format(f'{hit:.0%} of its points would lie on the nodes')})"
    sizes = [float(np.linalg.norm(np.ptp(p, axis=0))) for p in (points, nodes.points)]
    if min(sizes) > 0 and not 1 / 30 < sizes[0] / sizes[1] < 30:
        return f" (sizes differ by a factor {max(sizes) / min(sizes):.3g}: different length units?)"
    return ""
