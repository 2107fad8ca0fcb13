"""What is known before anything moves follows from the nodes near block faces, the *shell*; of the others only the box.

A process that holds only some planes of a grid could set it up from the shell.
"""

import dataclasses
from types import NoneType

import numpy as np
import pytest

from meshdeform_core.deform import set_up
from meshdeform_core.grid.topology import block_handedness
from meshdeform_core.grid.topology import topology as topologies
from meshdeform_formats.case import read_case
from meshdeform_samples import folder, load

# Sizes with which blocks have nodes deeper inside than any stage looks.
SAMPLES = {"splitter-plate": 8, "hemisphere": 16, "beam": 80, "square": 24, "valve": 32, "cascade": 16}


def hollow(grid, depth):
    """The grid with all nodes farther than ``depth`` nodes from all faces of their block at one corner of it: anywhere
    else, but within the same box."""
    points = grid.points.copy()
    for block in range(grid.n_blocks):
        inside = tuple(slice(depth + 1, n - depth - 1) if n > 1 else slice(None) for n in grid.shapes[block])
        grid.block(block, points)[inside] = grid.block(block)[0, 0, 0]
    assert (points != grid.points).any(axis=1).mean() > 0.1
    return grid.moved(points)


def differences(one, two, place=""):
    """Where two values of any kind differ; grids and methods aside."""
    if isinstance(one, np.ndarray):
        return [] if np.array_equal(one, two, equal_nan=one.dtype.kind == "f") else [place]
    if dataclasses.is_dataclass(one):
        one, two = vars(one), vars(two)
    if isinstance(one, dict):
        return [d for key in one if key not in IGNORED for d in differences(one[key], two[key], f"{place}.{key}")]
    if isinstance(one, (list, tuple)):
        assert len(one) == len(two), place
        return [d for n, pair in enumerate(zip(one, two, strict=True)) for d in differences(*pair, f"{place}[{n}]")]
    comparable = isinstance(one, (int, float, str, NoneType, frozenset))
    return [] if not comparable or one == two else [place]


IGNORED = {"grid", "before", "original", "undeformed"}


@pytest.mark.parametrize("name", SAMPLES)
def test_setup_needs_the_shell_only(name, monkeypatch):
    sample, case = load(name), read_case(folder(name) / "case.toml").case
    grid = sample.generate(SAMPLES[name])
    whole = set_up(grid, case)
    # The one judgement from samples of all nodes.
    monkeypatch.setattr(topologies, "block_handedness", lambda _: block_handedness(grid))
    found = set_up(hollow(grid, 1), case)
    for part in ("topology", "boundary", "warnings"):
        assert not differences(getattr(found, part), getattr(whole, part), part)
    for part in ("source_points", "surface", "first_cell_height"):
        assert not differences(getattr(found.problem, part), getattr(whole.problem, part), part)
    for time in (0.0, 1.5):
        motion = whole.displacement(time)
        np.testing.assert_array_equal(found.displacement(time), motion)
        crossings = [each.undeformed.crossing_test.crossings(motion) for each in (found, whole)]
        assert not differences(*crossings, "crossings")
    assert not differences(found.original.interfaces, whole.original.interfaces, "interfaces")


def test_faces_alone_do_not_suffice():
    """The comparison notices what is missing: cells at walls need the layer below."""
    grid, case = load("splitter-plate").generate(8), read_case(folder("splitter-plate") / "case.toml").case
    one, two = (set_up(each, case).problem.first_cell_height for each in (grid, hollow(grid, 0)))
    assert differences(one, two, "height") == ["height"]
