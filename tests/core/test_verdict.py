"""The verdict on cells, against samples of the Jacobian; its pass in single precision, against definitions in double
precision written plainly with numpy."""

import itertools

import numpy as np
import pytest
from cases import STILL, body_specs, constant, turning
from grids import frame

from meshdeform_core.boundary import BoundarySpec, Kind, classify
from meshdeform_core.deform import Case, deform
from meshdeform_core.errors import MethodError
from meshdeform_core.grid import Grid
from meshdeform_core.grid.topology import find_topology
from meshdeform_core.methods import Options, composite
from meshdeform_core.numerics.cell.inspection import OPEN, Scratch, inspect_hexahedra
from meshdeform_core.numerics.cell.measures import cell_corners, decide, measure_cells
from meshdeform_core.quality import InvalidCell, Original, assess
from meshdeform_core.quality.validity import TOTALS, Comparison, Failure, judge
from meshdeform_core.repair import RepairOptions

CORNERS = np.array(list(itertools.product((0.0, 1.0), repeat=3)))
TOLERANCE = 2e-5
"""Largest relative error of the pass in single precision for cells that it does not leave open."""


def sampled_jacobian(x, count=21):
    """The Jacobian of hexahedra (m, 8, 3) at count^3 points each, (m, count^3)."""
    corners = x.reshape(-1, 2, 2, 2, 3)
    t = np.linspace(0.0, 1.0, count)
    value, slope = np.stack([1.0 - t, t], axis=1), np.array([-1.0, 1.0])
    ones = np.ones(count)
    u = np.einsum("mabcd,a,r,sb,tc->mrstd", corners, slope, ones, value, value, optimize=True)
    v = np.einsum("mabcd,ra,b,s,tc->mrstd", corners, value, slope, ones, value, optimize=True)
    w = np.einsum("mabcd,ra,sb,c,t->mrstd", corners, value, value, slope, ones, optimize=True)
    return np.einsum("mrstd,mrstd->mrst", np.cross(u, v), w).reshape(len(x), -1)


def distorted_cubes(sigma, count, seed=0):
    return CORNERS + sigma * np.random.default_rng(seed).standard_normal((count, 8, 3))


@pytest.mark.parametrize("sigma", [0.3, 0.5])
def test_no_cell_passes_that_has_a_negative_sample_and_none_fails_without_reason(sigma):
    x = distorted_cubes(sigma, 12000)
    # Those with positive corners that are nearly valid or invalid are of interest, and few of the others.
    y = x[sampled_jacobian(x, 2).min(axis=1) > 0]
    x = np.concatenate([x[:20], y[:100], y[np.argsort(np.abs(sampled_jacobian(y, 9).min(axis=1)))[:150]]])
    failed = decide(np.broadcast_to(CORNERS, x.shape).copy(), x, np.ones(len(x)))
    lowest = np.concatenate([sampled_jacobian(part).min(axis=1) for part in np.array_split(x, 10)])
    assert not ((lowest <= 0) & (failed == 0)).any()
    # What fails has a negative sample, but for cells that are negative between the samples only.
    assert ((failed != 0) & (lowest > 0.003)).sum() == 0
    assert 0 < (failed != 0).sum() < len(x)


def test_inherited_cells_are_bad_before_and_after_and_fail_no_test():
    rng, grid = np.random.default_rng(2), Grid.from_blocks([np.stack(np.indices((7, 7, 7)), axis=-1).astype(float)])
    grid = grid.moved(grid.points + 0.25 * rng.standard_normal(grid.points.shape))
    after = grid.points + 0.1 * rng.standard_normal(grid.points.shape)
    found = Comparison(Original(grid, find_topology(grid)), after)
    bad = [(measure_cells(cell_corners(grid.block(0, x)), 1.0).jacobian <= 0).any(axis=1) for x in (grid.points, after)]
    both = bad[0] & bad[1]
    assert 0 < found.inherited == (both & (found.verdict.failed == 0)).sum() < both.sum()


def test_an_invalid_cell_has_the_first_step_in_which_it_was():
    def invalid(angle, steps):
        case = Case(tuple(body_specs(turning(angle))), method=Options("tfi"), repair=RepairOptions("off"))
        return {(cell.block, cell.ijk): cell.step for cell in deform(frame(), case, steps=steps).assessment.invalid}

    last, one, two = invalid(225, 3), invalid(75, 1), invalid(150, 2)
    assert last == {cell: 1 if cell in one else 2 if cell in two else 3 for cell in last}
    assert {1, 2} <= set(last.values())


def block(n, twist=0.0):
    x = np.stack(np.meshgrid(*[np.arange(n, dtype=float)] * 3, indexing="ij"), axis=-1)
    return x + twist * np.sin(x[..., ::-1])


