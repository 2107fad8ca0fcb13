"""Products by nested skeletons against exact sums, and solutions whose products they are."""

import numpy as np
import pytest
from clouds import SETS, bend, sphere

from meshdeform_core.errors import MethodError
from meshdeform_core.memory import MemoryLimit
from meshdeform_core.methods import RBF
from meshdeform_core.methods.base import Account
from meshdeform_core.methods.scattered.radial_system import Centres, RadialSystem
from meshdeform_core.numerics.exact.basis import BASES
from meshdeform_core.numerics.exact.radial import radial_matrix, radial_sums
from meshdeform_core.numerics.fastsum.nested import NestedSums
from meshdeform_core.numerics.systems import products
from meshdeform_core.numerics.systems.krylov import KrylovSolver
from meshdeform_core.numerics.systems.products import NestedProduct

CLOUDS = SETS | {
    "volume": np.random.default_rng(1).uniform(size=(3000, 3)),
    "duplicates": np.repeat(sphere(700), 3, axis=0),
    "one point": np.zeros((300, 3)),
    "few": sphere(7),
}
RADIUS = {"tps": None, "wendland-c0": 5.0, "wendland-c2": 0.7, "ctps-c1": 2.0, "ctps-c2a": 5.0, "ctps-c2b": 1.0}


def normalised(name, basis):
    points = CLOUDS[name]
    extent = np.linalg.norm(points - points.mean(axis=0), axis=1).max() or 1.0
    radius = RADIUS[basis]
    return Centres.of(points, None if radius is None else radius * extent).points


def charges(n):
    """Coefficients of random signs: what a cluster does nearly cancels, as with coefficients of an interpolation."""
    return np.random.default_rng(n).standard_normal((n, 3))


@pytest.mark.parametrize("basis", RADIUS)
@pytest.mark.parametrize("name", CLOUDS)
def test_sums_are_the_exact_ones_to_the_tolerance(name, basis):
    points, kind = normalised(name, basis), BASES[basis]
    c = charges(len(points))
    exact = radial_sums(kind, points, points, c)
    size = np.abs(radial_matrix(kind, points[:50], points)).max() * np.sqrt(len(points))
    for tolerance in (1e-4, 1e-8):
        found = NestedSums(kind, points, tolerance)(c)
        # The singular part is up to 60 r^3 log r (see decompose), and a sum has a hundred clusters or so.
        assert np.abs(found - exact).max() <= 100 * tolerance * size + 1e-12 * size


def test_far_clusters_are_not_summed_centre_by_centre():
    points = Centres.of(sphere(20000), None).points
    sums = NestedSums(0, points, 1e-8)
    assert sums.pairs < 0.2 * len(points) ** 2
    c = charges(len(points))
    rows = np.arange(0, len(points), 97)
    np.testing.assert_allclose(sums(c)[rows], radial_sums(0, points[rows], points, c), atol=1e-5)


@pytest.fixture
def nested(monkeypatch):
    monkeypatch.setattr(products, "_FEWEST", 100)
    monkeypatch.setattr(products, "_LARGEST_PART", 10.0)


def solved(points, basis="tps", radius=None, tolerance=1e-6, limit=2**40):
    system = RadialSystem(RBF(solver="krylov", basis=basis, tolerance=tolerance), Centres.of(points, radius),
                          MemoryLimit(limit, "the machine has"))  # fmt: skip
    account, told = Account(), bend(points)
    coefficients, polynomial = system.solve(told, account, None)
    x = system.centres.points
    rest = told - radial_sums(system.kind, x, x, coefficients) - system.terms @ polynomial
    size = np.linalg.norm(told, axis=0)
    return system, np.linalg.norm(rest, axis=0) / np.where(size > 0, size, 1.0), account


@pytest.mark.parametrize(("basis", "radius"), [("tps", None), ("wendland-c0", 4.0), ("ctps-c1", 3.0)])
@pytest.mark.parametrize("name", ["sphere", "graded-plane", "two-scales"])
def test_solutions_have_the_residual_that_is_reported(nested, name, basis, radius):
    points = SETS[name] / np.abs(SETS[name]).max()
    system, residual, account = solved(points, basis, radius)
    assert isinstance(system._krylov.product, NestedProduct)
    assert residual.max() <= 1e-6
    # Reported is the residual by nested sums and the norm of their error: an upper bound, not far off.
    reported = np.array(account.settings["residual"].value)
    assert (residual <= 1.1 * reported).all()
    assert (reported <= 2 * residual + 3e-7).all()


def test_sums_that_are_too_coarse_are_refined(nested, monkeypatch):
    monkeypatch.setattr(products, "_FINER", 1e3)
    system, residual, account = solved(sphere(3000))
    assert residual.max() <= 1e-6
    assert system._krylov.product._tolerance < 1e-4
    assert "nested" in account.settings["products"].value


def test_little_memory_is_refused_and_changes_no_sums(nested):
    points = sphere(3000)
    with pytest.raises(MethodError, match=r"3,000 centres needs about .*the machine has"):
        solved(points, limit=KrylovSolver.memory(3000) + 10_000)
    with pytest.raises(MethodError, match=r"3,000 centres needs about .*the machine has"):
        solved(100 * points, "wendland-c2", 5.0, limit=KrylovSolver.memory(3000) + 10_000)


@pytest.mark.slow
def test_solutions_do_not_depend_on_those_before(nested, monkeypatch):
    """The first of them makes products finer, which the others must not profit from."""
    monkeypatch.setattr(products, "_FINER", 1e3)
    points = sphere(3000)
    one, two = bend(points), 1e-3 * bend(points)[:, ::-1].copy()
    system, fresh = solved(points)[0], solved(points)[0]
    assert len(system._krylov.product._made) > 1
    for told in (two, one, two):
        found, account = system.solve(told, Account(), None), Account()
        np.testing.assert_array_equal(found[0], fresh.solve(told, account, None)[0])
        other = RadialSystem(RBF(solver="krylov", tolerance=1e-6), Centres.of(points, None))
        np.testing.assert_array_equal(found[0], other.solve(told, account, None)[0])
