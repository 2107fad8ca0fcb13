"""Repaired levels of a series are a smooth function of the boundary, found in a few steps from the level before."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from cases import body_specs, turning
from grids import frame, frame_2d

from meshdeform_core.boundary import Kind
from meshdeform_core.boundary.motions.expression import expression
from meshdeform_core.boundary.motions.motion import Motion, Rotate
from meshdeform_core.deform import Case, set_up
from meshdeform_core.repair.energy import share_of, share_slopes
from meshdeform_core.repair.region import Basis
from meshdeform_core.series import Schedule, deform_series
from meshdeform_core.smoothness import Smoothness


def bar(size):
    """A plane bar that turns by t degrees."""
    turn = Motion((Rotate(expression("t", {"t"}), (0, 0, 1), (expression(0.0, ()),) * 3),), {})
    body, _ = body_specs(turning("0"), Kind.SLIP)
    return set_up(frame_2d(size), Case((dataclasses.replace(body, select=("*",), motion=turn),)))


def levels_of(setup, times):
    return list(deform_series(setup, Schedule(tuple(times)), "float64"))


@pytest.mark.slow
def test_the_grid_does_not_jump_where_a_repair_begins():
    """Accelerations are small, and with half the step they are a quarter, as those of smooth motions are."""
    setup, largest = bar(6), []
    for step in (2.0, 1.0):
        levels = levels_of(setup, np.arange(20.0, 62.0 + step / 2, step))
        repaired = [level.result.repair is not None for level in levels]
        assert not repaired[0]
        assert repaired[-1]
        assert all(level.result.valid and "jump" not in " ".join(level.result.warnings) for level in levels)
        largest.append(max(level.smoothness.beyond for level in levels))
    assert largest[1] < 0.2
    # In steps of the walls, which are half as long.
    assert largest[1] < 0.65 * largest[0]


def test_samples_between_corners_count_smoothly_from_cells_of_f_4_on():
    setup = set_up(frame(4, 3), Case(tuple(body_specs(turning("5")))))
    plot = Basis(setup.original, setup.boundary).whole
    whole = plot.region.energy

    def sheared(amount):
        return plot.inside(setup.grid.points + amount * setup.grid.points[:, [1, 2, 0]] * [1.0, 0.0, 0.0])

    # Of a shear by s, f = (3 + s^2) / 3 + 1 at all corners.
    share, energy = share_of(whole, sheared(2.0))
    assert share > 0.0
    assert not energy.between.any()
    assert (energy.mask == whole.mask & 255).all()
    share, energy = share_of(whole, sheared(3.0))
    assert 0.0 < energy.between.min() < energy.between.max() <= 1.0
    assert (energy.mask == whole.mask).all()
    step, excess = 1e-6, [whole.excess(sheared(3.0 + s)) for s in (-1e-6, 1e-6)]
    slope = (share_of(whole, sheared(3.0 + step))[1].between - share_of(whole, sheared(3.0 - step))[1].between) / 2e-6
    np.testing.assert_allclose(slope, share_slopes(whole, sheared(3.0))[1] * (excess[1] - excess[0]) / 2e-6, rtol=1e-6)


@pytest.mark.parametrize(("reach", "beyond"), [(0.5, 0.2), (1.0, 0.2), (2.0, 0.1)])
def test_nodes_that_move_farther_than_the_walls_may_be_accelerated_more(reach, beyond):
    assert Smoothness(1.0, 0.3, 1.0, wall=0.1, reach=reach).beyond == pytest.approx(beyond)
