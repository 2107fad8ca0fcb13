"""Shape of cells, and how it changes between neighbours along grid lines."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..arrays import FloatArray, IntArray

ASPECT, GROWTH, NONORTHOGONALITY, SKEWNESS = 0, 1, 2, 3


def measure_shape(x: FloatArray, resolved: IntArray) -> Iterator[tuple[int, int, FloatArray]]:
    """Four measures of the cells of a block with nodes ``x`` (ni, nj, nk, 3), at least two along every axis.

    Yields number, axis and values of each: the aspect ratio (axis -1) of all cells and, between neighbours along an
    axis (one value less along it), their growth ratio, non-orthogonality (degrees) and skewness. ``resolved`` (3,) is 1
    along index axes with more than one cell; the other axes do not enter the aspect ratio.
    """
    sizes = [_mean(np.linalg.norm(np.diff(x, axis=a), axis=-1), [b for b in range(3) if b != a]) for a in range(3)]
    used = [size for size, some in zip(sizes, resolved, strict=True) if some]
    yield ASPECT, -1, _ratio(np.maximum.reduce(used), np.minimum.reduce(used))
    centers = _mean(x, [0, 1, 2])
    for a in range(3):
        if x.shape[a] < 3:
            continue
        low, high = _ends(sizes[a], a)
        yield GROWTH, a, _ratio(np.maximum(low, high), np.minimum(low, high))
        inner = np.take(x, range(1, x.shape[a] - 1), axis=a)
        b, c = (a + 1) % 3, (a + 2) % 3
        (p00, p01), (p10, p11) = (_ends(part, c) for part in _ends(inner, b))
        face, area = 0.25 * (p00 + p10 + p01 + p11), np.cross(p11 - p00, p01 - p10)
        yield from _across(a, *_ends(centers, a), face, area)


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


def _across(
    axis: int, center: FloatArray, beyond: FloatArray, face: FloatArray, area: FloatArray
) -> Iterator[tuple[int, int, FloatArray]]:
    """Angle (degrees) between the line joining two cell centres and the normal of their common face; skewness there.

    Skewness: distance between the intersection of that line with the face and the centre of the face, relative to the
    length of the line.
    """
    step = beyond - center
    dot, along = (np.einsum("...i,...i", each, area) for each in (step, face - center))
    square, normal = (np.einsum("...i,...i", each, each) for each in (step, area))
    sound = (dot != 0.0) & (square != 0.0) & (normal != 0.0)
    dot, along, square, normal = (np.where(sound, each, 1.0) for each in (dot, along, square, normal))
    cosine = np.minimum(np.abs(dot) / np.sqrt(square * normal), 1.0)
    yield NONORTHOGONALITY, axis, np.where(sound, np.degrees(np.arccos(cosine)), 0.0)
    miss = face - center - (along / dot)[..., None] * step
    yield SKEWNESS, axis, np.where(sound, np.sqrt(np.einsum("...i,...i", miss, miss) / square), 0.0)
