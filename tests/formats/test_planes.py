"""Ranges of planes and stretches of bytes, against plain lists; files that are not there or too short."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Grid
from meshdeform_core.parallel import set_threads
from meshdeform_formats import planes
from meshdeform_formats.planes import Output, Stored, Stretches, merge, ranges_of, split, write_outputs

SIDES = st.integers(1, 2000)


@settings(max_examples=30)
@given(st.lists(st.tuples(st.integers(0, 9), st.integers(1, 7)), min_size=1, max_size=6), st.data())
def test_bytes_lie_where_their_stretches_are(gaps, data):
    stretches, every, at = [], [], 0
    for gap, length in gaps:
        stretches.append((at + gap, length))
        every += range(at + gap, at + gap + length)
        at += gap + length
    first = data.draw(st.integers(0, len(every)))
    last = data.draw(st.integers(first, len(every)))
    found = list(Stretches(stretches).places(first, last))
    assert [place for offset, length in found for place in range(offset, offset + length)] == every[first:last]
    assert len(found) <= len(stretches)


@settings(max_examples=30)
@given(st.lists(st.tuples(SIDES, SIDES, SIDES), min_size=1, max_size=5))
def test_ranges_are_all_planes_once(shapes):
    parts = ranges_of(list(enumerate(shapes)))
    assert [(part.block, k) for part in parts for k in range(part.first, part.last)] == [
        (block, k) for block, shape in enumerate(shapes) for k in range(shape[2])
    ]
    for block, first, last in parts:
        ni, nj, nk = shapes[block]
        assert last - first >= 8 or last == nk
        assert ni * nj * (last - first) <= max(1 << 18, 8 * ni * nj)


def test_a_folder_that_a_rank_does_not_see(tmp_path):
    place = Stored(tmp_path / "elsewhere" / "part.xyz", np.dtype(float), (1, 2), 0, 16)
    with pytest.raises(FormatError, match=r"does not see .*part\.xyz, to which all ranks write; choose"):
        place.write(0, np.zeros((1, 1, 2)))


def test_a_file_that_is_cut_while_it_is_read(tmp_path):
    (tmp_path / "grid.xyz").write_bytes(bytes(31))
    with pytest.raises(FormatError, match=r"grid\.xyz ends before all of its coordinates"):
        Stored(tmp_path / "grid.xyz", np.dtype(float), (1, 2), 0, 16).read(0, 2)


@pytest.mark.parametrize(("dims", "size", "reason"), [
    ((3, 4, 2), 192, "a plane has 4 x 3 values; the file has room for 3 x 4"),
    ((4, 3), 96, "a block has 4 x 3 x 2 values of 192 bytes; the file has room for 96 bytes"),
    ((4, 3, 2), 200, "192 bytes; the file has room for 200 bytes"),
])  # fmt: skip
def test_values_and_the_room_for_them_differ_in_size(dims, size, reason, tmp_path):
    """Nothing is written: it could be past the end of the array."""
    (tmp_path / "grid").write_bytes(b"." * 300)
    place = Stored.within_rind(tmp_path / "grid", np.dtype(float), dims, 50, size=size)
    with pytest.raises(FormatError, match=reason):
        write_outputs(Grid.allocate([(4, 3, 2)]), [Output.of_values(0, (4, 3, 2), np.ones((4, 3, 2)), [place])])
    assert (tmp_path / "grid").read_bytes() == b"." * 300


def test_room_without_rind_planes(tmp_path):
    (tmp_path / "grid").write_bytes(b"." * 300)
    core = [slice(1, 3), slice(0, 2), slice(1, 2)]
    place = Stored.within_rind(tmp_path / "grid", np.dtype(float), (3, 2, 4), 0, core, 192)
    place.require_room((2, 2, 1))
    with pytest.raises(FormatError, match="room for 48 bytes"):
        place.require_room((2, 2, 2))


@pytest.fixture(params=[1, 2])
def threads(request):
    set_threads(request.param)
    yield request.param
    set_threads(None)


@pytest.mark.parametrize("count", [2, 3])
@pytest.mark.parametrize("together", [0, 1 << 28])
def test_blocks_are_split_and_merged(threads, count, together, monkeypatch):
    monkeypatch.setattr(planes, "_TOGETHER", together)
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
