"""Radial basis functions the slow way: the formulas of the paper's Table I, one dense system, one dense product."""

import numpy as np


def _with_log(r: np.ndarray, power: int) -> np.ndarray:
    return np.where(r > 0, r**power * np.log(np.where(r > 0, r, 1.0)), 0.0)


COMPACT = {
    "wendland-c0": lambda r: (1 - r) ** 2,
    "wendland-c2": lambda r: (1 - r) ** 4 * (4 * r + 1),
    "ctps-c1": lambda r: 1 + 80 / 3 * r**2 - 40 * r**3 + 15 * r**4 - 8 / 3 * r**5 + 20 * _with_log(r, 2),
    "ctps-c2a": lambda r: 1 - 30 * r**2 - 10 * r**3 + 45 * r**4 - 6 * r**5 - 60 * _with_log(r, 3),
    "ctps-c2b": lambda r: 1 - 20 * r**2 + 80 * r**3 - 45 * r**4 - 16 * r**5 + 60 * _with_log(r, 4),
}


def basis(name: str, r: np.ndarray, radius: float) -> np.ndarray:
    """Basis values at distances ``r``."""
    if name == "tps":
        return _with_log(r, 2)
    s = r / radius
    return np.where(s < 1, COMPACT[name](np.minimum(s, 1.0)), 0.0)


def polynomial(x: np.ndarray, dimensions: tuple[int, ...]) -> np.ndarray:
    return np.concatenate([np.ones((len(x), 1)), x[:, dimensions]], axis=1)


def slow_rbf(
    name: str,
    radius: float,
    centres: np.ndarray,
    values: np.ndarray,
    targets: np.ndarray,
    dimensions: tuple[int, ...] = (0, 1, 2),
) -> np.ndarray:
    """Interpolation with a linear polynomial in the given coordinate directions, eqs. 11-13."""
    p = polynomial(centres, dimensions)
    coefficients, linear = solution(basis(name, distances(centres, centres), radius), p, values)
    return basis(name, distances(targets, centres), radius) @ coefficients + polynomial(targets, dimensions) @ linear


def solution(matrix: np.ndarray, p: np.ndarray, values: np.ndarray) -> list[np.ndarray]:
    """Coefficients and polynomial for basis values between centres and the polynomial terms there."""
    n, q = p.shape
    system = np.block([[matrix, p], [p.T, np.zeros((q, q))]])
    return np.split(np.linalg.solve(system, np.concatenate([values, np.zeros((q, values.shape[1]))])), [n])


def slow_greedy(
    name: str, centres: np.ndarray, values: np.ndarray, scale: np.ndarray, tolerance: float, updates: int
) -> tuple[list[int], np.ndarray, int]:
    """Centres in the order in which rounds of so many updates choose them, for a radius of 1; errors that are left at
    all of them, in units of ``scale`` (n, 1); number of rounds."""
    matrix, terms = basis(name, distances(centres, centres), 1.0), polynomial(centres, (0, 1, 2))
    chosen, error, rounds = list[int](), values, 0
    while not rounds or np.abs(error / scale).max() > tolerance:
        rest = error.copy()
        for _ in range(updates):
            worst = int(np.abs(rest / scale).max(axis=1).argmax()) if chosen else 0
            chosen += [worst] * (worst not in chosen)
            rest -= matrix[:, [worst]] * rest[worst]
        # Four centres or fewer determine no linear polynomial.
        p = terms if len(chosen) > 4 else terms[:, :1]
        coefficients, linear = solution(matrix[np.ix_(chosen, chosen)], p[chosen], values[chosen])
        error, rounds = values - matrix[:, chosen] @ coefficients - p @ linear, rounds + 1
    return chosen, error, rounds


def distances(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.linalg.norm(a[:, None] - b[None], axis=2)
