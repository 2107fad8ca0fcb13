"""Transfinite interpolation of blocks against eqs. 1 and 3-9 as they are printed."""

import itertools
from types import SimpleNamespace

import numpy as np
import pytest
from cases import apply, constant, problem_of, told
from grids import block_around, frame, frame_2d

from meshdeform_core.boundary import BoundarySpec, Kind
from meshdeform_core.grid import Grid
from meshdeform_core.grid.topology import find_topology
from meshdeform_core.methods import TFI, Options
from meshdeform_core.methods.transfinite.tfi import Faces, PreparedTFI, make_skeleton


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


def arcs(x, cuts):
    """Coordinates (ni, nj, nk, 3) from 0 to 1 in every sub-block, of the one that a cut ends; first nodes are 0."""
    arc = np.zeros_like(x)
    for axis in range(3):
        length = np.linalg.norm(np.diff(np.moveaxis(x, axis, 0), axis=0), axis=-1)
        out = np.moveaxis(arc[..., axis], axis, 0)
        for first, last in itertools.pairwise(cuts[axis]):
            part = np.cumsum(length[first:last], axis=0)
            uniform = np.broadcast_to((np.arange(last - first) + 1.0)[:, None, None] / (last - first), part.shape)
            out[first + 1 : last + 1] = np.where(part[-1] > 0, part / np.where(part[-1] > 0, part[-1], 1), uniform)
    return arc


def lacking(d, x, tfi_of_x, low, high):
    """Image of the deviation of a sub-block from its TFI, under the affine map fitted to the corners."""
    box = tuple(slice(a, b + 1) for a, b in zip(low, high, strict=True))
    ends = tuple(np.meshgrid(*zip(low, high, strict=True), indexing="ij"))
    one = np.ones((8, 1))
    gradient = np.linalg.lstsq(np.hstack([x[ends].reshape(8, 3), one]), d[ends].reshape(8, 3), rcond=None)[0][:3]
    return (x[box] - tfi_of_x) @ gradient


def random_block(rng, shape):
    corners = np.stack(np.meshgrid(*(np.arange(n) + 0.0 for n in shape), indexing="ij"), -1)
    return corners + rng.random((*shape, 3))


@pytest.mark.parametrize(
    ("shapes", "max_cells"),
    [
        ([(40, 3, 150), (2, 5, 6), (9, 9, 2)], 0),
        ([(70, 9, 4), (2, 3, 9), (8, 37, 34)], 0),
        ([(9, 8, 7), (5, 37, 11)], 4),
        ([(20, 36, 41)], 16),
    ],
)
def test_sub_blocks_are_blended_from_their_faces(shapes, max_cells):
    rng = np.random.default_rng(1)
    blocks = [random_block(rng, shape) for shape in shapes]
    # Collapsed lines have uniform coordinates.
    blocks[-1][1], blocks[-1][2] = blocks[-1][1, :, :1], blocks[-1][2, :1]
    blocks[0][:, 1, 1] = blocks[0][0, 1, 1]

    class Case:
        grid = Grid.from_blocks(blocks)

    skeleton = TFI(max_cells).skeleton(Case)
    d = rng.normal(size=Case.grid.points.shape)
    expected = d.copy()
    for offset, *_, i0, j0, k0, i1, j1, k1, _ in skeleton.sub_blocks().tolist():
        number, ends = Case.grid.offsets.tolist().index(offset), ((i0, j0, k0), (i1, j1, k1))
        inner = tuple(slice(low + 1, high) for low, high in zip(*ends, strict=True))
        arc = arcs(blocks[number], skeleton.cuts[number])
        for axis, low in enumerate(ends[0]):
            # The low face belongs to the sub-block before, where its coordinate is 1.
            at = [slice(None)] * 3
            at[axis] = low
            arc[(*at, axis)] = 0.0
        block = Case.grid.block(number, d)
        blended = boolean_sum(block, arc, *ends)
        if max_cells:
            x = blocks[number]
            blended += lacking(block, x, boolean_sum(x, arc, *ends), *ends)
        Case.grid.block(number, expected)[inner] = blended[1:-1, 1:-1, 1:-1]
    PreparedTFI(TFI(max_cells), Case, skeleton).fill(d)
    np.testing.assert_allclose(d, expected, rtol=0, atol=1e-12)


