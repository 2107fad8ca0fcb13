"""Fields combined from earlier ones against fields computed anew."""

import copy
import dataclasses
import pickle

import numpy as np
import pytest
from cases import ALL_METHODS, body_specs, problem_of, turning
from grids import frame

from meshdeform_core import memory
from meshdeform_core.boundary import Kind
from meshdeform_core.deform import Case, set_up
from meshdeform_core.memory import MemoryLimit
from meshdeform_core.methods import IDW, RBF, Options, Superposition, make_method, remembering
from meshdeform_core.repair import RepairOptions
from meshdeform_core.series import Schedule, deform_series

LINEAR = ("tfi", "rbf-tps", "rbf-ctps-c1", "rbf-krylov", "rbf-tfi", "idw-none")


def problem(span=Kind.SLIP, **changes):
    return dataclasses.replace(problem_of(frame(), body_specs(turning(0.0), span)), **changes)


class Counting:
    """A prepared method that counts its calls."""

    def __init__(self, method):
        self.method, self.linear, self.cheap, self.account = method, method.linear, method.cheap, method.account
        self.calls = 0

    def apply(self, displacement, progress=None):
        self.calls += 1
        return self.method.apply(displacement, progress)


def counted(options, where):
    count = Counting(make_method(options).prepare(where))
    return count, Superposition(count, where)


def mode(where, number=1):
    moving = where.boundary.kind[where.source_numbers] == Kind.MOVING
    x = where.source_points
    shape = np.stack([np.sin(number * x[:, 1]), np.cos(number * x[:, 0] + x[:, 2]), x[:, 0] * x[:, 1] * number], axis=1)
    return 0.05 * np.where(moving[:, None], shape, 0.0)


def turned(where, angle):
    moving = where.boundary.kind[where.source_numbers] == Kind.MOVING
    c, s = np.cos(angle), np.sin(angle)
    x = where.source_points
    return np.where(moving[:, None], x @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) - x, 0.0)


@pytest.mark.parametrize("name", LINEAR)
@pytest.mark.parametrize("span", [Kind.SLIP, Kind.FIXED])
def test_combinations_are_what_the_method_gives(name, span):
    where = problem(span)
    count, method = counted(ALL_METHODS[name], where)
    one, two = mode(where), mode(where, 2)
    for first in (one, two):
        method.apply(first)
    alone = make_method(ALL_METHODS[name]).prepare(where)
    for level in (0.3 * one, 0.5 * one - 0.7 * two, 0 * one, two):
        found = method.apply(level)
        assert method.account.settings["combined_from"].value == 2
        # Round-off of solving: the systems are small, the solvers direct or converged to 1e-13.
        np.testing.assert_allclose(found, alone.apply(level), rtol=0, atol=1e-11)
    assert count.calls == 2


def test_a_turning_body_is_computed_once_where_components_are_alike():
    where = problem(Kind.FIXED)
    count, method = counted(Options("rbf-tfi"), where)
    method.apply(turned(where, 0.8))
    alone = make_method(Options("rbf-tfi")).prepare(where)
    for angle in (0.4, -0.9, 1.1):
        np.testing.assert_allclose(method.apply(turned(where, angle)), alone.apply(turned(where, angle)), atol=1e-11)
    assert count.calls == 1


def test_what_errors_would_be_magnified_in_is_computed():
    where = problem()
    count, method = counted(Options("tfi"), where)
    for factor in (1.0, 1.9, -0.5):
        method.apply(factor * mode(where))
    assert count.calls == 1
    method.apply(2.1 * mode(where))
    assert count.calls == 2
    # The larger one has taken the place of the smaller one.
    assert len(method._fields) == 1
    method.apply(4.0 * mode(where))
    assert count.calls == 2


def test_other_displacements_are_computed():
    where = problem()
    count, method = counted(Options("tfi"), where)
    method.apply(mode(where))
    nearly = mode(where) * (1 + 1e-9 * np.random.default_rng(0).standard_normal((len(where.source_points), 3)))
    alone = make_method(Options("tfi")).prepare(where)
    np.testing.assert_array_equal(method.apply(nearly), alone.apply(nearly))
    assert count.calls == 2
    assert "combined_from" not in method.account.settings


def test_a_result_belongs_to_the_caller():
    where = problem()
    _, method = counted(Options("tfi"), where)
    first = method.apply(mode(where))
    kept = first.copy()
    first += 1.0
    again = method.apply(mode(where))
    np.testing.assert_allclose(again, kept, atol=1e-15)
    again[:] = np.nan
    np.testing.assert_allclose(method.apply(mode(where)), kept, atol=1e-15)


