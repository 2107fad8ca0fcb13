"""Grids of hundreds of blocks: searches against plain loops over all pairs, and work that does not grow faster."""

import itertools
import sys
from collections.abc import Callable

import grids
import numpy as np
import pytest
from cases import problem_of
from grids import turn_block
from hypothesis import given, settings
from hypothesis import strategies as st

from meshdeform_core.grid import Grid, IntArray, Side
from meshdeform_core.grid.connections import connected_nodes, find_interfaces
from meshdeform_core.grid.faces import find_faces, find_outside
from meshdeform_core.grid.openings import find_openings
from meshdeform_core.grid.planes import block_handedness
from meshdeform_core.grid.selection import select_quads
from meshdeform_core.grid.topology import find_topology
from meshdeform_core.methods.transfinite.edge_graph import PreparedEdgeGraph
from meshdeform_core.numerics.geometry.boxes import overlapping_boxes
from meshdeform_core.quality.cells import block_volumes
from meshdeform_core.quality.lines import interface_lines
from meshdeform_core.quality.walls import interface_cells


def lattice(counts: tuple[int, int, int], nodes: int = 3, turned: bool = False, gap: float = 0.0) -> Grid:
    """A bent box cut into blocks with ``nodes`` along each index; ``turned``: their indices run in all directions."""
    orientations = itertools.cycle(
        itertools.product(itertools.permutations(range(3)), [(False, True, False), (True, False, False)])
    )
    blocks = []
    for place in np.ndindex(*counts):
        lines = [(1 + gap) * at + np.linspace(0.0, 1.0, nodes) for at in place]
        x = grids.block_around(*lines)
        x[..., 2] += 0.1 * np.sin(x[..., 0]) * np.cos(x[..., 1])
        blocks.append(turn_block(x, *next(orientations)) if turned else x)
    return Grid.from_blocks(blocks)


GRIDS = {
    "lattice": lambda: lattice((3, 3, 2)),
    "turned": lambda: lattice((3, 2, 3), turned=True),
    "frame": grids.frame,
    "plane": grids.frame_2d,
    "seam": grids.polar,
    "turned plane": lambda: grids.permuted(grids.frame_2d(), (2, 0, 1), (True, False, True)),
}


@pytest.fixture(params=GRIDS)
def grid(request) -> Grid:
    return GRIDS[request.param]()


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 2**32 - 1))
def test_overlapping_boxes_are_those_of_all_pairs(seed):
    random = np.random.default_rng(seed)
    sets = []
    for count in random.integers(1, 60, 2):
        # Sizes over many orders of magnitude, flat and single points among them; some share their bounds exactly.
        size = 10.0 ** random.uniform(-7, 0, (count, 1)) * random.choice([0.0, 0.3, 1.0], (count, 3))
        low = np.round(random.uniform(-1, 1, (count, 3)), random.integers(1, 4))
        sets.append((low, low + size))
    one, two = sets
    hit = ((one[0][:, None] <= two[1]) & (two[0] <= one[1][:, None])).all(axis=2)
    np.testing.assert_array_equal(overlapping_boxes(one, two), np.argwhere(hit))


def test_interfaces_cover_every_shared_quad_once(grid):
    topology = find_topology(grid)
    connections = find_interfaces(grid, topology)
    count = 0
    for connection in connections:
        own, donor = connected_nodes(grid, connection)
        np.testing.assert_array_equal(topology.numbers_of(own), topology.numbers_of(donor))
        cells = np.abs(np.array(connection.end) - connection.begin)
        count += int(np.prod(cells[cells > 0]))
    assert count == np.count_nonzero(topology.partner >= 0) // 2 > 0
    assert len({(c.block, c.begin, c.end, c.donor_block) for c in connections}) == len(connections)


def test_handedness_by_the_volume_of_every_cell(grid):
    if grid.dimension == 2:
        pytest.skip("a plane has no volume")
    for block, hand in enumerate(block_handedness(grid)):
        i, j, k = (np.diff(grid.block(block), axis=axis) for axis in range(3))
        n = tuple(size - 1 for size in grid.shapes[block])
        edges = [each[: n[0], : n[1], : n[2]] for each in (i, j, k)]
        assert np.sign(np.einsum("ijkx,ijkx->", edges[0], np.cross(edges[1], edges[2]))) == hand


