"""RBF against scipy and a slow twin; its solvers, its greedy reduction, its centres."""

import dataclasses

import numpy as np
import pytest
from cases import apply, body_specs, everything_moves, inner_nodes, problem_of, told, turning
from grids import frame, frame_2d, polar
from reference.rbf import COMPACT, basis, distances, slow_rbf
from scipy.interpolate import RBFInterpolator

from meshdeform_core.boundary import BoundarySpec, Kind
from meshdeform_core.errors import MethodError
from meshdeform_core.grid import Grid
from meshdeform_core.memory import MemoryLimit
from meshdeform_core.methods import RBF, Options, Problem, make_method


def moved_by(options: RBF, problem: Problem) -> np.ndarray:
    return apply(Options("rbf", rbf=options), problem, told(problem))


def bent(problem: Problem) -> np.ndarray:
    """A smooth displacement of the sources that is not linear."""
    x = problem.source_points
    return np.stack([0.1 * np.sin(2 * x[:, 1]), 0.15 * np.cos(2 * x[:, 0]), 0.05 * x[:, 0] * x[:, 1]], axis=1)


@pytest.mark.parametrize(("solver", "axes"), [("direct", 3), ("krylov", 3), ("direct", 2)])
def test_thin_plate_spline_is_that_of_scipy(solver, axes):
    problem = problem_of(
        *((frame(), body_specs(turning(25))) if axes == 3 else (frame_2d(), body_specs(turning(25))[:1]))
    )
    inside = inner_nodes(problem)
    spline = RBFInterpolator(problem.source_points[:, :axes], told(problem), kernel="thin_plate_spline", degree=1)
    moved = moved_by(RBF(solver=solver, tolerance=1e-13), problem)[inside]
    np.testing.assert_allclose(moved, spline(problem.grid.points[inside, :axes]), rtol=0, atol=1e-9)


