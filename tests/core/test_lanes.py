"""Vector code against numpy, sixteen numbers at a time."""

import numpy as np
import pytest

from meshdeform_core.numerics.jit import kernel
from meshdeform_core.numerics.lanes import WIDTH, components, lanes

RNG = np.random.default_rng(2)


@lanes
def _arithmetic(a, b, out, start):
    x, y = a.load(start), b.load(start)
    found = [x + y, x - y, x * y, 1.0 - x, x.min(y), x.max(y), x.below(y).choose(x, 7.0), (x * x).sqrt(), 2.0 / y]
    found.append((x.below(y) & x.below(0.0)).choose(y, x))
    for row, value in enumerate(found):
        out.store(start, value, row * WIDTH)


@lanes
def _move(one, at, other, to, count):
    other.store_some(to, one.load_some(at, count), count)


@lanes
def _split(points, start, out):
    for axis, value in enumerate(components([part.single() for part in points.load_points(start)])):
        out.store(start, value, axis * WIDTH)


@lanes
def _count(numbers, start, bins):
    bins.count(start, numbers.load(start), 8)


@lanes
def _bits(numbers, start, out, factor):
    out.store(start, numbers.load(start) * factor)
    out.store(start, numbers.load(start).bits().from_bits(), WIDTH)


@kernel
def _all(a, b, out, points, xyz, bins, scaled):
    _arithmetic(a, b, out, 0)
    _split(points, 0, xyz)
    _count(b, 0, bins)
    _bits(b, 0, scaled, np.float32(3.0))


@kernel
def _copy(one, other, count):
    _move(one, 1, other, 2, count)


def test_operations_are_those_of_numpy():
    a, b = (RNG.standard_normal(WIDTH).astype(np.float32) for _ in range(2))
    b = np.abs(b) + np.float32(0.5)
    a[3] = b[3]
    bins_of = np.minimum(b, 7.0)
    points = RNG.standard_normal((WIDTH, 3))
    out, xyz, scaled = (np.empty(n * WIDTH, np.float32) for n in (10, 3, 2))
    bins = np.zeros(8 * WIDTH, np.int32)
    _all(a, b, out, points.reshape(-1), xyz, bins, scaled)
    expected = [
        a + b, a - b, a * b, 1 - a, np.minimum(a, b), np.maximum(a, b), np.where(a < b, a, 7), np.abs(a), 2 / b,
        np.where((a < b) & (a < 0), b, a),
    ]  # fmt: skip
    np.testing.assert_allclose(out.reshape(10, WIDTH), expected, rtol=3e-7)
    np.testing.assert_array_equal(xyz.reshape(3, WIDTH), points.T.astype(np.float32))
    np.testing.assert_allclose(scaled[:WIDTH], 3 * b, rtol=1e-7)
    # Bits of a number as a number of 24 digits.
    np.testing.assert_allclose(scaled[WIDTH:], b, rtol=1e-4)
    found = bins.reshape(WIDTH, 8)
    np.testing.assert_array_equal(found.argmax(axis=1), bins_of.astype(int))
    assert (found.sum(axis=1) == 1).all()


@pytest.mark.parametrize("count", [-3, 0, 1, 7, 16, 20])
def test_masked_copies_touch_only_what_they_may(count):
    one, other = np.arange(20.0), np.zeros(20)
    _copy(one, other, count)
    expected = np.zeros(20)
    size = min(max(count, 0), WIDTH)
    expected[2 : 2 + size] = one[1 : 1 + size]
    np.testing.assert_array_equal(other, expected)


def test_arrays_with_gaps_are_refused():
    with pytest.raises(Exception, match="not contiguous"):
        _copy(np.arange(40.0)[::2], np.zeros(20), 3)
