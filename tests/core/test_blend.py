"""Transfinite interpolation of blocks against eqs. 1 and 3-9 as they are printed."""

import itertools

import numpy as np
import pytest

from meshdeform_core.grid import Grid
from meshdeform_core.methods import TFI
from meshdeform_core.methods.tfi import PreparedTFI
from meshdeform_core.numerics.blend import arcs_along_i, arcs_along_j_and_k, blend_slabs


def boolean_sum(d, arc, low, high):
    """Faces less edges plus corners of one sub-block, at all of its nodes."""
    box = tuple(slice(a, b + 1) for a, b in zip(low, high, strict=True))
    weight = [(1 - arc[box][..., axis, None], arc[box][..., axis, None]) for axis in range(3)]
    total = 0.0
    for fixed in itertools.product((False, True), repeat=3):
        if not any(fixed):
            continue
        axes = [axis for axis in range(3) if fixed[axis]]
        for ends in itertools.product((0, 1), repeat=len(axes)):
            at = list(box)
            factor = 1.0
            for axis, end in zip(axes, ends, strict=True):
                node = (low, high)[end][axis]
                at[axis] = slice(node, node + 1)
                factor = factor * weight[axis][end]
            total = total + (-1) ** (len(axes) + 1) * factor * d[tuple(at)]
    return total


@pytest.mark.parametrize("shape", [(5, 6, 7), (3, 40, 4), (40, 3, 150), (2, 5, 6), (9, 9, 2)])
def test_a_block_is_blended_from_its_faces(shape):
    rng = np.random.default_rng(1)
    d, arc = rng.normal(size=(*shape, 3)), rng.random((*shape, 3))
    low, high = (0, 0, 0), tuple(n - 1 for n in shape)
    expected = d.copy()
    inner = (slice(1, -1),) * 3
    expected[inner] = boolean_sum(d, arc, low, high)[inner]
    slabs = np.array([[0, *shape, *low, *high, i, i + 1] for i in range(1, shape[0] - 1)], dtype=np.int64)
    slabs = slabs.reshape(-1, 12)
    blend_slabs(d.reshape(-1, 3), arc.reshape(-1, 3), slabs)
    np.testing.assert_allclose(d, expected, rtol=0, atol=1e-12)


def test_arcs_run_from_zero_to_one_in_every_sub_block():
    rng = np.random.default_rng(2)
    shape, cuts = (5, 7, 6), ([0, 2, 4], [0, 3, 6], [0, 5])
    x = np.cumsum(rng.random((*shape, 3)), axis=0) + rng.random((*shape, 3))
    # Collapsed lines have uniform coordinates.
    x[2:5, 1, 1] = x[2, 1, 1]
    arc = np.full((*shape, 3), np.nan)
    i, j, k = (np.array(c) for c in cuts)
    arcs_along_i(x, i, 0, shape[1], arc)
    arcs_along_j_and_k(x, j, k, 0, shape[0], arc)
    for axis in range(3):
        length = np.linalg.norm(np.diff(np.moveaxis(x, axis, 0), axis=0), axis=-1)
        found = np.moveaxis(arc[..., axis], axis, 0)
        assert (found[0] == 0).all()
        for first, last in itertools.pairwise(cuts[axis]):
            part = np.cumsum(length[first:last], axis=0)
            uniform = np.broadcast_to((np.arange(last - first) + 1.0)[:, None, None] / (last - first), part.shape)
            expected = np.where(part[-1] > 0, part / np.where(part[-1] > 0, part[-1], 1), uniform)
            np.testing.assert_allclose(found[first + 1 : last + 1], expected, rtol=1e-14)


def test_threads_share_blocks_of_any_size():
    class Case:
        grid = Grid.from_blocks(
            [
                np.stack(np.meshgrid(*(np.arange(n) + 0.0 for n in s), indexing="ij"), -1)
                for s in ((70, 9, 4), (2, 3, 9))
            ]
        )

    skeleton = TFI(max_cells=0).skeleton(Case)
    prepared = PreparedTFI(TFI(max_cells=0), Case, skeleton)
    d = np.random.default_rng(5).normal(size=Case.grid.points.shape)
    first = Case.grid.block(0, d)
    outer = first.copy()
    arc = Case.grid.points.reshape(-1, 3)[: first.size // 3].reshape(first.shape) / [69, 8, 3]
    outer[1:-1, 1:-1, 1:-1] = boolean_sum(first, arc, (0, 0, 0), (69, 8, 3))[1:-1, 1:-1, 1:-1]
    prepared.fill(d)
    np.testing.assert_allclose(first, outer, rtol=0, atol=1e-12)
