"""Solutions that set out from earlier ones: the same within the tolerance, whatever was solved before."""

import copy
import pickle

import numpy as np
import pytest

from meshdeform_core.memory import MemoryLimit
from meshdeform_core.methods import RBF
from meshdeform_core.methods.base import Account
from meshdeform_core.methods.scattered.radial_system import RadialSystem
from meshdeform_core.methods.scattered.rbf_sums import Centres
from meshdeform_core.numerics.exact.radial import radial_sums

TOLERANCE = 1e-6


def shell(n: int = 1500) -> np.ndarray:
    """Points of a sphere and of a box around it, none of them placed regularly."""
    random = np.random.default_rng(3)
    body = random.standard_normal((n // 2, 3))
    box = random.uniform(-4, 4, (n - n // 2, 3))
    box[np.arange(len(box)), np.arange(len(box)) % 3] = 4.0
    return np.concatenate([body / np.linalg.norm(body, axis=1)[:, None], box])


POINTS = shell()
BODY = np.arange(len(POINTS)) < 750


def turned(angle: float) -> np.ndarray:
    """Displacement of a body that turns about z in a box that does not."""
    c, s = np.cos(angle), np.sin(angle)
    return np.where(BODY[:, None], POINTS @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) - POINTS, 0.0)


def prepared(limit: MemoryLimit | None = None) -> RadialSystem:
    options = RBF(solver="krylov", tolerance=TOLERANCE)
    return RadialSystem(options, Centres.of(POINTS, None), limit or MemoryLimit(2**40, "the machine has"))


def solve(system: RadialSystem, values: np.ndarray) -> tuple[np.ndarray, dict]:
    """The solution's coefficients and what was reported; its residual by exact sums is within the tolerance."""
    account = Account()
    coefficients, polynomial = system.solve(values, account, None)
    x = system.centres.points
    rest = values - radial_sums(system.kind, x, x, coefficients) - system.terms @ polynomial
    assert (np.linalg.norm(rest, axis=0) <= 1.001 * TOLERANCE * np.linalg.norm(values, axis=0)).all()
    return coefficients, {name: setting.value for name, setting in account.settings.items()}


def test_a_rotation_of_any_angle_is_a_combination_of_the_first():
    system = prepared()
    _, first = solve(system, turned(0.1))
    assert first["starting_residual"] == pytest.approx(1.0)
    assert first["iterations"] >= 3
    for angle in (0.2, -1.0, 2.5):
        found, report = solve(system, turned(angle))
        # What the first one left, magnified by no more than its cancellation.
        assert report["starting_residual"] < 100 * TOLERANCE
        assert report["iterations"] <= 2
        single, _ = solve(prepared(), turned(angle))
        np.testing.assert_allclose(found, single, atol=1e-3 * np.abs(single).max())


def test_multiples_take_no_iteration():
    system = prepared()
    solve(system, turned(0.5))
    for level in range(1, 6):
        _, report = solve(system, np.sin(level) * turned(0.5))
        assert report["iterations"] == 0


def test_noise_is_solved_for_and_the_motion_below_it_is_not_forgotten():
    system, random = prepared(), np.random.default_rng(0)
    report = []
    for level in range(1, 21):
        noise = 1 + 1e-3 * random.standard_normal(POINTS.shape)
        report.append(solve(system, np.sin(level) * turned(0.5) * noise)[1])
    assert system._krylov is not None
    assert len(system._krylov.earlier) == 36
    assert max(level["starting_residual"] for level in report[1:]) < 0.02
    assert max(level["iterations"] for level in report[1:]) < report[0]["iterations"]


def test_order_does_not_matter_beyond_the_tolerance():
    angles = [0.3, 1.1, -0.4]
    one, two = prepared(), prepared()
    forwards = {angle: solve(one, turned(angle))[0] for angle in angles}
    backwards = {angle: solve(two, turned(angle))[0] for angle in reversed(angles)}
    for angle in angles:
        np.testing.assert_allclose(forwards[angle], backwards[angle], atol=1e-3 * np.abs(forwards[angle]).max())


@pytest.mark.parametrize("twin", [copy.deepcopy, lambda system: pickle.loads(pickle.dumps(system))])
def test_copies_remember_on_their_own(twin):
    system = prepared()
    solve(system, turned(0.5))
    other = twin(system)
    assert solve(other, 2 * turned(0.5))[1]["iterations"] == 0
    other._krylov.earlier.clear()
    assert solve(other, 2 * turned(0.5))[1]["starting_residual"] == pytest.approx(1.0)
    assert solve(system, 2 * turned(0.5))[1]["iterations"] == 0


def test_little_memory_means_little_to_remember():
    from meshdeform_core.numerics.systems.krylov import KrylovSolver

    n = len(POINTS)
    system = prepared(MemoryLimit(KrylovSolver.memory(n, 2), "--max-memory allows"))
    for angle in (0.1, 0.2):
        solve(system, turned(angle) + np.sin(9 * angle * POINTS))
    assert len(system._krylov.earlier) == 6
    none = prepared(MemoryLimit(KrylovSolver.memory(n), "--max-memory allows"))
    solve(none, turned(0.5))
    assert solve(none, turned(0.5))[1]["starting_residual"] == pytest.approx(1.0)