def original_of(*blocks, **options):
    grid = Grid.from_blocks(blocks)
    return Original(grid, find_topology(grid), **options)


def inside_negative(stretch=2.0, axis=2):
    """A cell (8, 3) whose end along an axis is that of a cube turned by 180 degrees, and stretched: its corner
    Jacobians are 1; their mean along the axis is ``(4 - stretch - 1 / stretch) / 6``, in the middle it is below 0."""
    x = np.stack(np.indices((2, 2, 2)), axis=-1) - [0.5, 0.5, 0.0]
    x[:, :, 1, :2] *= [-stretch, -1.0 / stretch]
    return x.transpose(*np.roll([0, 1, 2], axis - 2), 3).reshape(8, 3)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_cell_that_is_negative_between_positive_corners_is_invalid(axis):
    original = original_of(block(2))
    after = inside_negative(axis=axis)
    verdict = judge(original, after)
    assert (verdict.failed.tolist(), verdict.weak(0.0).tolist()) == ([Failure.INSIDE], [0])
    assessment = assess(original, after, None)
    assert assessment.after.invalid_cells == 1
    assert assessment.invalid[0].test == "inside"
    assert assessment.invalid[0].min_jacobian > 0.0


def test_a_cell_that_was_negative_inside_is_judged_by_its_volume():
    bad, sign = inside_negative()[None], np.ones(1)
    assert decide(bad, bad + 1.0, sign).tolist() == [0]
    assert decide(bad, inside_negative(4.0)[None], sign).tolist() == [2]


@pytest.mark.parametrize("flip", [False, True])
def test_relative_jacobians_are_those_at_the_corners(flip):
    before = block(6, 0.1)
    after = before + 0.12 * np.random.default_rng(3).standard_normal(before.shape)
    if flip:
        before, after = before[::-1].copy(), after[::-1].copy()
    verdict = judge(original_of(before), after.reshape(-1, 3))
    new, old = (sampled_jacobian(cell_corners(x), 2) for x in (after, before))
    ratio = (new / old).min(axis=1)
    np.testing.assert_allclose(verdict.ratio, ratio, rtol=1e-6)
    np.testing.assert_array_equal(verdict.failed == Failure.CORNER, ratio <= 0)


def test_quadrilaterals_are_judged_by_their_corners_in_any_index_plane():
    x, y = np.meshgrid(np.arange(4.0), np.arange(5.0), indexing="ij")
    plane = np.stack([x, y, 0 * x], axis=-1)
    for axis in range(3):
        before = np.expand_dims(plane, axis)
        after = before.copy()
        moved = [1, 1]
        moved.insert(axis, 0)
        after[tuple(moved)] += [1.2, 1.2, 0.0]
        verdict = judge(original_of(before), after.reshape(-1, 3))
        # Node (1, 1) has passed node (2, 2): the cell between them is turned over, its two neighbours at (2, 1) and
        # (1, 2) have a crossing edge, the fourth one grew.
        assert verdict.invalid.tolist() == [1, 4, 5]
        assert verdict.ratio[0] >= 1.0


def test_smaller_jacobians_than_allowed_are_invalid():
    before = block(6) + 0.15 * np.random.default_rng(4).standard_normal((6, 6, 6, 3))
    after = (before * [1.0, 1.0, 0.3]).reshape(-1, 3)
    for limit, invalid in ((0.0, 0), (0.3, 0), (0.3 + 4e-8, 125), (0.4, 125)):
        assert judge(original_of(before, min_jacobian=limit), after).invalid.size == invalid
    assert judge(original_of(block(2), min_jacobian=0.25), 0.5 * block(2).reshape(-1, 3) * [1.0, 1.0, 2.0]).valid


def wedge():
    """A block whose edge along k is collapsed on an axis, with noise of single precision on it."""
    r, phi, z = np.meshgrid(np.linspace(0, 1, 5), np.linspace(0, 1.2, 6), np.linspace(0, 2, 4), indexing="ij")
    x = np.stack([r * np.cos(phi), r * np.sin(phi), z], axis=-1)
    return x.astype(np.float32).astype(float)


