"""Direction of view and window of a picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from meshdeform_core.grid import FloatArray


@dataclass(frozen=True)
class View:
    """A parallel projection: unit vectors to the right, up and towards the viewer, and the names of the first two axes.

    Names are empty for axes of the picture that are not axes of the grid.
    """

    right: FloatArray
    up: FloatArray
    towards: FloatArray
    labels: tuple[str, str] = ("", "")

    @property
    def flat(self) -> bool:
        """Both axes of the picture are axes of the grid."""
        return all(self.labels)

    def project(self, points: FloatArray) -> FloatArray:
        """Coordinates (..., 3) in the picture: to the right, up and towards the viewer (length unit)."""
        return np.asarray(points @ np.stack([self.right, self.up, self.towards], axis=1))


def along(axis: str, mirrored: bool = False) -> View:
    """The view against a coordinate axis, ``x``, ``y`` or ``z``, with the other two in their order."""
    unit = np.eye(3)
    right, up = {"x": (1, 2), "y": (0, 2), "z": (0, 1)}[axis]
    towards = unit["xyz".index(axis)] * (-1.0 if axis == "y" else 1.0)
    return View(unit[right], unit[up], -towards if mirrored else towards, ("xyz"[right], "xyz"[up]))


def towards(direction: FloatArray) -> View:
    """The view from ``direction``; z points upwards, or y if the view is along z."""
    back = direction / np.linalg.norm(direction)
    up = np.array([0.0, 0.0, 1.0]) if abs(back[2]) < 0.95 else np.array([0.0, 1.0, 0.0])
    right = np.cross(up, back)
    right /= np.linalg.norm(right)
    return View(right, np.cross(back, right), back)


def iso() -> View:
    """The isometric view from the positive octant."""
    return towards(np.array([0.8, -1.0, 0.7]))


def facing(normal: FloatArray) -> View:
    """The view onto a plane; along a coordinate axis if that is its normal."""
    axis = int(np.argmax(np.abs(normal)))
    if abs(normal[axis]) > 1 - 1e-6:
        return along("xyz"[axis])
    return towards(normal * np.sign(normal[axis]))


def spread(points: FloatArray) -> View:
    """The view onto points that are flat along a coordinate axis, else the isometric one."""
    extent = np.ptp(points.reshape(-1, 3), axis=0)
    axis = int(np.argmin(extent))
    return along("xyz"[axis]) if extent[axis] < 1e-6 * extent.max() else iso()


Window = tuple[float, float, float, float]
"""Left, right, bottom, top in the picture's coordinates (length unit)."""


def window_of(view: View, points: FloatArray, margin: float = 0.04) -> Window:
    """The window that contains all points (..., 3), with a margin (fraction of the larger extent)."""
    flat = view.project(points.reshape(-1, 3))[:, :2]
    low, high = flat.min(axis=0), flat.max(axis=0)
    rim = margin * float((high - low).max() or 1.0)
    return float(low[0] - rim), float(high[0] + rim), float(low[1] - rim), float(high[1] + rim)


def shaped(window: Window, aspect: tuple[float, float]) -> Window:
    """The window, enlarged until height over width is within limits."""
    left, right, bottom, top = window
    width, height = right - left, top - bottom
    wanted = min(max(height / width, aspect[0]), aspect[1])
    more_height, more_width = max(wanted * width - height, 0.0), max(height / wanted - width, 0.0)
    return left - more_width / 2, right + more_width / 2, bottom - more_height / 2, top + more_height / 2
