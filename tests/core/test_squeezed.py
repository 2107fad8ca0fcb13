"""Gaps that close to a few percent, and the limits on work."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from cases import body_specs, formulas, turning
from grids import frame_2d

from meshdeform_core import stepping
from meshdeform_core.boundary import BoundarySpec, Kind
from meshdeform_core.deform import Case, Timing, deform, impose, set_up
from meshdeform_core.grid import Grid
from meshdeform_core.repair import options


def butterfly(n=5, layers=4, planes=27):
    """A pipe of radius 1 along z: a square in the middle, four blocks around it, cells that thin towards the wall."""
    s, z = np.linspace(-1.0, 1.0, n), np.linspace(-2.0, 2.0, planes)
    x, y = np.meshgrid(s, s, indexing="ij")
    core = 0.45 * np.stack([x * (1.15 - 0.15 * y * y), y * (1.15 - 0.15 * x * x)], axis=-1)
    plane, share = [core], np.tanh(2.0 * np.linspace(0.0, 1.0, layers)) / np.tanh(2.0)
    for quarter, side in enumerate((core[-1], core[::-1, -1], core[0, ::-1], core[:, 0])):
        angle = 0.25 * np.pi * (s + 2.0 * quarter)
        wall = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        plane.append(side[:, None] * (1.0 - share)[:, None] + wall[:, None] * share[:, None])
    blocks = [np.empty((*part.shape[:2], planes, 3)) for part in plane]
    for block, part in zip(blocks, plane, strict=True):
        block[..., :2], block[..., 2] = part[:, :, None], z
    return Grid.from_blocks(blocks)


def throat(left):
    """The pipe with a wall that closes to a share of its radius at z = 0."""
    gone = f"{left - 1.0} * exp(-z**2)"
    motion = formulas(f"x * ({gone})", f"y * ({gone})", "0")
    wall = BoundarySpec("wall", tuple(f"block{n}.jmax" for n in (2, 3, 4, 5)), Kind.MOVING, None, motion)
    return set_up(butterfly(), Case((wall, BoundarySpec("ends", ("*.k*",), Kind.SLIP))))


@pytest.mark.slow
def test_a_throat_that_closes_to_3_percent_is_valid_and_its_wall_where_prescribed():
    setup = throat(0.03)
    result = impose(setup, setup.motion(0.0), None, "float64", Timing())
    assert result.valid
    assert any("made by rbf-tfi in 8 steps, as attempts with idw-tfi left" in text for text in result.warnings)
    told = setup.topology.first[setup.boundary.known]
    wanted = setup.grid.points[told] + setup.displacement(0.0)[setup.boundary.known]
    np.testing.assert_allclose(result.grid.points[told], wanted, atol=1e-13)


@pytest.mark.parametrize(("amplitude", "least"), [(0.55, 0.4), (0.4, 0.6)])
def test_untangled_cells_are_improved_until_they_reach_the_limit(amplitude, least):
    x, y = np.meshgrid(np.linspace(0.0, 2.0, 9), np.linspace(0.0, 1.0, 6), indexing="ij")
    motion = formulas("0", f"{amplitude}*sin(pi*x/2)", "0")
    specs = (BoundarySpec("roof", ("*.jmin",), Kind.MOVING, None, motion),)
    result = deform(
        Grid.from_blocks([np.stack([x, y, 0.0 * x], axis=-1)[:, :, None]]),
        Case(specs, repair=options.RepairOptions(min_jacobian=least)),
    )
    assert result.valid
    assert result.steps == 1
    assert result.repair is not None


def test_work_is_limited_by_counts(monkeypatch):
    """The same wherever it is done; whatever was found is kept, and the reason told."""
    body, _ = body_specs(turning("110"), Kind.SLIP)
    case = Case((dataclasses.replace(body, select=("*",)),))
    monkeypatch.setattr(options, "_PER_NODE", 1e-6)
    short, again = deform(frame_2d(6), case), deform(frame_2d(6), case)
    assert not short.valid
    assert sum(a.repair for a in short.attempts) == 1
    assert any("as much work as is done for" in text for text in short.warnings)
    np.testing.assert_array_equal(short.grid.points, again.grid.points)


@pytest.mark.parametrize(("rescued", "kept"), [(0, 0), (3, 3), (9, 5)])
def test_of_two_methods_the_grid_with_fewer_invalid_cells_is_kept(rescued, kept, monkeypatch):
    def state(cells):
        return SimpleNamespace(valid=cells == 0, course=None, options=None, found=SimpleNamespace(count=cells))

    failed = SimpleNamespace(fraction=0.5)
    results = {"_without_repairs": None, "beginning": None, "_march": failed, "_with_other_methods": [state(rescued)]}
    for name, result in results.items():
        monkeypatch.setattr(stepping, name, lambda *_, result=result, **__: result)
    monkeypatch.setattr(stepping, "insist", lambda state: state)
    assert stepping._persistently(state(5)).found.count == kept


def test_a_squeezed_valid_grid_may_take_up_to_the_work_of_an_invalid_one():
    whole = options.Limit.of(50_000, 1.0)
    sound, bound, half, least, invalid = (
        whole.of_repair(50_000, ratio).affords(1.0) for ratio in (1.0, 0.22, 0.11, 1e-9, 0.0)
    )
    assert sound == bound
    assert half == 2 * sound
    assert least == invalid == 15_000_000
