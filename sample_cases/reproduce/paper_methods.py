"""What only the paper's tables need: MINRES for RBF, IDW that finds new weights in every division, and operations.

Floating-point operations of the methods are counted from their loops. Every addition, multiplication, division and root
counts as one, as in hardware counters; integer arithmetic, comparisons and memory traffic are not counted. There is one
formula per family of methods; results of the run (iterations, chosen centres) come from the method's account.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from meshdeform_core.grid import FloatArray, IntArray
from meshdeform_core.methods import IDW, RBF
from meshdeform_core.methods.base import Account, Problem, Progress, Setting, of_stage
from meshdeform_core.methods.composite import Composite, first_step_nodes
from meshdeform_core.methods.scattered.block_rbf import BlockRBF
from meshdeform_core.methods.scattered.idw import PreparedIDW
from meshdeform_core.methods.scattered.idw_sums import SourceValues
from meshdeform_core.methods.scattered.prepared_rbf import PreparedRBF
from meshdeform_core.methods.transfinite.tfi import TFI
from meshdeform_core.numerics.exact.basis import BASES
from meshdeform_core.numerics.exact.direct import N_VALUES, weighted_sums
from meshdeform_core.numerics.exact.radial import radial_matrix
from meshdeform_core.numerics.rigid import WIDTHS, finish
from meshdeform_core.numerics.rotation import rotate

_LOG = 29
_DISTANCE = 8
_BASIS = {
    "tps": 2 + _LOG, "wendland-c0": 3, "wendland-c2": 7,
    "ctps-c1": 12 + _LOG, "ctps-c2a": 13 + _LOG, "ctps-c2b": 13 + _LOG,
}  # fmt: skip
_COMPONENTS = 3
_TFI_BLOCK, _TFI_PLANE = 57 * _COMPONENTS + 3, 15 * _COMPONENTS + 2
_ARC = 11
_LUKE_PAIR = 15
_FINISH = 40
Multiply = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True)
class ReweightedIDW(IDW):
    """IDW with ``rotation = "division"`` and weights of the moved sources and nodes in every step (eqs. 26-28)."""

    def bind(self, problem: Problem, flat: IntArray) -> PreparedReweighted:
        """Bind to the sources and the target nodes ``flat``; all sums are exact."""
        return PreparedReweighted(dataclasses.replace(self, summation="exact"), problem, flat)


class PreparedReweighted(PreparedIDW):
    """:class:`ReweightedIDW` bound to one undeformed grid: exact sums with new weights in each of the divisions."""

    def evaluate(self, fit: SourceValues, out: FloatArray, progress: Progress | None = None) -> None:
        """Write the displacement of the target nodes into their rows of ``out`` (n_nodes, 3)."""
        points = self.problem.grid.points[self.flat]
        x, sources = points - fit.origin, self.images.points - fit.origin
        part, translation = fit.values[:4].T.copy(), fit.values[4:].T
        for _ in range(self.options.divisions):
            sums = np.zeros((len(x), 1 + len(fit.values)))
            for group, weights in zip(self.groups, fit.weights, strict=True):
                sums += weighted_sums(x, sources[group], self.strength[group], weights, fit.values[:, group])
            x += finish("division", sums.T, x)
            sources = rotate(part, sources) + translation
        out[self.flat] = fit.frame.absolute(points, x - (points - fit.origin))


@dataclass(frozen=True)
class MinresRBF(RBF):
    """RBF whose system is solved as in the paper: MINRES without a preconditioner, to ``tolerance``."""

    def bind(self, problem: Problem, flat: IntArray) -> PreparedRBF:
        """Bind to the sources and the target nodes ``flat``; the matrix is made when it is first needed."""
        prepared = PreparedRBF(self, problem, flat)
        prepared.system = MinresSystem(self, prepared)  # type: ignore[assignment]
        return prepared


class MinresSystem:
    """The interpolation system with the matrix as a whole; takes the place of ``RadialSystem``."""

    def __init__(self, options: MinresRBF, prepared: PreparedRBF) -> None:
        self._options, self._points = options, prepared.centres.points
        self._terms = prepared.centres.polynomial(self._points)

    def solve(self, values: FloatArray, account: Account, progress: Progress | None) -> tuple[FloatArray, FloatArray]:
        """Coefficients (n, 3) and polynomial (q, 3) for values at the centres (n, 3)."""
        terms, n = self._terms, len(values)
        matrix = radial_matrix(BASES[self._options.basis], self._points, self._points)

        def multiply(x: FloatArray) -> FloatArray:
            return np.concatenate([matrix @ x[:n] + terms @ x[n:], terms.T @ x[:n]])

        right = np.concatenate([values, np.zeros((terms.shape[1], values.shape[1]))])
        limit, tolerance = self._options.max_iterations, float(self._options.tolerance)
        solution, iterations, residual = minres(multiply, right, tolerance, limit, of_stage(progress, "minres"))
        account.settings |= {
            "solver": Setting("minres"), "tolerance": Setting(tolerance),
            "iterations": Setting(iterations.tolist(), "one number per component"),
            "residual": Setting(residual.tolist(), "||b - K x|| / ||b||, computed from the solution"),
        }  # fmt: skip
        failed = f"MINRES stopped after {iterations.max()} iterations with a residual of {residual.max():.2e}"
        account.note("solver", failed if residual.max() > tolerance else None)
        return solution[:n], solution[n:]


def minres(
    multiply: Multiply, rhs: FloatArray, tolerance: float, most: int, report: Callable[[int, int], None] | None
) -> tuple[FloatArray, IntArray, FloatArray]:
    """Minimum residual method for a symmetric operator, all right-hand sides side by side (Paige & Saunders 1975).

    Stops when ||r|| <= tolerance ||b|| for every column of ``rhs`` (n, m), with the residual norm of the recurrence,
    which is the criterion of the paper (scipy's stops at residuals 10 to 1000 times larger).

    Returns
    -------
    solution : (n, m)
    iterations : (m,) int64 until each column met the tolerance
    residual : (m,) ||b - K x|| / ||b||, computed from the solution
    """
    norm = np.linalg.norm(rhs, axis=0)
    live = norm > 0
    right, size = rhs[:, live], norm[live]
    x, v, v_old, w, w_old = np.zeros_like(right), right / size, *np.zeros((3, *right.shape))
    beta, s, s_old, c, c_old = np.zeros_like(size), *np.zeros((2, len(size))), *np.ones((2, len(size)))
    eta, rest, steps = size.copy(), size.copy(), np.zeros(len(size), dtype=np.int64)
    for count in range(1, most + 1):
        open_ = rest > tolerance * size
        if not open_.any():
            break
        steps[open_] = count
        p = multiply(v)
        alpha = np.einsum("nm,nm->m", v, p)
        p -= alpha * v + beta * v_old
        after = np.linalg.norm(p, axis=0)
        # Givens rotations on the new column of the tridiagonal matrix.
        rho0 = c * alpha - c_old * s * beta
        rho1, rho2, rho3 = np.hypot(rho0, after), s * alpha + c_old * c * beta, s_old * beta
        safe = np.where(rho1 > 0, rho1, 1.0)
        c_old, s_old, c, s = c, s, rho0 / safe, after / safe
        w_old, w = w, (v - rho3 * w_old - rho2 * w) / safe
        # Columns that have converged stay as they are.
        x += np.where(open_, c * eta, 0.0) * w
        rest = np.where(open_, np.abs(s) * rest, rest)
        eta, beta, v_old, v = -s * eta, after, v, p / np.where(after > 0, after, 1.0)
        if report and count % 20 == 0:
            report(count, most)
    solution, iterations, residual = np.zeros_like(rhs), np.zeros(len(norm), dtype=np.int64), np.zeros(len(norm))
    solution[:, live], iterations[live] = x, steps
    residual[live] = np.linalg.norm(right - multiply(x), axis=0) / size
    return solution, iterations, residual


def count_operations(method: Composite, problem: Problem, account: Account) -> float:
    """Operations of ``prepare`` and one ``apply``, after which the account is ``account``."""
    skeleton = method.filler.skeleton(problem) if method.filler else None
    targets, mover = len(first_step_nodes(problem, skeleton)), method.mover
    total, found = 0.0, {name: setting.value for name, setting in account.settings.items()}
    if isinstance(mover, IDW):
        total += idw_operations(mover, targets, len(problem.source_numbers))
    elif isinstance(mover, RBF):
        total += rbf_operations(mover, targets, len(problem.source_numbers), found)
    if isinstance(method.filler, TFI):
        total += tfi_operations(problem.grid.n_nodes, problem.grid.dimension)
    elif isinstance(method.filler, BlockRBF) and skeleton is not None:
        # One direct system per block in its face nodes.
        basis = _BASIS[method.filler.options.basis]
        for centres, inside in method.filler.prepare(problem, skeleton).sizes:
            total += _direct(float(centres), basis) + inside * centres * (_DISTANCE + basis + 2 * _COMPONENTS)
    return total


def tfi_operations(nodes: int, dimension: int) -> float:
    """Arc lengths (eq. 10) and blending (eqs. 1-9; in 2-D eq. 2) of every node."""
    return float(nodes) * (dimension * _ARC + (_TFI_BLOCK if dimension == 3 else _TFI_PLANE))


def idw_operations(idw: IDW, targets: int, sources: int) -> float:
    """Weight (eq. 16) and accumulation of seven values per pair and pass; one pass per evaluation of the weights."""
    passes = -(-WIDTHS[idw.rotation] // N_VALUES)
    per_pair = passes * (_LUKE_PAIR + 2 * (1 + N_VALUES))
    return float(targets) * (
        (idw.divisions if isinstance(idw, ReweightedIDW) else 1) * (per_pair * float(sources)) + _FINISH
    )


def rbf_operations(rbf: RBF, targets: int, sources: int, found: Mapping[str, object]) -> float:
    """The system (eq. 12) by Cholesky, MINRES or greedy reduction, and the sum (eq. 11) over the centres kept."""
    n, basis = float(sources), _BASIS[rbf.basis]
    if rbf.greedy != "none":
        centres = float(str(found["greedy_points"]))
        updates, rounds = float(str(found["greedy_updates_done"])), float(str(found["greedy_rounds"]))
        # Each update searches the largest error and takes a column away; every round solves for at most all chosen.
        system = updates * n * (_DISTANCE + basis + 4 * _COMPONENTS)
        system += rounds * (_direct(centres, basis) + n * centres * (_DISTANCE + basis + 2 * _COMPONENTS))
    elif isinstance(rbf, MinresRBF):
        centres = n
        iterations = found["iterations"]
        assert isinstance(iterations, list)
        # A matrix-vector product and the recurrences' twelve vector operations, for each component by itself.
        system = n * n * (_DISTANCE + basis) + sum(iterations) * (2 * n * n + 24 * n)
    else:
        centres, system = n, _direct(n, basis)
    return system + targets * centres * (_DISTANCE + basis + 2 * _COMPONENTS)


def _direct(n: float, basis: int) -> float:
    """Matrix, Cholesky factor, the projection beside four polynomial terms, and one refinement of the solution."""
    refinement = 2 * n * n * (_DISTANCE + basis + 2 * _COMPONENTS)
    return n * n * (_DISTANCE + basis) + n**3 / 3 + 16 * n * n + 8 * n * n * _COMPONENTS + refinement
