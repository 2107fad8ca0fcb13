"""A swept, tapered half wing on a symmetry plane pitches and bends with a structural surface, 3-D."""

import numpy as np

from meshdeform_core.boundary.tables import SurfaceData
from meshdeform_core.grid import FloatArray, Grid

from ..building import geometric, with_patches

DEFAULT_SIZE = 24
SIZES = {"small": 12, "medium": 24, "large": 64}
SIZE_HELP = "cells along the chord, a multiple of 4: 24 gives 93 k cells, 64 gives 1.8 M"

_SPAN, _TIP_CHORD, _SWEEP = 2.0, 0.5, 0.6
_THICKNESS = 0.1
_FAR = 5.0
_WALL_CELL = 2e-3
_PITCH, _BENDING = 6.0, 0.15
_QUARTER_CHORD = 0.25


def generate(size: int = DEFAULT_SIZE) -> Grid:
    """Two blocks, above and below the wing: ``size`` cells along the chord, as many along the span and outwards.

    The root chord is 1, the span 2; the thickness of the biconvex section goes to zero towards the tip, so that the
    wing is part of a face of each block and the rest of the face is their interface.
    """
    if size < 8 or size % 4:
        raise ValueError(f"size = {size} cells along the chord; expected a multiple of 4, at least 8")
    # Positions in chords: finer at both edges of the wing, stretched to the far field.
    inside = 0.5 * (1.0 - np.cos(np.linspace(0.0, np.pi, size + 1)))
    away = geometric(float(inside[1]), size // 2, _FAR)
    chord = np.concatenate([-away[:0:-1], inside, 1.0 + away[1:]])
    along = np.sin(np.linspace(0.0, np.pi / 2, size + 1))
    beyond = geometric(float(1.0 - along[-2]), size // 2, 2.0)[1:]
    span = _SPAN * np.concatenate([along, 1.0 + beyond])
    height = geometric(_WALL_CELL, size, _FAR)
    y = span[None, :]
    x = _leading_edge(y) + chord[:, None] * _chord(y)
    # The height of the section fades outwards, so that the far field is flat.
    half = _half_thickness(chord[:, None], y)[..., None] * (1.0 - height / _FAR)
    shape = (len(chord), len(span), len(height))
    upper = np.empty((*shape, 3))
    upper[..., 0], upper[..., 1], upper[..., 2] = x[..., None], y[..., None], half + height
    lower = upper[:, :, ::-1] * [1.0, 1.0, -1.0]
    return with_patches(
        Grid.from_blocks([upper, lower], ["upper", "lower"]),
        [
            ("symmetry", "BCSymmetryPlane", lambda c, side: c[:, 1] == 0.0),
            # Faces between the two blocks that are not interfaces.
            ("wing", "BCWall", lambda c, side: (side.axis == 2) & (np.abs(c[:, 2]) < 0.5 * _FAR)),
            ("far", "BCFarfield", lambda c, side: np.full(len(c), True)),
        ],
    )


def tables(size: int = DEFAULT_SIZE) -> dict[str, SurfaceData]:
    """``structure.npz``: both skins of the wing as 16 x 12 panels of a structural model, for any size of the grid."""
    u, v = np.meshgrid(0.5 * (1.0 - np.cos(np.linspace(0.0, np.pi, 17))), np.linspace(0.0, 1.0, 13), indexing="ij")
    y = _SPAN * v
    x = _leading_edge(y) + u * _chord(y)
    skins = [np.stack([x, y, sign * _half_thickness(u, y)], axis=-1).reshape(-1, 3) for sign in (1.0, -1.0)]
    number = np.arange(u.size).reshape(u.shape)
    a, b, c, d = (part.ravel() for part in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    points, skin = np.concatenate(skins), np.concatenate([triangles, triangles + u.size])
    # Pitch, nose up, about the quarter chord of the root, then bending upwards with the square of the span.
    angle = np.deg2rad(_PITCH)
    x, z = points[:, 0] - _QUARTER_CHORD, points[:, 2]
    displacement = np.zeros_like(points)
    displacement[:, 0] = np.cos(angle) * x + np.sin(angle) * z - x
    displacement[:, 2] = np.cos(angle) * z - np.sin(angle) * x - z + _BENDING * _SPAN * (points[:, 1] / _SPAN) ** 2
    return {"structure.npz": SurfaceData(points, displacement, skin, "structure.npz")}


def _leading_edge(y: FloatArray) -> FloatArray:
    return _SWEEP * np.minimum(y, _SPAN)


def _chord(y: FloatArray) -> FloatArray:
    return 1.0 - (1.0 - _TIP_CHORD) * np.minimum(y / _SPAN, 1.0)


def _half_thickness(u: FloatArray, y: FloatArray) -> FloatArray:
    """Of the biconvex section at ``u`` chords behind its leading edge; zero outside the wing."""
    inside = np.clip(u * (1.0 - u), 0.0, None)
    tip = np.sqrt(np.clip(1.0 - (y / _SPAN) ** 2, 0.0, None))
    return np.asarray(2.0 * _THICKNESS * inside * _chord(y) * tip)
