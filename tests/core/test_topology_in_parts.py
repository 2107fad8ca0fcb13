"""The topology of a grid in parts, which all ranks find together, is that of the whole grid to the last bit.

The ranks are forks of this process (:mod:`forked_ranks`); coordinates that a rank does not hold are poisoned.
"""

import dataclasses
from functools import partial

import numpy as np
import pytest
from forked_ranks import Failed, on_ranks, poison_parts
from grids import block_around, frame, frame_2d, permuted, polar
from hypothesis import given, settings
from hypothesis import strategies as st
from random_grids import block_grids

from meshdeform_core.grid import Grid
from meshdeform_core.grid.components import BY_PREFIX, with_components
from meshdeform_core.grid.dealing import face_bounds
from meshdeform_core.grid.near import NearNodes
from meshdeform_core.grid.topology import find_topology, partners, strips
from meshdeform_core.numerics import pieces as pieces_module
from meshdeform_core.numerics.geometry import copies
from meshdeform_core.numerics.geometry.copies import coincident_copies, coincident_groups
from meshdeform_core.parallel import Route, current_ranks

LINE = np.linspace(0.0, 1.0, 5)
# Compiled loops are loaded once, before ranks are forked.
_NEAR = NearNodes.of([(2, 2, 2)], np.array([0, 8]))
assert _NEAR.taken(np.zeros((8, 3)), _NEAR.rows) is not None


@pytest.fixture(autouse=True)
def small_pieces(monkeypatch):
    """Blocks are cut although they are small; what a rank does not hold is no number."""
    monkeypatch.setattr(pieces_module, "_NODES", 20)
    monkeypatch.setattr(pieces_module, "_CELLS", 2)
    pieces_module._ends.cache_clear()
    poison_parts(monkeypatch)
    yield
    pieces_module._ends.cache_clear()


def in_parts(grid):
    """The grid, of which this rank holds its part."""
    part = Grid.allocate(grid.shapes, grid.names, components=grid.components)
    points = part.points
    points.own[...] = grid.points[points.low : points.high]
    points.keep(NearNodes.of(part.shapes, part.offsets))
    return part


def facts(grid):
    """All arrays of the topology, with their types."""
    found = find_topology(grid)
    arrays = {**dataclasses.asdict(found), **{f"quads.{k}": v for k, v in dataclasses.asdict(found.quads).items()}}
    arrays.pop("quads")
    return {name: (np.asarray(a).dtype.str, np.asarray(a).shape, np.asarray(a).tobytes()) for name, a in arrays.items()}


def same_on_ranks(grid, count):
    expected = facts(grid)
    for found in on_ranks(count, lambda number: facts(in_parts(grid))):
        assert [name for name in expected if found[name] != expected[name]] == []


def noisy(grid, size, seed=1):
    """Copies of a node differ by noise, some too much to coincide."""
    random = np.random.default_rng(seed)
    noise = size * random.uniform(-1.0, 1.0, grid.points.shape) * 10.0 ** random.uniform(-3.0, 0.0, (grid.n_nodes, 1))
    return grid.moved(grid.points + noise)


def pole():
    """A collapsed edge, and triangles around a pole."""
    angle, radius = np.linspace(0, np.pi / 2, 6), np.linspace(0, 1, 4)
    a, r, z = np.meshgrid(angle, radius, LINE, indexing="ij")
    return Grid.from_blocks([np.stack([r * np.cos(a), r * np.sin(a), z], axis=-1)] * 2)


def unequal():
    """A large block among small ones; edges from 1e-8 to 1."""
    small = [block_around(np.linspace(n, n + 1, 3), 1 + LINE[:2], LINE[:3]) for n in range(4)]
    y = np.r_[0.0, 1e-8, 3e-8, 1e-7, 1e-3, 1.0]
    return Grid.from_blocks([small[0], block_around(np.linspace(0, 4, 41), y, LINE), *small[1:]])


def overset():
    """Two components that lie in the same place, their blocks in turn."""
    grids = [frame(4, 3), frame(4, 3)]
    blocks = [grid.block(n) for n in range(grids[0].n_blocks) for grid in grids]
    grid = Grid.from_blocks(blocks, [f"{'ab'[n % 2]}.{n}" for n in range(len(blocks))])
    return with_components(grid, BY_PREFIX)


