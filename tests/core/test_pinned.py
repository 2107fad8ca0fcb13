"""Cells whose nodes are all prescribed: told when the boundary's own motion inverts them."""

import numpy as np
import pytest
from cases import everything_moves, formulas, problem_of, turning
from grids import block_around, frame, frame_2d

from meshdeform_core.boundary.classification import prescribed_displacement
from meshdeform_core.grid import Grid
from meshdeform_core.quality.listed import find_pinned
from meshdeform_core.quality.original import Original


def pinned(grid, motion):
    problem = problem_of(grid, everything_moves(motion))
    displacement = prescribed_displacement(grid, problem.topology, problem.boundary)
    return find_pinned(Original(grid, problem.topology), problem.boundary, displacement)


def slab(cells_across=1):
    line = np.linspace(0.0, 1.0, 5)
    return Grid.from_blocks([block_around(line, line, np.linspace(0.0, 0.1, cells_across + 1))])


@pytest.mark.parametrize("grid", [slab(), frame(3, 1), frame_2d(3)], ids=["slab", "frame", "2-d"])
def test_rigid_motion_inverts_nothing(grid):
    assert pinned(grid, turning(170.0)) is None


def test_a_layer_turned_inside_out_is_told_with_its_place():
    """Where x > 0.6 the upper face goes below the lower one: the cells from there on, 4 in a row."""
    found = pinned(slab(), formulas("0", "0", "where(x > 0.6 and z > 0.05, -0.2, 0)"))
    assert found is not None
    # Between the nodes at 0.5 and 0.75 only two of the corners have changed their sign.
    assert "8 cells, whose nodes are all prescribed, are inverted" in found
    assert "first in block1 at (3, 1, 1)" in found


def test_nodes_inside_can_still_give_way():
    """Two cells across: the nodes between are free, whatever the boundary does."""
    grid = slab(4)
    found = pinned(
        grid, formulas("0", "0", "where(z > 0.09, -0.2, 0) * where(x > 0.2 and x < 0.8 and y > 0.2 and y < 0.8, 1, 0)")
    )
    assert found is None


def test_corner_of_a_plane_grid():
    """The cell at the corner of a square block has four nodes on its boundary only if it is one cell wide."""
    line = np.linspace(0.0, 1.0, 4)
    grid = Grid.from_blocks([block_around(line, np.array([0.0, 0.2]), np.zeros(1))])
    found = pinned(grid, formulas("0", "where(y > 0.1 and x < 0.1, -0.3, 0)", "0"))
    assert found is not None
    assert "1 cell, whose nodes are all prescribed, is inverted" in found
    assert "first in block1 at (1, 1, 1)" in found


def test_collapsed_corners_are_not_judged():
    """A wedge whose inner face is a line."""
    grid = slab()
    points = grid.points.copy()
    points[points[:, 0] == 0.0, 2] = 0.0
    assert pinned(grid.moved(points), turning(40.0)) is None
