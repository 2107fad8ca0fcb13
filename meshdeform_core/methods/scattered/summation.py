"""Choice between exact and fast sums and of the solver, and the check of fast sums, for all scattered-data methods."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

import numpy as np

from ...grid import FloatArray, Grid, IntArray
from ...parallel import Nodes
from ..base import Account, Setting
from ..options import option

_FAST_PAIRS, _FAST_SOURCES = 2e8, 2000
"""Pairs of nodes and sources, and sources, from which fast sums are faster than exact ones (``benchmarks/idw.py``)."""
DIRECT_CENTRES = 4000
"""Of RBF, the largest number of centres that ``auto`` solves directly; beyond it, GMRES with its set-up is faster
(``benchmarks/rbf.py``)."""
_WORST_BRICKS, _RANDOM_NODES = 64, 256
"""Bricks with the largest error bounds, and random nodes, at which fast sums are compared with exact ones."""
MAX_RETRIES = 3
"""Largest number of times that fast sums are repeated with higher accuracy."""

DERIVATIVE_TOLERANCE = 1e-5
"""Error of fast sums in derivatives, relative to the largest change of a value."""

Summation = Literal["auto", "exact", "fast"]


def summation_tolerance() -> Any:
    """The field ``summation_tolerance`` of a method's options."""
    return option(
        1e-2,
        "of the local cell: too small to affect any quality measure",
        range="[1e-8, 0.1]",
        only_if={"summation": ("auto", "fast")},
    )


def fast_pays(summation: str, n_targets: int, n_sources: int) -> tuple[bool, Setting]:
    """Whether to sum fast, and the setting to report; at the limit of 2e8 pairs exact sums take about 0.2 s."""
    pairs = n_targets * n_sources
    pays = pairs > _FAST_PAIRS and n_sources > _FAST_SOURCES
    fast = pairs > 0 and (summation == "fast" or (summation == "auto" and pays))
    reason = f"{n_targets:,} nodes with {n_sources:,} sources" if summation == "auto" else ""
    return fast, Setting("fast" if fast else "exact", reason)


def sum_accurately(method: str, once: Callable[[float], float], tolerance: float, account: Account) -> None:
    """Call ``once``, which computes the sums and returns their error, until the error is within the tolerance.

    Every displacement starts with the same accuracy, ``once(0)``, whatever earlier ones needed; ``once(excess)``
    increases it, as the error was ``excess`` times too large. The error (in cells) is reported, with a warning if it
    remains too large.
    """
    error, excess = np.inf, 0.0
    for _ in range(1 + MAX_RETRIES):
        error = once(excess)
        if error <= tolerance or not np.isfinite(error):
            break
        # Rarely needed: when the errors of several clusters add up.
        excess = error / tolerance
    account.settings["sampled_error"] = Setting(error, "against exact sums at the worst nodes, in cells")
    failed = (
        f"fast sums: found an error of {error:.2g} of a cell, {tolerance:g} is allowed; "
        f'use method.{method}.summation = "exact"'
    )
    account.note("summation", None if error <= tolerance else failed)


def largest_error(
    grid: Grid, targets: Any, risk: FloatArray, found: FloatArray, exact: Callable[[IntArray], FloatArray]
) -> float:
    """Largest error in cells of the displacement ``found`` (n_nodes, 3).

    Searched at samples of the bricks with the largest bounds ``risk`` (b,) and at random nodes; ``exact`` computes the
    displacement (n, 3) of given nodes by exact sums.
    """
    from ...numerics.fastsum.targets import node_sizes, shape_table

    flat, error = doubtful(grid.points, targets, risk), np.zeros(0)
    if flat.size:
        size = node_sizes(grid.nodes.rows, shape_table(grid.shapes), grid.offsets, flat)
        error = np.linalg.norm(Nodes.of(found).at(flat) - exact(flat), axis=1) / size
    return grid.nodes.ranks.largest(error.max(initial=0.0))


def doubtful(points: FloatArray, targets: Any, risk: FloatArray) -> IntArray:
    """Flat indices of ``targets.samples`` (b, 9) of the bricks with the largest bounds ``risk`` (b,), and of random
    nodes among ``targets.every`` (n,).

    If ``points`` are in parts, the bricks of all ranks compete; returns those nodes that are targets of this rank.
    """
    others = Nodes.of(points).gather((risk, len(targets.every)))
    bricks, nodes = (np.cumsum([0, *sizes]) for sizes in zip(*((len(one), many) for one, many in others), strict=True))
    number = Nodes.of(points).ranks.number
    worst = np.argsort(np.concatenate([one for one, _ in others]))[-_WORST_BRICKS:]
    some = np.random.default_rng(0).integers(0, nodes[-1], _RANDOM_NODES)
    worst, some = (
        numbers[(numbers >= first[number]) & (numbers < first[number + 1])] - first[number]
        for numbers, first in ((worst, bricks), (some, nodes))
    )
    return np.concatenate([np.asarray(targets.samples[worst]).ravel(), np.asarray(targets.every[some])])
