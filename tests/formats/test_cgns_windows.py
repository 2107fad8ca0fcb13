"""Sets of nodes and faces as rectangles on block faces, against brute force over single quads."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from meshdeform_core.grid import Side, Window
from meshdeform_core.grid.windows import windows_of_quads
from meshdeform_formats.cgns.boundary import windows_of_nodes


def quads_of(window: Window, shape: tuple[int, int, int]) -> set[tuple[int, int, int]]:
    """Quads of a window as (side, a, b); across the plane of a 2-D block there is one."""
    a, b = window.side.tangential
    spans = [
        range(low, high) if shape[axis] > 1 else range(1)
        for axis, low, high in zip((a, b), window.low, window.high, strict=True)
    ]
    return {(int(window.side), i, j) for i in spans[0] for j in spans[1]}


@settings(max_examples=50)
@given(quads=st.tuples(st.integers(1, 6), st.integers(1, 6)).flatmap(lambda shape: arrays(bool, shape)))
def test_rectangles_cover_the_marked_quads_once(quads):
    shape = (quads.shape[0] + 1, 4, quads.shape[1] + 1)
    windows = windows_of_quads(shape, 3, Side.JMAX, quads)
    covered = [quad for window in windows for quad in quads_of(window, shape)]
    assert len(covered) == len(set(covered))
    assert {(i, j) for _, i, j in covered} == set(zip(*np.nonzero(quads), strict=True))
    assert all(window.block == 3 and window.side == Side.JMAX for window in windows)


@pytest.mark.parametrize("shape", [(4, 3, 5), (2, 3, 4), (4, 5, 1)])
@settings(max_examples=25)
@given(data=st.data())
def test_nodes_give_the_quads_whose_corners_are_all_listed(shape, data):
    member = data.draw(arrays(bool, shape))
    nodes = data.draw(st.permutations(np.argwhere(member).tolist()))
    windows, unused = windows_of_nodes(shape, 0, np.array(nodes, np.int64).reshape(-1, 3))
    expected, used = set(), np.zeros(shape, bool)
    for side in Side:
        if shape[side.axis] == 1:
            continue
        face = np.moveaxis(member, side.axis, 0)[-1 if side % 2 else 0]
        seen = np.moveaxis(used, side.axis, 0)[-1 if side % 2 else 0]
        spans = [range(max(n - 1, 1)) for n in face.shape]
        for i in spans[0]:
            for j in spans[1]:
                if face[i : i + 2, j : j + 2].all():
                    expected.add((int(side), i, j))
                    seen[i : i + 2, j : j + 2] = True
    assert {quad for window in windows for quad in quads_of(window, shape)} == expected
    assert unused == (member & ~used).sum()
