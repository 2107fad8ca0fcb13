"""Components of blocks in the order of files, against numpy's transposition."""

import numpy as np
import pytest

from meshdeform_core.parallel import set_threads
from meshdeform_formats import coordinates
from meshdeform_formats.coordinates import ahead, merge, split


@pytest.fixture(params=[1, 2])
def threads(request):
    set_threads(request.param)
    yield request.param
    set_threads(None)


@pytest.mark.parametrize("count", [2, 3])
@pytest.mark.parametrize("together", [0, 1 << 28])
def test_blocks_are_split_and_merged(threads, count, together, monkeypatch):
    monkeypatch.setattr(coordinates, "_TOGETHER", together)
    block = np.random.default_rng(0).random((4, 19, 5, 3))
    arrays = list(split(block, np.dtype(">f4"), count))
    assert len(arrays) == count
    for axis, array in enumerate(arrays):
        assert array.flags.c_contiguous
        np.testing.assert_array_equal(array, block[..., axis].T.astype(">f4"))
    again = np.full_like(block, -1.0)
    merge(again, iter([block[..., axis].T.copy().ravel() for axis in range(count)]), count)
    np.testing.assert_array_equal(again[..., :count], block[..., :count])
    assert (again[..., count:] == -1.0).all()


def test_items_made_ahead_keep_their_order_and_errors(threads):
    assert list(ahead(n * n for n in range(20))) == [n * n for n in range(20)]
    assert list(ahead([])) == []

    def failing():
        yield 1
        raise ValueError("in the middle")

    items = ahead(failing())
    assert next(items) == 1
    with pytest.raises(ValueError, match="in the middle"):
        next(items)
