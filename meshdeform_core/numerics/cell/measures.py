"""Shape measures of cells: Jacobians, skewness metric and volume."""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray


def measure_quads(x: FloatArray, normal: FloatArray) -> tuple[np.ndarray, ...]:
    """Measures of the cells of a 2-D block with nodes ``x`` (na, nb, 3) whose valid cells have Jacobians along
    ``normal`` (3,).

    Returns
    -------
    skew, scaled, jacobian, area : (na - 1, nb - 1), f_skew = 4 / sum over corners of sqrt(l11 l22) / a, 0 if any
        a <= 0 (Knupp 2003); smallest corner Jacobian, divided by its two edge lengths, and plain
    bad : (na - 1, nb - 1) uint8, bit c set where corner c = 2 a + b at (a, b) has a Jacobian <= 0
    """
    one, two = np.diff(x, axis=0), np.diff(x, axis=1)
    shape = one.shape[0], two.shape[1]
    total, bad = np.zeros(shape), np.zeros(shape, dtype=np.uint8)
    lowest, scaled = np.full(shape, np.inf), np.full(shape, np.inf)
    for c in range(4):
        u, v = one[:, c & 1 :][:, : shape[1]], two[c >> 1 :][: shape[0]]
        jacobian, size = _area(normal, u, v), np.sqrt(_square(u) * _square(v))
        good = jacobian > 0.0
        lowest = np.minimum(lowest, jacobian)
        scaled = np.minimum(scaled, np.divide(jacobian, size, out=np.zeros(shape), where=size > 0.0))
        total += np.divide(size, jacobian, out=np.zeros(shape), where=good)
        bad |= np.where(good, 0, 1 << c).astype(np.uint8)
    skew = np.where(bad > 0, 0.0, np.minimum(4.0 / np.where(bad > 0, 4.0, total), 1.0))
    area = 0.5 * _area(normal, x[1:, 1:] - x[:-1, :-1], x[:-1, 1:] - x[1:, :-1])
    return skew, scaled, lowest, area, bad


def _area(normal: FloatArray, u: FloatArray, v: FloatArray) -> FloatArray:
    """Areas of the parallelograms of two edges (..., 3), seen along a ``normal`` (3,)."""
    x, y, z = np.moveaxis(np.cross(u, v), -1, 0)
    return np.asarray(normal[0] * x + normal[1] * y + normal[2] * z)


def _square(u: FloatArray) -> FloatArray:
    return u[..., 0] * u[..., 0] + u[..., 1] * u[..., 1] + u[..., 2] * u[..., 2]


def scattered_hexahedra(x: FloatArray, sign: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Measures of cells with corners ``x`` (m, 8, 3), corner (a, b, c) at 4 a + 2 b + c.

    ``sign`` (m,) is the handedness of the block of each cell.

    Returns
    -------
    skew : (m,) f_skew = 8 / sum over corners of (sqrt(l11 l22 l33) / a)^(2/3), 0 if any a <= 0 (Knupp 2003)
    scaled : (m,) smallest corner Jacobian divided by its three edge lengths
    jacobian : (m, 8) corner Jacobians (length^3)
    volume : (m,) exact volume of the trilinear cell
    """
    corner = np.arange(8)
    u, v, w = (x[:, corner | bit] - x[:, corner & ~bit] for bit in (4, 2, 1))
    jacobian = sign[:, None] * np.einsum("mci,mci->mc", np.cross(u, v), w)
    size = np.sqrt(np.prod([np.einsum("mci,mci->mc", e, e) for e in (u, v, w)], axis=0))
    with np.errstate(divide="ignore", invalid="ignore"):
        scaled = np.where(size > 0.0, jacobian / size, 0.0)
        terms = np.where(scaled > 0.0, np.maximum(scaled, 1e-200) ** (-2.0 / 3.0), np.inf).sum(axis=1)
    mean = np.einsum("mi,mi->m", np.cross(u.mean(axis=1), v.mean(axis=1)), w.mean(axis=1))
    # See :mod:`.inspection`.
    volume = (2.0 * sign * mean + jacobian.mean(axis=1)) / 3.0
    return np.minimum(8.0 / terms, 1.0), scaled.min(axis=1), jacobian, volume
