"""Boundary-layer grids around airfoils like those of users: y+ about 1, first cells 1e5 times as long as high."""

import numpy as np

from meshdeform_core.grid import Grid


def geometric(first: float, last: float, count: int) -> np.ndarray:
    """``count`` values from 0, beginning with a step of ``first`` and growing steadily up to ``last``."""
    low, high = 1.0 + 1e-9, 10.0
    for _ in range(200):
        ratio = 0.5 * (low + high)
        total = first * (ratio ** (count - 1) - 1.0) / (ratio - 1.0)
        low, high = (ratio, high) if total < last else (low, ratio)
    return first * (ratio ** np.arange(count) - 1.0) / (ratio - 1.0)


def o_grid(around: int = 121, layers: int = 61, first: float = 1.25e-6, far: float = 15.0) -> Grid:
    """An ellipse of 1 x 0.12 in a conformal O-grid, one block whose ends meet."""
    radius, focus = 0.28, np.sqrt(0.28 * 0.22)
    angle = np.linspace(0.0, 2.0 * np.pi, around)
    angle[-1] = 0.0
    # The steps of the map shrink with it at the wall: by its derivative there, about 1 at the sides.
    distance = radius + geometric(first, far, layers)
    circle = distance[None, :] * np.exp(1j * angle)[:, None]
    place = circle + focus**2 / circle
    return Grid.from_blocks([np.stack([place.real, place.imag, 0 * place.real], axis=-1)[:, :, None]], ["o"])


def c_grid(around: int = 161, layers: int = 61, first: float = 1.25e-6, far: float = 4.0) -> Grid:
    """A thin airfoil of chord 1 in a C-grid of parabolic coordinates, whose wake nodes coincide."""
    along = np.linspace(-2.5, 2.5, around)
    body = np.clip(1.0 - along**2, 0.0, None)
    out = geometric(first, far, layers)
    width = 0.2 * body**1.5
    place = (along[:, None] + 1j * (width[:, None] * (1.0 - out / far)[None, :] + out[None, :])) ** 2
    # The two sides of the wake are mirror images, to the bit.
    half = around // 2
    place[half + 1 :] = np.conj(place[:half][::-1])
    return Grid.from_blocks([np.stack([place.real, -place.imag, 0 * place.real], axis=-1)[:, :, None]], ["c"])


def extruded(grid: Grid, layers: int = 2, span: float = 0.1) -> Grid:
    """Planes of a plane grid along z."""
    planes = []
    for block in range(grid.n_blocks):
        plane = np.repeat(grid.block(block), layers + 1, axis=2)
        plane[..., 2] = np.linspace(0.0, span, layers + 1)
        planes.append(plane)
    return Grid.from_blocks(planes, list(grid.names))


def moved_by_a_script(grid: Grid, degrees: float, layers: int = 20) -> Grid:
    """The grid with its wall turned and the nodes of the first ``layers`` carried along, less and less; in a C-grid
    also those of its wake."""
    x = grid.block(0)
    share = np.clip(1.0 - np.arange(x.shape[1]) / layers, 0.0, 1.0)[None, :, None]
    if grid.names == ("c",):
        wake = np.abs(np.linspace(-2.5, 2.5, len(x))) - 1.0
        share = share * np.clip(1.0 - wake / 0.75, 0.0, 1.0)[:, None, None]
    angle, points = np.radians(degrees) * share, x.copy()
    points[..., 0] = np.cos(angle) * x[..., 0] - np.sin(angle) * x[..., 1]
    points[..., 1] = np.sin(angle) * x[..., 0] + np.cos(angle) * x[..., 1]
    return Grid.from_blocks([points], list(grid.names))
