"""Where blocks are cut into virtual sub-blocks."""

import numpy as np
import pytest
from cases import body_specs, problem_of, turning
from grids import frame

from meshdeform_core.boundary import BoundarySpec, Kind
from meshdeform_core.grid import Grid
from meshdeform_core.methods import TFI
from meshdeform_core.methods.transfinite.tfi import make_skeleton


def arc(cells, degrees):
    """A block whose lines along i turn by an angle in all, evenly."""
    angle, radius, z = np.deg2rad(np.linspace(0.0, degrees, cells + 1)), np.linspace(1.0, 2.0, 5), np.arange(3.0)
    a, r, h = np.meshgrid(angle, radius, z, indexing="ij")
    return problem_of(Grid.from_blocks([np.stack([r * np.cos(a), r * np.sin(a), h], axis=-1)]), fixed())


def fixed():
    return [BoundarySpec("all", ("*",), Kind.FIXED)]


@pytest.mark.parametrize(("degrees", "parts"), [(0.01, 2), (98.0, 2), (112.0, 4), (180.0, 4)])
def test_lines_that_turn_are_cut_twice_as_often(degrees, parts):
    """32 cells in two pieces of 16, each of which turns by half of the angle but one of its 32 steps."""
    i, j, k = make_skeleton(arc(32, degrees), 16).cuts[0]
    np.testing.assert_array_equal(i, np.linspace(0, 32, parts + 1))
    assert len(j) == len(k) == 2


def test_straight_lines_and_lines_without_length_do_not_turn():
    block = np.stack(np.meshgrid(np.arange(33.0), np.arange(5.0), np.arange(3.0), indexing="ij"), axis=-1)
    block[:, 0] = block[0, 0]
    problem = problem_of(Grid.from_blocks([block]), fixed())
    assert len(make_skeleton(problem, 16).cuts[0][0]) == 3


def test_blocks_with_straight_lines_have_sub_blocks_of_the_given_size():
    problem = problem_of(frame(), body_specs(turning(20)))
    for block, cuts in enumerate(make_skeleton(problem, 4).cuts):
        for cut, n in zip(cuts, problem.grid.shapes[block], strict=True):
            assert cut[0] == 0
            assert cut[-1] == n - 1
            assert np.diff(cut).max() <= 4


@pytest.mark.parametrize(("nodes", "cells"), [(1_000, 4), (50_000, 4), (60_000, 8), (200_000, 8), (300_000, 16)])
def test_small_grids_have_small_sub_blocks(nodes, cells):
    """With 1000 sources 5e7 pairs are 50,000 nodes."""

    class Case:
        n_unique_nodes = nodes
        source_numbers = range(1000)

    assert TFI().cells(Case) == cells
    assert TFI(0).cells(Case) == 0
