"""TFI of block interfaces: vertices and edges that nothing but the graph of block edges moves."""

import itertools

import numpy as np
from cases import apply, constant, problem_of

from meshdeform_core.boundary import BoundarySpec, Kind
from meshdeform_core.grid import Grid
from meshdeform_core.methods import Options

STRETCH = 0.3


def box(x: np.ndarray, y: float) -> np.ndarray:
    return np.stack(np.meshgrid(x, y + np.linspace(0, 1, 4), np.linspace(0, 1, 5), indexing="ij"), -1)


def stretched(grid: Grid, low: str, high: str) -> np.ndarray:
    """Displacement with one face held, another moved along x, and all others free to slide."""
    specs = [
        BoundarySpec("held", (low,), Kind.FIXED),
        BoundarySpec("moved", (high,), Kind.MOVING, None, constant(STRETCH, 0, 0)),
        BoundarySpec("sides", ("*",), Kind.SLIP),
    ]
    problem = problem_of(grid, specs)
    sources = problem.source_points
    end = np.isclose(sources[:, 0], sources[:, 0].max())
    return apply(Options("tfi"), problem, np.where(end[:, None], [STRETCH, 0, 0], 0.0))


def test_vertices_between_walls_are_harmonic():
    ends = (0.0, 0.2, 1.1, 1.5)
    chain = [box(np.linspace(a, b, 6), 0.0) for a, b in itertools.pairwise(ends)]
    # Nothing holds or moves the last block: it stays.
    grid = Grid.from_blocks([*chain, box(np.linspace(0, 1, 3), 5.0)])
    moved = stretched(grid, "block1.imin", "block3.imax")
    tied = grid.points[:, 1] < 2
    np.testing.assert_allclose(moved[tied, 0], STRETCH * grid.points[tied, 0] / 1.5, atol=1e-13)
    assert np.abs(moved[:, 1:]).max() < 1e-13
    assert not moved[~tied].any()


def test_edges_that_close_in_themselves_move_with_their_vertex():
    r, turn = np.meshgrid([1.0, 1.5, 2.0], np.linspace(0, 2 * np.pi, 13), indexing="ij")
    ring = np.stack([0 * r, r * np.cos(turn), r * np.sin(turn)], -1)
    ring[:, -1] = ring[:, 0]
    blocks = [ring + np.array([1.0, 0, 0]) * np.linspace(a, b, 4)[:, None, None, None] for a, b in ((0, 1), (1, 3))]
    grid = Grid.from_blocks(blocks)
    moved = stretched(grid, "block1.imin", "block2.imax")
    np.testing.assert_allclose(moved[:, 0], STRETCH * grid.points[:, 0] / 3, atol=1e-13)
