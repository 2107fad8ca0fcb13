"""Floating-point operations of the methods, counted from their loops: additions, multiplications, divisions, roots.

Every operation counts as one, as in hardware counters; integer arithmetic, comparisons and memory traffic are not
counted. There is one formula per family of methods; results of the run (iterations, chosen centres) come from the
method's account.
"""

from __future__ import annotations

from collections.abc import Mapping

from meshdeform_core.methods.base import Account, Problem
from meshdeform_core.methods.composite import Composite, first_step_nodes
from meshdeform_core.methods.scattered.block_rbf import BlockRBF
from meshdeform_core.methods.scattered.idw import IDW
from meshdeform_core.methods.scattered.rbf import RBF
from meshdeform_core.methods.transfinite.tfi import TFI, Skeleton
from meshdeform_core.numerics.exact.direct import N_VALUES
from meshdeform_core.numerics.rigid import WIDTHS

from .paper_methods import MinresRBF, ReweightedIDW

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


def count_operations(method: Composite, problem: Problem, account: Account) -> float:
    """Operations of ``prepare`` and one ``apply``, after which the account is ``account``."""
    skeleton = method.filler.skeleton(problem) if method.filler else None
    targets = len(first_step_nodes(problem, skeleton))
    total, found = 0.0, {name: setting.value for name, setting in account.settings.items()}
    if isinstance(method.mover, IDW):
        total += idw_operations(method.mover, targets, len(problem.source_numbers))
    elif isinstance(method.mover, RBF):
        total += rbf_operations(method.mover, targets, len(problem.source_numbers), found)
    if isinstance(method.filler, TFI):
        total += tfi_operations(problem.grid.n_nodes, problem.grid.dimension)
    elif isinstance(method.filler, BlockRBF) and skeleton is not None:
        total += block_rbf_operations(method.filler, problem, skeleton)
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
    """Matrix, Cholesky factor, four Householder reflections, and one refinement of the solution."""
    refinement = 2 * n * n * (_DISTANCE + basis + 2 * _COMPONENTS)
    return n * n * (_DISTANCE + basis) + n**3 / 3 + 16 * n * n + 8 * n * n * _COMPONENTS + refinement


def block_rbf_operations(filler: BlockRBF, problem: Problem, skeleton: Skeleton) -> float:
    """One direct system per block in its face nodes."""
    total = 0.0
    for centres, targets in filler.prepare(problem, skeleton).sizes:
        pairs = targets * centres * (_DISTANCE + _BASIS[filler.options.basis] + 2 * _COMPONENTS)
        total += _direct(float(centres), _BASIS[filler.options.basis]) + pairs
    return total
