"""Centres of radial basis functions, and the solution of their linear system.

Separate from the system and the sums themselves, whose loops take a while to load.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...grid import FloatArray

DIRECT_CENTRES = 4000
"""Largest number of centres that ``auto`` solves directly; beyond it, GMRES with its set-up is faster."""

REACH = 20.0
"""Distance from a wall over which nodes are corrected by the residual of a greedy reduction there, as a multiple of the
residual; large enough that the correction cannot fold cells."""


@dataclass(frozen=True)
class Centres:
    """Centres in normalised coordinates with the polynomial terms that they determine.

    Thin plate splines with a linear polynomial do not depend on the unit of length, and compact functions take
    distances in radii; both are best conditioned with distances near one. If all centres lie in a plane, its normal
    direction has no polynomial term, so that 2-D grids and planar patches have a solution.
    """

    points: FloatArray
    origin: FloatArray
    scale: float
    axes: FloatArray

    @classmethod
    def of(cls, points: FloatArray, radius: float | None) -> Centres:
        origin = points.mean(axis=0)
        arms = points - origin
        extent = float(np.linalg.norm(arms, axis=1).max()) or 1.0
        _, sizes, axes = np.linalg.svd(arms, full_matrices=False)
        spread = axes[sizes > 1e-8 * extent * np.sqrt(len(points))]
        scale = extent if radius is None else radius
        return cls(np.ascontiguousarray(arms / scale), origin, scale, spread)

    def normalised(self, points: FloatArray) -> FloatArray:
        """Points in the normalised coordinates."""
        return (points - self.origin) / self.scale

    def polynomial(self, normalised: FloatArray) -> FloatArray:
        """Polynomial terms (n, q) at normalised points: the constant and the directions in which the centres extend."""
        return np.column_stack([np.ones(len(normalised)), *(self._along(axis, normalised) for axis in self.axes)])

    def drift(self, normalised: FloatArray, polynomial: FloatArray) -> FloatArray:
        """Values (n, 3) at normalised points of a ``polynomial`` (q, 3), which may lack the last terms; of each point
        the same to the last bit for any n, unlike ``@``."""
        found = np.tile(polynomial[0], (len(normalised), 1)) if len(polynomial) else np.zeros((len(normalised), 3))
        for axis, slope in zip(self.axes, polynomial[1:], strict=False):
            found += self._along(axis, normalised)[:, None] * slope
        return found

    @staticmethod
    def _along(axis: FloatArray, points: FloatArray) -> FloatArray:
        return np.asarray(points[:, 0] * axis[0] + points[:, 1] * axis[1] + points[:, 2] * axis[2])


@dataclass(frozen=True)
class Coefficients:
    """Solved coefficients: ``centres`` (k, 3) normalised, ``coefficients`` (k, 3), ``polynomial`` (q, 3).

    ``residual`` (n, 3) is the error that a greedy reduction left at the sources (else ``None``), ``reach`` the length
    over which it is spread.
    """

    centres: FloatArray
    coefficients: FloatArray
    polynomial: FloatArray
    residual: FloatArray | None = None
    reach: float = 0.0