@pytest.mark.parametrize("radius", [1.5, 6.0])
@pytest.mark.parametrize("name", COMPACT)
def test_compact_functions_have_a_slow_twin(name, radius):
    problem = problem_of(frame(), body_specs(turning(25)))
    inside = inner_nodes(problem)
    moved = moved_by(RBF(basis=name, radius=radius), problem)[inside]
    expected = slow_rbf(name, radius, problem.source_points, told(problem), problem.grid.points[inside])
    np.testing.assert_allclose(moved, expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("specs", [None, [BoundarySpec("top", ("block3.kmin",), Kind.MOVING, None, turning(5)),
                                          BoundarySpec("rest", ("*",), Kind.FREE)]], ids=["all", "planar"])  # fmt: skip
@pytest.mark.parametrize("options", [RBF(), RBF(basis="wendland-c2", radius=3.0)], ids=["tps", "compact"])
def test_planar_centres_have_a_solution(specs, options):
    """All centres in the plane z = 0, in two and in three dimensions: no polynomial term across it."""
    problem = problem_of(frame_2d() if specs is None else frame(), specs or everything_moves(turning(5)))
    assert np.all(problem.source_points[:, 2] == 0.0)
    prepared = make_method(Options("rbf", rbf=options)).prepare(problem)
    assert prepared.account.settings["polynomial"].value == "linear in 2 directions"
    values = bent(problem) * [1, 1, 0]
    targets = inner_nodes(problem)
    expected = slow_rbf(options.basis, 3.0, problem.source_points, values, problem.grid.points[targets], (0, 1))
    np.testing.assert_allclose(prepared.apply(values)[targets], expected, rtol=0, atol=1e-9)


def test_seams_and_poles_are_one_centre_each():
    """An O-grid whose inner circle is collapsed to its axis: hundreds of block nodes share centres."""
    pole = polar()
    blocks = [pole.block(0).copy()]
    blocks[0][:, -1, :, :2] = 0.0
    problem = problem_of(Grid.from_blocks(blocks), everything_moves())
    assert len(np.unique(problem.source_points, axis=0)) == len(problem.source_points)
    values = bent(problem)
    moved = apply(Options("rbf"), problem, values)
    inside = inner_nodes(problem)
    expected = slow_rbf("tps", 1.0, problem.source_points, values, problem.grid.points[inside])
    np.testing.assert_allclose(moved[inside], expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", COMPACT)
def test_greedy_reduction_keeps_its_tolerance(name):
    """Errors at all boundary nodes, found by evaluating the reduced interpolation with the slow formulas."""
    problem = problem_of(frame(3, 2), body_specs(turning(25)))
    options = RBF(basis=name, radius=6.0, greedy="hybrid", greedy_error="absolute", greedy_tolerance=0.02,
                  greedy_updates=50)  # fmt: skip
    prepared = make_method(Options("rbf", rbf=options)).prepare(problem)
    values = told(problem)
    prepared.apply(values)
    bound = prepared.mover.bound
    fit = bound.fit(values)
    settings = prepared.account.settings
    kept = settings["greedy_points"].value
    assert kept == len(fit.centres) < len(values)
    x = (problem.source_points - problem.source_points.mean(axis=0)) / 6.0
    terms = bound.centres.polynomial(x)[:, : len(fit.polynomial)]
    reduced = basis(name, distances(x, fit.centres), 1.0) @ fit.coefficients + terms @ fit.polynomial
    error = np.abs(reduced - values).max()
    assert error <= 0.02
    np.testing.assert_allclose(settings["greedy_error_reached"].value, error, rtol=1e-6)
    assert prepared.account.warnings == []


@pytest.mark.parametrize("error", ["first-cell", "absolute"])
def test_greedy_correction_lands_exactly_and_continuously(error):
    """Nodes beside a wall are carried with the residual of the wall node, so that first cells keep their shape."""
    problem = problem_of(frame(3, 2), body_specs(turning(25)))
    options = RBF(basis="wendland-c2", radius=6.0, greedy="hybrid", greedy_error=error, greedy_tolerance=0.05)
    moved = moved_by(options, problem)
    np.testing.assert_array_equal(moved[problem.source_flat], told(problem))
    plain = moved_by(dataclasses.replace(options, greedy_correct=False), problem)
    everything = moved_by(RBF(basis="wendland-c2", radius=6.0), problem)
    inside = inner_nodes(problem)
    scale = problem.first_cell_height.max() if error == "first-cell" else 1.0
    change = np.abs(moved - plain)[inside].max()
    assert 0 < change <= 0.05 * scale
    assert np.abs(moved - everything)[inside].max() < 0.2 * scale


def test_a_tolerance_that_no_centre_can_reach_is_a_warning():
    problem = problem_of(frame(3, 2), body_specs(turning(25)))
    options = RBF(basis="ctps-c1", radius=6.0, greedy="hybrid", greedy_tolerance=1e-30)
    prepared = make_method(Options("rbf", rbf=options)).prepare(problem)
    prepared.apply(told(problem))
    assert any(f"greedy reduction stopped with {len(problem.source_points)} points" in text
               for text in prepared.account.warnings)  # fmt: skip


def test_thin_plate_splines_cannot_be_reduced():
    with pytest.raises(MethodError, match=r"thin plate spline.*wendland-c2"):
        RBF(basis="tps", greedy="hybrid")


@pytest.mark.parametrize("solver", ["direct", "krylov"])
def test_what_does_not_fit_is_refused_with_alternatives(solver):
    problem = problem_of(frame(3, 2), body_specs(turning(25)))
    tight = dataclasses.replace(problem, memory=MemoryLimit(5000, "--max-memory allows"))
    with pytest.raises(MethodError, match=r"\d+ centres needs about .*iB, --max-memory allows 4\.88 KiB; use "):
        make_method(Options("rbf", rbf=RBF(solver=solver))).prepare(tight)