@pytest.mark.parametrize(("fields", "expected"), [(0, 0), (1, 1), (2, 2), (100, 6)])
def test_memory_limits_what_is_stored(fields, expected):
    size = problem().grid.points.nbytes
    where = problem(memory=MemoryLimit(4 * fields * size + 1000, "--max-memory allows"))
    _, method = counted(Options("tfi"), where)
    alone = make_method(Options("tfi")).prepare(where)
    for number in range(1, 9):
        noise = np.random.default_rng(number).standard_normal((len(where.source_points), 3))
        found = method.apply(noise)
        assert len(method._fields) <= expected
        np.testing.assert_array_equal(found, alone.apply(noise))
    assert len(method._fields) == expected


@pytest.mark.parametrize(("free", "expected"), [(-1.0, 0), (0.5, 0), (1.5, 1), (2.0, 2)])
def test_what_a_solution_has_taken_is_not_there_for_fields(monkeypatch, free, expected):
    size = problem().grid.points.nbytes
    limit = MemoryLimit(100 * size, "--max-memory allows", taken=1000 * size)
    peak = [int((1100 - free) * size)]
    monkeypatch.setattr(memory, "peak_memory", lambda: peak[0])
    where = problem(memory=limit)
    _, method = counted(Options("tfi"), where)
    alone = make_method(Options("tfi")).prepare(where)
    for number in range(1, 5):
        noise = np.random.default_rng(number).standard_normal((len(where.source_points), 3))
        np.testing.assert_array_equal(method.apply(noise), alone.apply(noise))
        peak[0] = int((1100 - free + len(method._fields)) * size)
        assert len(method._fields) <= expected
    assert len(method._fields) == expected


def test_a_motion_without_few_shapes_stores_nothing_in_the_end():
    where = problem()
    count, method = counted(Options("tfi"), where)
    for number in range(1, 20):
        method.apply(mode(where, number))
    assert count.calls == 19
    assert not method._fields


@pytest.mark.parametrize(
    "options",
    [
        Options(),
        Options("idw", idw=IDW(rotation="none", alpha="auto")),
        Options("rbf", rbf=RBF(basis="wendland-c2", radius=6.0, greedy="hybrid")),
    ],
)
def test_methods_that_are_not_linear_stay_as_they_are(options):
    where = problem()
    prepared = make_method(options).prepare(where)
    assert remembering(prepared, where) is prepared


def test_tfi_stores_nothing_because_combining_would_cost_as_much():
    where = problem()
    prepared = make_method(Options("tfi")).prepare(where)
    assert remembering(prepared, where) is prepared
    for name in ("rbf-tfi", "rbf-tps", "idw-none"):
        assert isinstance(remembering(make_method(ALL_METHODS[name]).prepare(where), where), Superposition)


@pytest.mark.parametrize("twin", [copy.deepcopy, lambda method: pickle.loads(pickle.dumps(method))])
def test_copies_keep_the_fields(twin):
    where = problem()
    method = Superposition(make_method(Options("tfi")).prepare(where), where)
    known = method.apply(mode(where))
    other = twin(method)
    np.testing.assert_allclose(other.apply(0.5 * mode(where)), 0.5 * known, atol=1e-15)
    assert other.account.settings["combined_from"].value == 1
    other.clear()
    np.testing.assert_allclose(other.apply(0.5 * mode(where)), 0.5 * known, atol=1e-12)
    assert "combined_from" not in other.account.settings


@pytest.mark.slow
@pytest.mark.parametrize("name", ["tfi", "rbf-krylov"])
def test_a_hundred_levels_are_those_of_single_runs(name):
    options = ALL_METHODS[name]
    setup = set_up(
        frame(),
        Case(tuple(body_specs(turning("30*sin(2*pi*t)"), Kind.FIXED)), method=options, repair=RepairOptions("off")),
    )
    sources = setup.problem.source_numbers
    alone = make_method(options)
    prepared = alone.prepare(setup.problem)
    computed = 0
    times = tuple(np.linspace(0, 1, 101))
    for level in deform_series(setup, Schedule(times), "float64"):
        if level.number % 10 in (0, 3):
            single = prepared.apply(setup.displacement(level.time)[sources])
            np.testing.assert_allclose(level.result.grid.points, setup.grid.points + single, rtol=0, atol=1e-11)
        computed += "combined_from" not in level.result.account.settings
    assert computed == 101 if name == "tfi" else computed <= 8
