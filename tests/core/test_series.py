"""Series of levels over time: velocities, what is kept, how smoothly the grid moves."""

import dataclasses
import itertools

import numpy as np
import pytest
from cases import body_specs, turning
from grids import frame, frame_2d, permuted, polar

from meshdeform_core import velocity
from meshdeform_core.boundary import Kind
from meshdeform_core.boundary.motions.expression import expression
from meshdeform_core.boundary.motions.motion import Motion, Rotate
from meshdeform_core.deform import Case, Timing, impose, set_up
from meshdeform_core.errors import CaseError
from meshdeform_core.grid import Grid
from meshdeform_core.grid.planes import block_handedness, plane_normal
from meshdeform_core.methods import Options
from meshdeform_core.quality.cells import measure_block
from meshdeform_core.repair import RepairOptions
from meshdeform_core.repair.energy import share_of
from meshdeform_core.repair.region import Basis
from meshdeform_core.series import Schedule, deform_series
from meshdeform_core.velocity import Moment, Smoothness, face_fields, grid_velocity, smoothness, swept_volumes

SWING = turning("20*sin(2*pi*t)")
QUARTERS = (0.0, 0.25, 0.5, 0.75, 1.0)


def setup_of(motion=SWING, options=None, repair="auto"):
    repairs = RepairOptions(repair)
    return set_up(frame(), Case(tuple(body_specs(motion)), method=options or Options(), repair=repairs))


def levels_of(setup, schedule, **more):
    return list(deform_series(setup, schedule, "float64", **more))


@pytest.mark.parametrize("options", [Options(), Options("rbf"), Options("tfi")], ids=lambda o: o.name)
def test_from_the_reference_a_period_leads_back_to_the_start(options):
    setup = setup_of(options=options)
    levels = levels_of(setup, Schedule(QUARTERS))
    assert np.abs(levels[1].result.grid.points - setup.grid.points).max() > 0.1
    assert [level.result.motion[0].max_rotation_deg for level in levels] == pytest.approx([0, 20, 0, 20, 0], abs=1e-6)
    np.testing.assert_allclose(levels[-1].result.grid.points, setup.grid.points, rtol=0, atol=1e-12)
    assert all(level.velocity is None and level.smoothness.plain for level in levels)


@pytest.mark.parametrize("order", velocity.VELOCITIES)
def test_a_series_goes_on_from_the_levels_before(order):
    times, setup, before = (0.0, 0.02, 0.05, 0.09), setup_of(), [True, False, True]
    levels = levels_of(setup, Schedule(times, velocity=order))
    points = [level.result.grid.points for level in levels]
    if order != "none":
        np.testing.assert_array_equal(levels[3].velocity, grid_velocity(times, points[1:], order))
    for first in (1, 2, 3):
        more = {"first": first, "finished": points.__getitem__, "plain": before[:first]}
        level, expected = levels_of(setup, Schedule(times[: first + 1], velocity=order), **more)[0], levels[first]
        np.testing.assert_array_equal(level.velocity, expected.velocity)
        assert all((a.values == b.values).all() for a, b in zip(level.faces, expected.faces, strict=True))
        # The second level has one before it only.
        assert level.smoothness == dataclasses.replace(expected.smoothness, plain=first == 1)


def test_second_order_begins_with_zero_and_first_order():
    x = [np.array([[t**2, 2.0 * t, 1.0]]) for t in (0.0, 0.5, 2.0)]
    times = (0.0, 0.5, 2.0)
    np.testing.assert_array_equal(grid_velocity(times[:1], x[:1], "second"), [[0, 0, 0]])
    np.testing.assert_allclose(grid_velocity(times[:2], x[:2], "second"), [[0.5, 2, 0]])
    # Exact for parabolas, whatever the spacing.
    np.testing.assert_allclose(grid_velocity(times, x, "second"), [[4, 2, 0]])
    np.testing.assert_allclose(grid_velocity(times, x, "first"), [[2.5, 2, 0]])