def test_lines_across_interfaces_meet_and_leave_into_both_blocks(grid):
    topology = find_topology(grid)
    lines = interface_lines(grid, topology)
    np.testing.assert_array_equal(topology.numbers_of(lines.here), topology.numbers_of(lines.there))
    for near, far in ((lines.here, lines.before), (lines.there, lines.beyond)):
        block = np.searchsorted(grid.offsets, near, side="right")
        np.testing.assert_array_equal(block, np.searchsorted(grid.offsets, far, side="right"))
        assert not np.isin(far, near).all()


def calls(work: Callable[[], object]) -> int:
    """Functions, of Python and compiled, that ``work`` calls."""
    count = 0

    def tick(frame: object, event: str, argument: object) -> None:
        nonlocal count
        count += event in ("call", "c_call")

    sys.setprofile(tick)
    try:
        work()
    finally:
        sys.setprofile(None)
    return count


@pytest.mark.parametrize(
    ("work", "per_block"),
    [
        (lambda grid, topology: find_topology(grid), 6.0),
        (lambda grid, topology: find_openings(grid, topology), 6.0),
        (lambda grid, topology: find_interfaces(grid, topology), 30.0),
        (lambda grid, topology: find_faces(grid, topology), 60.0),
        (lambda grid, topology: find_outside(grid, topology), 200.0),
        (lambda grid, topology: select_quads(grid, topology, ["*.jmin", "*.?max"], "all"), 60.0),
        (lambda grid, topology: PreparedEdgeGraph(problem_of(grid, [])), 120.0),
        (lambda grid, topology: block_volumes(grid, grid.points, topology.handedness), 1.0),
        (lambda grid, topology: interface_lines(grid, topology), 2.0),
        (lambda grid, topology: interface_cells(grid, topology, grid.points, None), 4.0),
    ],
    ids=["topology", "openings", "interfaces", "faces", "outside", "selection", "edges", "volumes", "lines", "cells"],
)
def test_calls_per_block_do_not_grow(work, per_block):
    few, many = lattice((3, 3, 3)), lattice((6, 6, 6))
    counts = []
    for grid in (few, many):
        topology = find_topology(grid)
        work(grid, topology)
        counts.append(calls(lambda grid=grid, topology=topology: work(grid, topology)))
    more = counts[1] - counts[0]
    assert more / (many.n_blocks - few.n_blocks) < per_block
    assert counts[1] < 1.2 * counts[0] * many.n_blocks / few.n_blocks


def test_sides_of_separate_blocks_are_not_compared_with_all_others():
    grid = lattice((7, 7, 5), gap=0.3)
    topology = find_topology(grid)
    assert topology.external.all()
    compared: list[IntArray] = []
    original = overlapping_boxes
    module = sys.modules["meshdeform_core.grid.openings"]
    module.overlapping_boxes = lambda *sets: compared.append(original(*sets)) or compared[-1]
    try:
        assert find_openings(grid, topology) == ()
    finally:
        module.overlapping_boxes = original
    # Each side has the four beside it on its own block, and itself; in the search for overlaps its own block.
    assert 0 < sum(map(len, compared)) <= (5 + 1) * 6 * grid.n_blocks


def test_connections_of_so_many_blocks_that_pairs_of_sides_exceed_32_bits():
    n = 20
    place = np.random.default_rng(1).permutation(n**3)
    at = np.stack(np.unravel_index(place, (n, n, n)), axis=1)
    unit = np.stack(np.meshgrid(*[np.arange(2.0)] * 3, indexing="ij"), axis=-1)
    grid = Grid.from_blocks([unit + corner for corner in at])
    found = find_interfaces(grid, find_topology(grid))
    pairs = np.array([(c.block, c.donor_block) for c in found])
    step = at[pairs[:, 1]] - at[pairs[:, 0]]
    assert len(np.unique(pairs, axis=0)) == len(found) == 3 * n * n * (n - 1)
    assert (np.abs(step).sum(axis=1) == 1).all()
    assert (np.diff(pairs[:, 0]) >= 0).all()
    for connection, axis in zip(found, (2 * np.abs(step).argmax(axis=1) + step.max(axis=1)).tolist(), strict=True):
        own, donor = Side(axis), Side(axis ^ 1)
        names = f"{grid.names[connection.block]}.{own.label}", f"{grid.names[connection.donor_block]}.{donor.label}"
        assert connection.name == "-".join(names)
