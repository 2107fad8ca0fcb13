"""Sets of nodes and faces as rectangles on block faces, against brute force over single quads."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from meshdeform_core.grid import Side, Window
from meshdeform_core.grid.windows import windows_of_quads


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