def test_an_invalid_level_does_not_stop_the_series():
    levels = levels_of(setup_of(turning("150*sin(pi*t)"), repair="off"), Schedule((0.0, 0.5, 1.0), steps=2))
    assert [level.result.valid for level in levels] == [True, False, True]
    assert not levels[-1].smoothness.plain


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"times": ()}, r"found \[\]$"), ({"times": (0.0, 0.0)}, r"found \[0, 0\]$"),
        ({"times": (2.0, 1.0, 3.0, 4.0, 5.0, 6.0)}, r"must ascend; found \[2, 1, 3, 4, 5, ...\]$"),
        ({"velocity": "third"}, "velocity = 'third' of a series is unknown; known are none, first, second, swept"),
    ],
)  # fmt: skip
def test_schedules_that_make_no_sense_are_refused(wrong, message):
    with pytest.raises(CaseError, match=message):
        dataclasses.replace(Schedule((0.0, 1.0)), **wrong)


def bar(degrees):
    """A plane bar that turns by an angle of time."""
    turn = Motion((Rotate(expression(degrees, {"t"}), (0, 0, 1), (expression(0.0, ()),) * 3),), {})
    body, _ = body_specs(turning("0"), Kind.SLIP)
    return set_up(frame_2d(6), Case((dataclasses.replace(body, select=("*",), motion=turn),)))


def test_repaired_levels_depend_on_the_boundary_only():
    """Levels equal single runs, whatever came before; up and down stroke agree; smooth, also where repairs set in."""
    setup = bar("t")
    levels = levels_of(setup, Schedule(tuple(np.arange(35.0, 67.0, 2.0))))
    assert [level.result.repair is None for level in levels[:3]] == [True, True, False]
    assert all(level.result.valid and level.result.repair.converged for level in levels[2:])
    for level in (levels[2], levels[7], levels[-1]):
        alone = impose(setup, setup.motion(level.time), None, "float64", Timing()).grid.points
        assert np.abs(alone - level.result.grid.points).max() < 1e-7
    # Down again.
    there_and_back = levels_of(bar("65 - 6*t"), Schedule((0.0, 1.0, 2.0)))
    for level, other in zip(there_and_back, (-1, -4, -7), strict=True):
        assert np.abs(level.result.grid.points - levels[other].result.grid.points).max() < 1e-7
    smooth = [level.smoothness for level in levels[2:]]
    assert max(s.acceleration for s in smooth) < 0.25
    assert max(s.beyond for s in smooth) < 0.17
    assert levels[0].smoothness.velocity is levels[1].smoothness.acceleration is None
    assert not any(s.plain for s in smooth)


def test_a_jump_of_the_grid_alone_is_told():
    still = np.zeros((3, 3))
    points = [still, still + [[0.1, 0, 0], [0.1, 0, 0], [0.1, 0, 0]], still + [[0.2, 0, 0], [0.2, 0, 0], [0.9, 0, 0]]]
    moments = [Moment(float(t), x, False) for t, x in enumerate(points)]
    found = smoothness(moments, np.array([0]), np.full(3, 0.5))
    assert (found.velocity, found.acceleration, found.acceleration_in_edges) == pytest.approx((8.0, 7.0, 0.7 / 0.5))
    assert (found.wall, found.reach) == pytest.approx((0.0, 1.0), abs=1e-12)
    assert "jumps" in found.warning
    mixed = [moment._replace(plain=moment.time > 0) for moment in moments]
    assert smoothness(mixed, np.array([0]), np.full(3, 0.5)).warning == found.warning
    plain = [moment._replace(plain=True) for moment in moments]
    assert smoothness(plain, np.array([0]), np.full(3, 0.5)).warning is None
    for walls, edge in (([2], 0.5), ([0], 5.0)):
        assert smoothness(moments, np.array(walls), np.full(3, edge)).warning is None
    # Walls that hardly move in the last interval say nothing of how far the nodes move with them.
    last = [moments[0], moments[2]._replace(time=1.0), moments[2]._replace(points=points[2] + 1e-4)]
    assert smoothness(last, np.array([0]), np.full(3, 0.5)).reach == pytest.approx(4.5)
    # At the same velocity, intervals of different lengths make no acceleration.
    even = [moment._replace(time=time, points=still + time) for moment, time in zip(moments, (0, 1, 4), strict=True)]
    assert smoothness(even, np.array([0]), np.full(3, 0.5)).acceleration == 0.0


