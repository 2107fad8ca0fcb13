"""From a surface displacement to the boundary nodes of the grid: exact, nearest, or interpolated."""

from __future__ import annotations

from dataclasses import dataclass

from .grid import FloatArray, IntArray


@dataclass(frozen=True)
class SurfaceData:
    """Displacements known at scattered points, with the surface between them where the file has one.

    Attributes
    ----------
    points, displacement : (n, 3) float64, grid length unit
    triangles : (m, 3) int64, indices into ``points``; (0, 3) when the file has points only
    label : what to call it in messages, usually the file name
    """

    points: FloatArray
    displacement: FloatArray
    triangles: IntArray
    label: str
