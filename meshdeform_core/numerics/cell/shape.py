"""Shape of cells, and how it changes between neighbours along grid lines."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..arrays import FloatArray, IntArray

ASPECT, GROWTH, NONORTHOGONALITY, SKEWNESS, WRONG_PYRAMIDS, FLATTEST_PYRAMID = range(6)
_ROUND_OFF = 1e-15
"""Volume by which a pyramid may be negative: OpenFOAM's SMALL."""


def measure_shape(x: FloatArray, resolved: IntArray, sign: float) -> Iterator[tuple[int, int, FloatArray]]:
    """Six measures of the cells of a block with nodes ``x`` (ni, nj, nk, 3), at least two along every axis.

    Yields number, axis and values of each. Of all cells (axis -1): the aspect ratio, how many of the six pyramids
    between a face and the centre of the cell are negative, and minus the smallest of their volumes. Between neighbours
    along an axis (one value less along it): their growth ratio, non-orthogonality (degrees) and skewness. ``resolved``
    (3,) is 1 along index axes with more than one cell; the other axes do not enter the aspect ratio. ``sign``:
    handedness of the block. Centres and areas of faces, and centres of cells, are those of OpenFOAM's primitiveMesh.
    """
    sizes = [_mean(np.linalg.norm(np.diff(x, axis=a), axis=-1), [b for b in range(3) if b != a]) for a in range(3)]
    used = [size for size, some in zip(sizes, resolved, strict=True) if some]
    yield ASPECT, -1, _ratio(np.maximum.reduce(used), np.minimum.reduce(used))
    faces = [_face_centres(x, axis, sign) for axis in range(3)]
    # Centre and outward area of each of the six faces of every cell.
    around = [
        (center, out * area)
        for axis, face in enumerate(faces)
        for out, center, area in zip((-1.0, 1.0), *(_ends(values, axis) for values in face), strict=True)
    ]
    middle = sum(center for center, _ in around) / 6.0
    pyramids = [_dot(area, center - middle)[..., None] for center, area in around]
    moments = (volume * (0.75 * face + 0.25 * middle) for volume, (face, _) in zip(pyramids, around, strict=True))
    volume = sum(pyramids)
    centers = np.divide(sum(moments), volume, out=middle.copy(), where=volume != 0.0)
    heights = np.stack([_dot(area, center - centers) / 3.0 for center, area in around])
    yield WRONG_PYRAMIDS, -1, (heights < -_ROUND_OFF).sum(axis=0, dtype=np.float64)
    yield FLATTEST_PYRAMID, -1, -heights.min(axis=0)
    for a in range(3):
        if x.shape[a] < 3:
            continue
        low, high = _ends(sizes[a], a)
        yield GROWTH, a, _ratio(np.maximum(low, high), np.minimum(low, high))
        face, area = (np.take(values, range(1, x.shape[a] - 1), axis=a) for values in faces[a])
        center, beyond = _ends(centers, a)
        step = beyond - center
        dot, along, square, normal = _dot(step, area), _dot(face - center, area), _dot(step, step), _dot(area, area)
        sound = (dot != 0.0) & (square != 0.0) & (normal != 0.0)
        dot, along, square, normal = (np.where(sound, each, 1.0) for each in (dot, along, square, normal))
        # Angle between the line joining two cell centres and the normal of their common face.
        cosine = np.clip(dot / np.sqrt(square * normal), -1.0, 1.0)
        yield NONORTHOGONALITY, a, np.where(sound, np.degrees(np.arccos(cosine)), 0.0)
        # Distance from where that line meets the face to the centre of the face, relative to the length of the line.
        miss = face - center - (along / dot)[..., None] * step
        yield SKEWNESS, a, np.where(sound, np.sqrt(_dot(miss, miss) / square), 0.0)


def _face_centres(x: FloatArray, axis: int, sign: float) -> tuple[FloatArray, FloatArray]:
    """Centres and areas along the index axis of the quads across it: means of four triangles about the mean corner."""
    b, c = (axis + 1) % 3, (axis + 2) % 3
    (p00, p01), (p10, p11) = (_ends(part, c) for part in _ends(x, b))
    corners, middle = (p00, p10, p11, p01), 0.25 * (p00 + p10 + p11 + p01)
    weighted, total = np.zeros_like(middle), np.zeros((*middle.shape[:-1], 1))
    for one, two in zip(corners, (*corners[1:], p00), strict=True):
        size = np.linalg.norm(np.cross(one - middle, two - middle), axis=-1, keepdims=True)
        weighted += size * (one + two + middle) / 3.0
        total += size
    center = np.divide(weighted, total, out=middle, where=total != 0.0)
    return center, 0.5 * sign * np.cross(p11 - p00, p01 - p10)


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("...i,...i", a, b))


def _ends(values: FloatArray, axis: int) -> tuple[FloatArray, FloatArray]:
    """All values but the last along an axis, and all but the first."""
    n = values.shape[axis]
    return np.take(values, range(n - 1), axis=axis), np.take(values, range(1, n), axis=axis)


def _mean(values: FloatArray, axes: list[int]) -> FloatArray:
    """Means of successive values along some axes."""
    for axis in axes:
        low, high = _ends(values, axis)
        values = 0.5 * (low + high)
    return values


def _ratio(high: FloatArray, low: FloatArray) -> FloatArray:
    """Ratio of two lengths; 1, which counts for nothing, where the smaller one is collapsed."""
    return np.divide(high, low, out=np.ones_like(high), where=(low > 0.0) & (low < np.inf))