def test_faces_are_blended_from_their_edges():
    rng = np.random.default_rng(2)
    shapes = (5, 9), (2, 4), (3, 3)
    count = sum(a * b for a, b in shapes)
    points, d = rng.random((count, 3)), rng.normal(size=(count, 3))
    # Lines without length.
    order = np.split(rng.permutation(count), np.cumsum([a * b for a, b in shapes])[:-1])
    nodes = [part.reshape(shape) for part, shape in zip(order, shapes, strict=True)]
    points[nodes[0][:, 3]], points[nodes[2][1]] = 0.5, 0.6
    wanted = [rng.random(shape) < 0.7 for shape in shapes]
    expected = d.copy()
    for part, chosen in zip(nodes, wanted, strict=True):
        s, t = (
            arcs(points[part][:, :, None], [[0, n - 1] if n > 1 else [0] for n in (*part.shape, 1)])[:, :, 0, axis]
            for axis in (0, 1)
        )
        s, t, f = s[..., None], t[..., None], d[part]
        across = (1 - s) * f[:1] + s * f[-1:] + (1 - t) * f[:, :1] + t * f[:, -1:]
        corners = (1 - s) * ((1 - t) * f[0, 0] + t * f[0, -1]) + s * ((1 - t) * f[-1, 0] + t * f[-1, -1])
        inside = np.zeros_like(chosen)
        inside[1:-1, 1:-1] = chosen[1:-1, 1:-1]
        expected[part[inside]] = (across - corners)[inside]
    start, width = np.cumsum([0, *(part.size for part in nodes)]), np.array([part.shape[1] for part in nodes])
    chosen = (np.concatenate([part.ravel() for part in each]) for each in (nodes, wanted))
    Faces(points, start, width, *chosen).blend(d)
    np.testing.assert_allclose(d, expected, rtol=0, atol=1e-13)


@pytest.mark.parametrize("grid", [frame(7, 5), frame_2d(9)], ids=["3-d", "2-d"])
def test_linear_maps_are_reproduced_where_lines_are_curved(grid):
    rng = np.random.default_rng(3)
    topology = find_topology(grid)
    x = grid.points
    waves = 0.05 * np.sin(x @ rng.normal(size=(3, 3)))
    waves[:, 2] *= grid.dimension == 3
    bent = grid.moved(x + waves)
    linear = np.eye(3) if grid.dimension == 3 else np.diag([1.0, 1.0, 0.0])
    image = bent.points @ (linear @ rng.normal(size=(3, 3)) @ linear) + 1.0 * linear.sum(axis=0)
    problem = problem_of(bent, [BoundarySpec("all", ("*",), Kind.FIXED)])
    assert topology.n_unique == problem.topology.n_unique
    for cells, exact in ((4, True), (0, False)):
        method = TFI(cells)
        skeleton = method.skeleton(problem)
        d = np.full_like(x, np.nan)
        d[skeleton.nodes()] = image[skeleton.nodes()]
        method.prepare(problem, skeleton).fill(d)
        assert np.isfinite(d).all()
        assert (np.abs(d - image).max() < 1e-11) == exact


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


def test_both_edges_between_two_vertices_are_moved():
    """Two layers of half rings in a plane, between which two edges join the same vertices."""
    turn, r = np.meshgrid(np.linspace(0, np.pi, 7), np.linspace(1.0, 2.0, 4), indexing="ij")
    halves = [np.stack([r * np.cos(turn), sign * r * np.sin(turn), 0 * r], -1)[:, :, None] for sign in (1, -1)]
    problem = problem_of(Grid.from_blocks([layer * half for layer in (1.0, 2.0) for half in halves]))
    moved = apply(Options("tfi"), problem, lambda x: 0.0 * x + [0.1, 0.2, 0.0])
    assert np.abs(moved - [0.1, 0.2, 0.0]).max() < 1e-14


@pytest.mark.parametrize(("nodes", "cells"), [(50_000, 4), (50_001, 8), (200_000, 8), (200_001, 16)])
def test_sub_blocks_of_small_grids_are_smaller(nodes, cells):
    assert TFI().cells(SimpleNamespace(n_unique_nodes=nodes, source_numbers=np.arange(1000))) == cells


def arc(cells, degrees):
    """A block whose lines along i turn by an angle in all, evenly."""
    angle, radius, z = np.deg2rad(np.linspace(0.0, degrees, cells + 1)), np.linspace(1.0, 2.0, 5), np.arange(3.0)
    a, r, h = np.meshgrid(angle, radius, z, indexing="ij")
    return problem_of(Grid.from_blocks([np.stack([r * np.cos(a), r * np.sin(a), h], axis=-1)]))


@pytest.mark.parametrize(("degrees", "parts"), [(0.01, 2), (98.0, 2), (112.0, 4), (180.0, 4)])
def test_lines_that_turn_are_cut_twice_as_often(degrees, parts):
    """32 cells in two pieces of 16, each of which turns by half of the angle but one of its 32 steps."""
    i, j, k = make_skeleton(arc(32, degrees), 16).cuts[0]
    np.testing.assert_array_equal(i, np.linspace(0, 32, parts + 1))
    assert len(j) == len(k) == 2


def test_free_vertices_stay_in_their_slip_planes():
    line = np.linspace(0.0, 1.0, 6)
    grid = Grid.from_blocks([block_around(2.0 * line, line, 3.0 * line)])
    lid = BoundarySpec("lid", ("*.kmax",), Kind.MOVING, None, constant(0, 0, -0.9))
    problem = problem_of(grid, [lid, BoundarySpec("sides", ("*.i*", "*.j*", "*.kmin"), Kind.SLIP)])
    moved = apply(Options("tfi"), problem, told(problem))
    np.testing.assert_allclose(moved, grid.points * [0, 0, -0.3], rtol=0, atol=1e-14)
