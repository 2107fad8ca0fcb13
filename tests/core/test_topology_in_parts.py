"""The topology of a grid in parts, which every rank finds, is that of the whole grid to the last bit.

The ranks are forks of this process (:mod:`forked_ranks`); coordinates that a rank does not hold are poisoned.
"""

import dataclasses

import numpy as np
import pytest
from forked_ranks import on_ranks, poison_parts, small_blocks_are_cut
from grids import LINE, block_around, discs, frame, frame_2d, interleaved, permuted, polar
from hypothesis import given, settings
from hypothesis import strategies as st
from random_grids import block_grids

from meshdeform_core.grid import Grid
from meshdeform_core.grid.selection import BY_PREFIX, with_components
from meshdeform_core.grid.topology import find_topology


@pytest.fixture(autouse=True)
def small_pieces(monkeypatch):
    """Blocks are cut although they are small; what a rank does not hold is no number."""
    poison_parts(monkeypatch)
    with small_blocks_are_cut(monkeypatch, 20, 2):
        yield


def in_parts(grid, ranks):
    """The grid, of which this rank holds its part."""
    part = Grid.allocate(grid.shapes, grid.names, ranks, components=grid.components)
    points = part.points
    points.own[...] = grid.points[points.low : points.high]
    return part


def facts(grid):
    """All arrays of the topology, with their types."""
    found = find_topology(grid)
    arrays = {**dataclasses.asdict(found), **{f"quads.{k}": v for k, v in dataclasses.asdict(found.quads).items()}}
    arrays.pop("quads")
    return {name: (np.asarray(a).dtype.str, np.asarray(a).shape, np.asarray(a).tobytes()) for name, a in arrays.items()}


def same_on_ranks(grid, count):
    expected = facts(grid)
    for found in on_ranks(count, lambda ranks: facts(in_parts(grid, ranks))):
        assert [name for name in expected if found[name] != expected[name]] == []


def noisy(grid, size, seed=1):
    """Copies of a node differ by noise, some too much to coincide."""
    random = np.random.default_rng(seed)
    noise = size * random.uniform(-1.0, 1.0, grid.points.shape) * 10.0 ** random.uniform(-3.0, 0.0, (grid.n_nodes, 1))
    return grid.moved(grid.points + noise)


def unequal():
    """A large block among small ones; edges from 1e-8 to 1."""
    small = [block_around(np.linspace(n, n + 1, 3), 1 + LINE[:2], LINE[:3]) for n in range(4)]
    y = np.r_[0.0, 1e-8, 3e-8, 1e-7, 1e-3, 1.0]
    return Grid.from_blocks([small[0], block_around(np.linspace(0, 4, 41), y, LINE), *small[1:]])


GRIDS = {
    "frame": frame,
    "noise": lambda: noisy(frame(), 1e-4),
    "plane ik": lambda: permuted(frame_2d(5), (0, 2, 1), (False, True, False)),
    "O-grid": polar,
    "discs": discs,
    "unequal": unequal,
    # Two components that lie in the same place, their blocks in turn.
    "overset": lambda: with_components(interleaved(a=frame(4, 3), b=frame(4, 3)), BY_PREFIX),
}


@pytest.mark.parametrize("name", GRIDS)
def test_every_kind_of_grid(name):
    same_on_ranks(GRIDS[name](), 3)


@settings(max_examples=5)
@given(block_grids(), st.integers(2, 7), st.sampled_from([0.0, 1e-6, 1e-3]), st.integers(0, 10**6))
def test_metamorphic(drawn, count, noise, seed):
    same_on_ranks(noisy(drawn.shuffled, noise, seed), count)