@pytest.mark.parametrize("shift", [0.0, 0.3, 1e3])
@pytest.mark.parametrize("angle", [0.0, 0.7, 3.0])
def test_collapsed_edges_survive_translation_and_rotation(angle, shift):
    before = wedge()
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1.0]])
    turn = turn @ np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])
    verdict = judge(original_of(before), before.reshape(-1, 3) @ turn.T + shift)
    assert verdict.valid
    assert abs(verdict.ratio.min() - 1.0) < 1e-6
    crushed = before.copy()
    crushed[3, 2, 1] += [0.0, 0.0, 1.5]
    assert not judge(original_of(before), crushed.reshape(-1, 3)).valid


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_coordinates_that_are_no_numbers_are_an_error(monkeypatch, value):
    apply = composite.PreparedComposite.apply

    def broken(self, *arguments):
        out = apply(self, *arguments)
        out[17, 1] = value
        return out

    case, grid = Case(tuple(body_specs(constant(0.01, 0, 0)))), frame()
    assert deform(grid, case).valid
    monkeypatch.setattr(composite.PreparedComposite, "apply", broken)
    name = grid.node_label(17).replace("(", r"\(").replace(")", r"\)")
    with pytest.raises(MethodError, match=rf"moves {name} to \(.*{value}.*expected finite coordinates"):
        deform(grid, case)


def box(shape):
    return np.stack(np.meshgrid(*(np.arange(n, dtype=float) for n in shape), indexing="ij"), axis=-1)


