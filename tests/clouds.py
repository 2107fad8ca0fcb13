"""Sets of points that are hard in different ways, and a smooth displacement."""

import numpy as np


def sphere(n: int) -> np.ndarray:
    """Nearly evenly spread points of a unit sphere (golden spiral)."""
    z = 1 - (2 * np.arange(n) + 1) / n
    angle = np.pi * (1 + 5**0.5) * np.arange(n)
    return np.stack([np.sqrt(1 - z * z) * np.cos(angle), np.sqrt(1 - z * z) * np.sin(angle), z], axis=1)


def graded_plane(n: int = 38) -> np.ndarray:
    """A plane patch clustered towards one edge, first spacing 1/400 of the largest, as beside a wall."""
    u = (np.geomspace(1.0, 400.0, n) - 1.0) / 399.0
    x, y = np.meshgrid(u, np.linspace(0.0, 1.0, n), indexing="ij")
    return np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)


def bend(x: np.ndarray) -> np.ndarray:
    return np.stack([np.sin(2 * x[:, 1]), np.cos(x[:, 0]) * x[:, 2], np.exp(x[:, 0])], axis=1)


SETS = {
    "sphere": sphere(1500),
    "graded-plane": graded_plane(),
    "two-scales": np.concatenate([sphere(900), 20.0 + 5.0 * sphere(600)]),
    "curve": np.stack([np.cos(np.arange(1200) / 190), np.sin(np.arange(1200) / 190), np.zeros(1200)], axis=1),
    "line": np.linspace(0, 1, 1000)[:, None] * np.array([1.0, 2.0, -1.0]),
}
