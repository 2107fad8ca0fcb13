"""Direction of view and window of a picture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from meshdeform_core.grid import FloatArray


class Window(NamedTuple):
    """A rectangle in the picture's coordinates (length unit)."""

    left: float
    right: float
    bottom: float
    top: float

    @property
    def width(self) -> float:
        return self.right - self.left

    @property
    def height(self) -> float:
        return self.top - self.bottom

    @property
    def larger_side(self) -> float:
        """The larger of width and height."""
        return max(self.width, self.height)

    def grown(self, margin: float) -> Window:
        """With a margin on every side (length unit)."""
        return Window(self.left - margin, self.right + margin, self.bottom - margin, self.top + margin)

    def shaped(self, least: float, most: float) -> Window:
        """Enlarged until height over width is within limits."""
        wanted = min(max(self.height / self.width, least), most)
        width, height = max(self.width, self.height / wanted), max(self.height, wanted * self.width)
        x, y = 0.5 * (self.left + self.right), 0.5 * (self.bottom + self.top)
        return Window(x - width / 2, x + width / 2, y - height / 2, y + height / 2)

    def within(self, whole: Window) -> Window:
        """The part inside another one."""
        return Window(
            max(self.left, whole.left), min(self.right, whole.right),
            max(self.bottom, whole.bottom), min(self.top, whole.top),
        )  # fmt: skip

    def moved_into(self, whole: Window) -> Window:
        """Shifted to lie within another one and a narrow rim, as far as it fits."""
        outer = whole.grown(0.03 * self.larger_side)
        across = max(outer.left - self.left, 0.0) or min(outer.right - self.right, 0.0)
        upwards = max(outer.bottom - self.bottom, 0.0) or min(outer.top - self.top, 0.0)
        return Window(self.left + across, self.right + across, self.bottom + upwards, self.top + upwards)


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

    def window(self, points: FloatArray, margin: float = 0.04) -> Window:
        """The window that contains all points (..., 3), with a margin (fraction of the larger extent)."""
        flat = self.project(points.reshape(-1, 3))[:, :2]
        (left, bottom), (right, top) = flat.min(axis=0).tolist(), flat.max(axis=0).tolist()
        window = Window(left, right, bottom, top)
        return window.grown(margin * (window.larger_side or 1.0))


def along(axis: str) -> View:
    """The view against a coordinate axis, ``x``, ``y`` or ``z``, with the other two in their order."""
    unit = np.eye(3)
    right, up = {"x": (1, 2), "y": (0, 2), "z": (0, 1)}[axis]
    towards = unit["xyz".index(axis)] * (-1.0 if axis == "y" else 1.0)
    return View(unit[right], unit[up], towards, ("xyz"[right], "xyz"[up]))


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
    """The view onto points (..., 3) that are flat along a coordinate axis, else the isometric one."""
    size = np.ptp(points.reshape(-1, 3), axis=0)
    axis = int(np.argmin(size))
    return along("xyz"[axis]) if size[axis] <= 1e-6 * size.max() else iso()