GRIDS = {
    "frame": frame,
    "noise": lambda: noisy(frame(), 1e-4),
    "plane ij": lambda: frame_2d(5),
    "plane ik": lambda: permuted(frame_2d(5), (0, 2, 1), (False, True, False)),
    "plane jk": lambda: permuted(frame_2d(5), (2, 0, 1), (False, False, True)),
    "O-grid": polar,
    "noisy seam": lambda: noisy(polar(), 1e-5),
    "pole": pole,
    "three blocks in one place": lambda: Grid.from_blocks([block_around(LINE, LINE, LINE)] * 3),
    "unequal": unequal,
    "overset": overset,
    "one block": lambda: Grid.from_blocks([block_around(LINE, LINE, LINE)]),
    "single precision": lambda: frame(5, 4).moved(frame(5, 4).points.astype(np.float32).astype(np.float64)),
}


@pytest.mark.parametrize("name", GRIDS)
def test_every_kind_of_grid(name):
    same_on_ranks(GRIDS[name](), 3)


@settings(max_examples=5)
@given(block_grids(), st.integers(2, 7), st.sampled_from([0.0, 1e-6, 1e-3]), st.integers(0, 10**6))
def test_random_grids(drawn, count, noise, seed):
    same_on_ranks(noisy(drawn.shuffled, noise, seed), count)


@pytest.mark.parametrize("few", [1, 7])
def test_little_is_done_at_a_time(few, monkeypatch):
    for module, name in ((copies, "_WINDOW"), (copies, "_SAMPLE"), (partners, "_MATCHED"), (strips, "_TOGETHER")):
        monkeypatch.setattr(module, name, few)
    same_on_ranks(noisy(frame(5, 4), 1e-4), 4)


def test_chains_of_points_across_all_ranks():
    """Points closer to each other than their tolerance, in one chain through the ranges of all ranks, and pairs."""
    random = np.random.default_rng(3)
    line = np.linspace(0.0, 1.0, 200)[:, None] * np.array([1.0, 0.3, -0.2]) + 5.0
    points = np.concatenate([line, np.repeat(random.uniform(0.0, 6.0, (300, 3)), 2, axis=0)])
    tolerance = np.append(np.full(200, 0.006), 10.0 ** random.uniform(-9.0, -1.0, 600))
    mixed = random.permutation(len(points))
    points, tolerance = points[mixed], tolerance[mixed]
    label = coincident_groups(points, tolerance)
    first = np.array([np.flatnonzero(label == each)[0] for each in label])
    least = np.array([tolerance[label == each].min() for each in label])
    assert len(np.unique(label[np.argsort(mixed)[:200]])) == 1

    def find(number, count):
        own = np.array_split(np.arange(len(points)), count)[number]
        return coincident_copies(current_ranks(), own, points[own], tolerance[own])

    for count in (1, 2, 5):
        found = [np.concatenate(each) for each in zip(*on_ranks(count, partial(find, count=count)), strict=True)]
        np.testing.assert_array_equal(found[0], first)
        np.testing.assert_array_equal(found[1], least)


@given(st.lists(st.tuples(*[st.integers(1, 9)] * 3), min_size=1, max_size=5), st.integers(1, 7))
def test_every_node_is_dealt_to_one_rank(shapes, count):
    bounds = face_bounds(shapes, count)
    assert (bounds[0], bounds[-1], len(bounds)) == (0, np.prod(shapes, axis=1).sum(), count + 1)
    assert (np.diff(bounds) >= 0).all()


def test_nodes_on_faces_are_dealt_evenly():
    shape = (40, 30, 20)
    inside = np.zeros(shape, dtype=bool)
    inside[1:-1, 1:-1, 1:-1] = True
    on_faces = np.append(0, np.cumsum(~inside.ravel()))
    shares = np.diff(on_faces[face_bounds([shape], 6)])
    assert shares.max() < 1.05 * shares.mean()


def test_rows_go_to_ranks_and_results_come_back():
    target = np.random.default_rng(2).integers(0, 3, (4, 50))

    def send(number):
        route = Route(current_ranks(), target[number])
        there = route.there(np.stack([np.full(50, number), np.arange(50)], axis=1))
        expected = [(rank, n) for rank in range(4) for n in range(50) if target[rank, n] == number]
        np.testing.assert_array_equal(there, np.array(expected).reshape(-1, 2))
        np.testing.assert_array_equal(route.back(there @ [100, 1]), 100 * number + np.arange(50))
        return True

    assert all(on_ranks(4, send))


def test_an_error_of_one_rank_is_seen():
    """The others do not wait for it."""
    grid = frame(4, 3)

    def failing(*_):
        raise MemoryError("no memory on this rank")

    def find(number):
        if number == 1:
            partners._searched = failing
        return facts(in_parts(grid))

    with pytest.raises(Failed, match="no memory on this rank"):
        on_ranks(3, find)
