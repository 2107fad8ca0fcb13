"""Problem 2 of Sen et al.: an ellipse rotates by 90 degrees and becomes a NACA 0012 airfoil, 2-D O-grid."""

import numpy as np

from meshdeform_core.boundary.tables import SurfaceData
from meshdeform_core.grid import FloatArray, Grid

from ..building import tanh_law, with_patches

DEFAULT_SIZE = 401
SIZES = {"small": 101, "paper": 401}
SIZE_HELP = "nodes around the airfoil, the last repeats the first (paper: 401, with 241 in the radial direction)"

_SEMI_AXES = 0.5, 0.05
_FIRST_STEP, _OUTER_RADIUS = 2e-4, 12.0
_NACA = (0.2969, -0.1260, -0.3516, 0.2843, -0.1036)
_ANGLE = 90.0


def generate(size: int = DEFAULT_SIZE) -> Grid:
    """The O-grid around the ellipse, by the Joukowski map of concentric circles."""
    if size < 9:
        raise ValueError(f"size = {size} nodes around; expected at least 9")
    a, b = _SEMI_AXES
    radius = (a + b) / 2 + tanh_law(_FIRST_STEP, round(0.6 * (size - 1)), _OUTER_RADIUS - (a + b) / 2)
    theta = _equal_arcs(_ellipse, size)
    circle = radius[:, None] * np.exp(1j * theta)
    plane = circle + (a * a - b * b) / 4 / circle
    # The seam is one line: its two sides are equal to the last bit.
    plane[:, -1] = plane[:, 0]
    x = np.zeros((size, len(radius), 1, 3))
    x[..., 0, 0], x[..., 0, 1] = plane.T.real, plane.T.imag
    return with_patches(
        Grid.from_blocks([x], ["o-grid"]),
        [
            ("airfoil", "BCWall", lambda c, side: np.hypot(c[:, 0], c[:, 1]) < 0.6),
            ("outer", "BCFarfield", lambda c, side: np.full(len(c), True)),
        ],
    )


def tables(size: int = DEFAULT_SIZE) -> dict[str, SurfaceData]:
    """``displacement.csv``: ellipse points to airfoil points, one to one by arc length from the trailing edge."""
    ellipse = _ellipse(_equal_arcs(_ellipse, size)[:-1])
    airfoil = _naca(_equal_arcs(_naca, size)[:-1])
    turn = np.deg2rad(_ANGLE)
    matrix = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    points, moved = (np.c_[p, np.zeros(len(p))] for p in (ellipse, airfoil @ matrix.T))
    return {"displacement.csv": SurfaceData(points, moved - points, np.empty((0, 3), np.int64), "displacement.csv")}


def _ellipse(theta: FloatArray) -> FloatArray:
    return np.stack([_SEMI_AXES[0] * np.cos(theta), _SEMI_AXES[1] * np.sin(theta)], axis=1)


def _naca(theta: FloatArray) -> FloatArray:
    """NACA 0012 with a closed trailing edge, centred at half chord; upper side for theta in (0, pi)."""
    c = 0.5 * (1.0 + np.cos(theta))
    a0, a1, a2, a3, a4 = _NACA
    half = 0.6 * (a0 * np.sqrt(c) + c * (a1 + c * (a2 + c * (a3 + c * a4))))
    return np.stack([c - 0.5, np.where(theta <= np.pi, half, -half)], axis=1)


def _equal_arcs(curve, size: int) -> FloatArray:  # type: ignore[no-untyped-def]
    """Parameters in [0, 2 pi] of ``size`` points at equal arc lengths on a closed curve."""
    fine = np.linspace(0.0, 2.0 * np.pi, 200_001)
    steps = np.linalg.norm(np.diff(curve(fine), axis=0), axis=1)
    arc = np.concatenate([[0.0], np.cumsum(steps)])
    return np.interp(np.linspace(0.0, arc[-1], size), arc, fine)
