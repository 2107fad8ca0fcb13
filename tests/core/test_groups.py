"""Invalid cells by place: connected across blocks, the nearest moving wall, the worst of each."""

from __future__ import annotations

import numpy as np
import pytest
from grids import block_around, frame_2d

from meshdeform_core.grid import Grid
from meshdeform_core.grid.topology import find_topology
from meshdeform_core.quality import Original, assess
from meshdeform_core.quality.listed import group_cells


def row_of_blocks(n=3, cells=4):
    lines = np.arange(cells + 1.0)
    return Grid.from_blocks([block_around(lines + cells * b, lines, lines) for b in range(n)])


def test_groups_reach_across_blocks_and_are_counted():
    grid = row_of_blocks()
    ratio = np.ones(grid.n_cells)
    # Cells (4, 2, 2) of block 1 and (1, 2, 2), (1, 3, 2) of block 2 touch; (4, 4, 4) of block 3 is alone.
    cells = np.array([3 * 16 + 5, 64 + 5, 64 + 9, 128 + 63])
    ratio[cells] = [-0.1, -0.7, -0.2, -0.4]
    one, two = group_cells(grid, find_topology(grid), None, grid.points, cells, ratio)
    assert (one.cells, one.blocks, one.block, one.ijk) == (3, ("block1", "block2"), "block2", (1, 2, 2))
    assert one.box == ((3.0, 1.0, 1.0), (5.0, 3.0, 2.0))
    assert (two.cells, two.block, two.ijk) == (1, "block3", (4, 4, 4))
    assert two.center == pytest.approx((11.5, 3.5, 3.5))


def test_an_assessment_groups_all_that_it_counts():
    grid = row_of_blocks()
    points = grid.points.copy()
    grid.block(0, points)[1, 1, 1] += 1.6
    grid.block(2, points)[2, 2, 2] -= 1.6
    found = assess(Original(grid, find_topology(grid)), points, None)
    assert sum(group.cells for group in found.groups) == found.after.invalid_cells > 2
    assert len(found.groups) == 2
    assert {group.nearest_patch for group in found.groups} == {""}


def test_plane_grids_have_groups_too():
    grid = frame_2d()
    points = grid.points.copy()
    grid.block(0, points)[2, 2, 0, :2] += 1.0
    (group,) = assess(Original(grid, find_topology(grid)), points, None).groups
    assert group.blocks == ("block1",)
    assert group.ijk[2] == 1


def test_nothing_invalid_has_no_groups():
    grid = row_of_blocks(1)
    assert assess(Original(grid, find_topology(grid)), grid.points, None).groups == ()