def plain(x, sign):
    """f_skew, smallest scaled corner, corner Jacobians and volume: Knupp's definitions, Gauss quadrature."""
    cells = cell_corners(x).reshape(-1, 2, 2, 2, 3)
    jacobian, size = [], []
    for a, b, c in itertools.product((0, 1), repeat=3):
        u = cells[:, 1, b, c] - cells[:, 0, b, c]
        v = cells[:, a, 1, c] - cells[:, a, 0, c]
        w = cells[:, a, b, 1] - cells[:, a, b, 0]
        jacobian.append(sign * np.linalg.det(np.stack([u, v, w], axis=1)))
        size.append(np.linalg.norm(u, axis=1) * np.linalg.norm(v, axis=1) * np.linalg.norm(w, axis=1))
    jacobian, size = np.stack(jacobian, axis=1), np.stack(size, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        skew = np.where((jacobian > 0).all(axis=1), 8 / ((size / np.abs(jacobian)) ** (2 / 3)).sum(axis=1), 0.0)
        scaled = (jacobian / size).min(axis=1)
    return skew, scaled, jacobian, quadrature(cells, sign)


def quadrature(cells, sign):
    at, weight = np.polynomial.legendre.leggauss(3)
    total = 0.0
    for index in itertools.product(range(3), repeat=3):
        shape = [np.array([1 - at[n], 1 + at[n]]) / 2 for n in index]
        slope = np.array([-0.5, 0.5])
        rows = [
            np.einsum("nabcd,a,b,c->nd", cells, *(slope if axis == other else shape[other] for other in range(3)))
            for axis in range(3)
        ]
        total = total + np.prod(weight[list(index)]) * np.linalg.det(np.stack(rows, axis=1))
    return sign * total


def inspect(before, x, sign=1.0, scale=1.0):
    shape = tuple(n - 1 for n in x.shape[:3])
    out, is_open, scratch = np.empty((OPEN, *shape), np.float32), np.empty(shape, dtype=bool), Scratch.new()
    inspect_hexahedra(before, x, before is not x, sign, scale, 0, shape[0], out, is_open, np.zeros(TOTALS), scratch)
    return out.reshape(OPEN, -1), is_open.ravel()


def test_what_is_not_open_is_positive_everywhere():
    rng = np.random.default_rng(0)
    for amount in (0.1, 0.2, 0.3):
        x = box((12, 12, 12)) * [1.0, 1e-4, 50.0]
        x += amount * rng.standard_normal(x.shape) * [1.0, 1e-4, 50.0]
        is_open = inspect(x, x)[1]
        lowest = sampled_jacobian(cell_corners(x), 12).min(axis=1)
        assert (lowest[~is_open] > 0).all()
        assert is_open[lowest <= 0].all()


@pytest.mark.parametrize("size", [1e-9, 1.0, 1e9])
def test_smooth_cells_are_proved_at_any_size_and_place(size):
    x = box((20, 21, 22))
    x = size * (x + 0.3 * np.sin(0.4 * x[..., ::-1])) * [1.0, 1e-3, 10.0]
    for shift in (0.0, 100.0 * size):
        out, is_open = inspect(x, x + shift, scale=1.0 / size)
        assert not is_open.any()
        np.testing.assert_allclose(out[2], 1.0, rtol=1e-4)


def test_collapsed_flat_and_minute_cells_are_left_open():
    x = box((4, 4, 4))
    x[1, :, 1] = x[2, :, 1]
    x[3, 3, 3] = [2.0, 2.0, 2.0]
    assert inspect(x, x)[1].any()
    x = box((3, 3, 3)) * 1e-14
    assert inspect(x, x)[1].all()
    x = box((3, 3, 3)) @ np.array([[1, 0, 0], [1, 1e-3, 0], [0, 0, 1.0]])
    assert inspect(x, x)[1].all()
    x = box((3, 3, 3))
    x[1, 1, 1] = np.nan
    assert inspect(x, x)[1].all()


def test_scattered_cells_are_measured_like_the_definitions():
    rng = np.random.default_rng(5)
    x = box((6, 6, 6)) + 0.35 * rng.standard_normal((6, 6, 6, 3))
    expected = plain(x, 1.0)
    assert (expected[0] == 0).any()
    for values, found in zip(expected, measure_cells(cell_corners(x), 1.0), strict=False):
        np.testing.assert_allclose(found, values, rtol=1e-10, atol=1e-13)


@pytest.mark.parametrize("flip", [False, True])
def test_extremes_and_totals_of_a_report_are_in_double_precision(flip):
    rng = np.random.default_rng(8)
    before = box((9, 8, 7)) + 0.05 * rng.standard_normal((9, 8, 7, 3))
    after = before + 0.1 * rng.standard_normal(before.shape)
    if flip:
        before, after = (np.ascontiguousarray(x[:, ::-1]) for x in (before, after))
    grid = Grid.from_blocks([before])
    original = Original(grid, find_topology(grid))
    quality = assess(original, after.reshape(-1, 3), None).after
    new, old = (plain(x, -1.0 if flip else 1.0) for x in (after, before))
    assert quality.invalid_cells == 0
    assert quality.f_skew.min == pytest.approx(new[0].min(), rel=1e-12)
    assert quality.min_scaled_jacobian == pytest.approx(new[1].min(), rel=1e-12)
    assert quality.min_relative_jacobian == pytest.approx((new[2] / old[2]).min(), rel=1e-12)
    assert quality.volume_ratio.min == pytest.approx((new[3] / old[3]).min(), rel=1e-12)
    assert quality.volume_ratio.max == pytest.approx((new[3] / old[3]).max(), rel=1e-12)
    assert quality.total_volume == pytest.approx(new[3].sum(), rel=1e-12)
    assert quality.f_skew.mean == pytest.approx(new[0].mean(), rel=TOLERANCE)
    assert quality.f_skew.harmonic_mean == pytest.approx(1 / (1 / new[0]).mean(), rel=TOLERANCE)
    assert quality.f_skew.p01 == pytest.approx(np.sort(new[0])[-(-new[0].size // 100) - 1], rel=TOLERANCE)
    assert quality.f_skew.histogram == tuple(np.histogram(new[0], 20, (0.0, 1.0))[0])


@pytest.mark.parametrize("kind", [Kind.MOVING, Kind.FIXED])
def test_invalid_cells_are_listed_the_worst_first(kind):
    """At most 200 of them, with the boundary that was nearest before the motion: of those that move, if any do."""
    before = box((9, 8, 7))
    after = before + 0.8 * np.random.default_rng(1).standard_normal(before.shape) + [9.0, 0.0, 0.0]
    original = original_of(before)
    still = {Kind.MOVING: STILL}.get(kind)
    specs = [BoundarySpec(side, (f"block1.{side}",), kind, None, still) for side in ("imin", "imax")]
    boundary = classify(original.grid, original.topology, specs, {})
    found = assess(original, after.reshape(-1, 3), boundary, step_of=lambda cell: 7 * cell)
    failed, (skew, _, jacobian, volume) = judge(original, after.reshape(-1, 3)).failed, plain(after, 1.0)
    worst = np.argsort(np.where(failed != 0, jacobian.min(axis=1), np.inf))[:200]
    assert found.after.invalid_cells == np.count_nonzero(failed) > 200 == len(found.invalid)
    assert found.after.negative_volumes == np.count_nonzero(volume < 0.0)
    own = (each for each in boundary.patches if each.kind is kind)
    nodes = {each.name: original.grid.points[original.topology.first[each.nodes]] for each in own}
    places = np.stack(np.unravel_index(worst, (8, 7, 6)), axis=1)
    for one, cell, place in zip(found.invalid, worst.tolist(), places.tolist(), strict=True):
        start, center = (cell_corners(x)[cell].mean(axis=0) for x in (before, after))
        apart = {name: np.linalg.norm(x - start, axis=1).min() for name, x in nodes.items()}
        assert one == InvalidCell(
            "block1", tuple(n + 1 for n in place), pytest.approx(skew[cell]), pytest.approx(jacobian[cell].min()),
            pytest.approx(center), Failure(failed[cell]).label, min(apart, key=apart.get), 7 * cell,
        )  # fmt: skip