def test_shortest_edges_are_those_of_all_neighbours_plane_by_plane(monkeypatch):
    monkeypatch.setattr(velocity, "_ROWS", 1)
    grid = frame()
    grid = grid.moved(shaken(grid, 0.02, 1))
    grid.block(0)[1, 1, 1] = grid.block(0)[1, 1, 2]
    found = velocity.shortest_edges(grid)
    for b, shape in enumerate(grid.shapes):
        x, own = grid.block(b), found[grid.offsets[b] : grid.offsets[b + 1]].reshape(shape)
        for at in np.ndindex(shape):
            beside = [np.add(at, step) for step in (*np.eye(3, dtype=int), *-np.eye(3, dtype=int))]
            beside = [tuple(n) for n in beside if (n >= 0).all() and (n < shape).all()]
            lengths = [np.linalg.norm(x[n] - x[at]) for n in beside]
            assert own[at] == pytest.approx(min(length for length in lengths if length > 0.0), rel=1e-12)


def test_samples_between_corners_count_smoothly_from_cells_of_f_4_on():
    setup = set_up(frame(4, 3), Case(tuple(body_specs(turning("5")))))
    plot = Basis(setup.original, setup.boundary).whole
    whole = plot.region.energy

    def sheared(amount):
        return plot.inside(setup.grid.points + amount * setup.grid.points[:, [1, 2, 0]] * [1.0, 0.0, 0.0])

    # Of a shear by s, f = (3 + s^2) / 3 + 1 at all corners.
    share, energy, *_ = share_of(whole, sheared(2.0))
    assert share > 0.0
    assert not energy.between.any()
    assert (energy.mask == whole.mask & 255).all()
    _, energy, _, of_between = share_of(whole, sheared(3.0))
    assert 0.0 < energy.between.min() < energy.between.max() <= 1.0
    assert (energy.mask == whole.mask).all()
    step, excess = 1e-6, [whole.excess(sheared(3.0 + s)) for s in (-1e-6, 1e-6)]
    slope = (share_of(whole, sheared(3.0 + step))[1].between - share_of(whole, sheared(3.0 - step))[1].between) / 2e-6
    np.testing.assert_allclose(slope, of_between * (excess[1] - excess[0]) / 2e-6, rtol=1e-6)


@pytest.mark.parametrize(("reach", "beyond"), [(0.5, 0.2), (1.0, 0.2), (2.0, 0.1)])
def test_nodes_that_move_farther_than_the_walls_may_be_accelerated_more(reach, beyond):
    assert Smoothness(1.0, 0.3, 1.0, wall=0.1, reach=reach).beyond == pytest.approx(beyond)


def volumes(grid: Grid, points: np.ndarray) -> list[np.ndarray]:
    """Exact cell volumes (2-D: areas) of each block."""
    sign, normal = block_handedness(grid), plane_normal(grid)
    return [measure_block(grid.block(b, points), float(sign[b]), normal).volume for b in range(grid.n_blocks)]


def net(faces: tuple[np.ndarray, ...], shape: tuple[int, ...]) -> np.ndarray:
    """Far minus near faces of every cell of a block."""
    total = np.zeros([max(n - 1, 1) for n in shape])
    for axis, part in enumerate(faces):
        if part.size:
            total += np.diff(part, axis=axis)
    return total


def shaken(grid: Grid, size: float, seed: int) -> np.ndarray:
    moved = grid.points + size * np.random.default_rng(seed).normal(size=grid.points.shape)
    if grid.dimension == 2:
        moved[:, 2] = grid.points[:, 2]
    return moved


GRIDS = {
    "frame": frame(),
    "o-grid": polar(),
    "plane": frame_2d(),
    "left-handed": Grid.from_blocks([permuted(frame(), (1, 0, 2), (False, False, False)).block(0)]),
    "flat i": Grid.from_blocks([frame_2d().block(0).transpose(2, 0, 1, 3).copy()]),
    "flat j": Grid.from_blocks([frame_2d().block(0).transpose(0, 2, 1, 3).copy()]),
}


@pytest.mark.parametrize("name", GRIDS)
def test_volume_of_every_cell_changes_by_what_its_faces_sweep(name):
    grid = GRIDS[name]
    before, after = shaken(grid, 0.02, 1), shaken(grid, 0.05, 2)
    swept = swept_volumes(grid, before, after)
    old, new = volumes(grid, before), volumes(grid, after)
    for b, shape in enumerate(grid.shapes):
        assert np.abs(old[b] + net(swept[b], shape) - new[b]).max() < 1e-13 * np.abs(old[b]).min()
        assert (new[b] - old[b]).any()


def integral(x: np.ndarray) -> float:
    """Of x_u x x_v . x_t over the cube, x trilinear in the corners (2, 2, 2, 3), by Gauss' rule, which is exact: the
    integrand is of degree 2 in each of u, v, t."""
    total, points = 0.0, 0.5 + np.array([-1, 1]) / np.sqrt(12)
    for place in itertools.product(points, repeat=3):
        u, v, t = (np.array([1 - s, s]) for s in place)
        a, b, c = (np.einsum("i,j,k,ijkd->d", *w, x) for w in ((STEP, v, t), (u, STEP, t), (u, v, STEP)))
        total += np.cross(a, b) @ c / 8
    return total


STEP = np.array([-1.0, 1.0])


def test_swept_volumes_are_exact():
    """Against the integral, for a single cell."""
    rng = np.random.default_rng(4)
    grid = Grid.from_blocks([np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), axis=-1) * 1.0])
    before, after = (grid.points + 0.3 * rng.normal(size=(8, 3)) for _ in range(2))
    (faces,) = swept_volumes(grid, before, after)
    old, new = before.reshape(2, 2, 2, 3), after.reshape(2, 2, 2, 3)
    for axis in range(3):
        for end in range(2):
            quads = [np.moveaxis(np.take(x, end, axis=axis), 0, int(axis == 1)) for x in (old, new)]
            exact = integral(np.stack(quads, axis=2))
            assert np.take(faces[axis], end, axis=axis).item() == pytest.approx(exact, rel=1e-12, abs=1e-15)


def test_second_order_fluxes_match_the_differences_of_volumes():
    """Levels of any spacing: the rate of the volume by three backward differences is the sum of the fluxes."""
    grid, times = frame(), (0.0, 0.1, 0.35)
    points = [shaken(grid, 0.02, seed) for seed in range(3)]
    swept = [swept_volumes(grid, points[n], points[n + 1]) for n in range(2)]
    flux = velocity.volume_flux(times, swept)
    rates = [volumes(grid, x) for x in points]
    h, before = times[2] - times[1], times[1] - times[0]
    for b, shape in enumerate(grid.shapes):
        slope, earlier = (rates[2][b] - rates[1][b]) / h, (rates[1][b] - rates[0][b]) / before
        expected = slope + (slope - earlier) * h / (h + before)
        np.testing.assert_allclose(net(flux[b], shape), expected, atol=1e-12 * np.abs(rates[0][b]).max())


def test_fields_at_the_first_levels():
    grid = frame()
    points = [shaken(grid, 0.02, seed) for seed in range(2)]
    still = face_fields(grid, (0.0,), points[:1])
    assert not any(field.values.any() for field in still)
    fields = {(f.name, f.location, f.block): f.values for f in face_fields(grid, (0.0, 0.5), points)}
    np.testing.assert_array_equal(fields["VolumeFlux", "jface", 0], fields["SweptVolume", "jface", 0] / 0.5)
    np.testing.assert_allclose(grid_velocity((0.0, 0.5), points, "swept"), (points[1] - points[0]) / 0.5)
