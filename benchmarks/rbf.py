"""Radial basis functions against scipy's RBFInterpolator, and fast evaluation against exact."""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
from cases import Motion, inner_nodes, motion, shortest_edges
from scipy.interpolate import RBFInterpolator
from tables import MarkdownTable, Row, timed

from meshdeform_core.grid import FloatArray
from meshdeform_core.methods import RBF
from meshdeform_core.numerics.basis import BASES
from meshdeform_core.numerics.radial import radial_sums

_NEIGHBOURS = 50
_EPSILON = np.finfo(np.float64).eps


def against_scipy(quick: bool) -> MarkdownTable:
    """Thin plate spline of all boundary nodes, evaluated at all others; set-up included."""
    table = MarkdownTable(
        "RBF (thin plate spline): set-up and evaluation",
        notes=[
            "difference: largest distance from our exact sums, in units of the shortest cell edge",
            f"neighbors={_NEIGHBOURS} is another interpolation, not continuous: one small system per node",
        ],
    )
    for solve in list(_solvers(motion("splitter-plate", 8), neighbours=False).values())[:2]:
        # Loops are compiled, or loaded, at their first use.
        solve()()
    for size in (8,) if quick else (8, 16):
        table.rows += _rows(motion("splitter-plate", size), neighbours=not quick)
    return table


def _rows(case: Motion, neighbours: bool) -> list[Row]:
    targets = inner_nodes(case.problem)
    size = shortest_edges(case.setup.grid, targets)
    reference: FloatArray | None = None
    rows = []
    for name, solve in _solvers(case, neighbours).items():
        set_up, evaluate = timed(solve)
        try:
            seconds, values = timed(evaluate)
        except np.linalg.LinAlgError:
            # Neighbours in one plane, as on any wall, leave scipy's linear polynomial undetermined.
            rows.append({"case": case.label, "program": f"{name}: singular matrix"})
            continue
        values = values[targets] if len(values) == case.setup.grid.n_nodes else values
        reference = values if reference is None else reference
        difference = float((np.linalg.norm(values - reference, axis=1) / size).max())
        rows.append(
            {
                "case": case.label,
                "nodes": len(targets),
                "centres": len(case.displacement),
                "program": name,
                "set-up s": set_up,
                "evaluation s": seconds,
                "total s": set_up + seconds,
                "difference": difference,
            }
        )
    for row in rows:
        if "total s" in row:
            row["total / ours fast"] = row["total s"] / rows[1]["total s"]
    return rows


def _solvers(case: Motion, neighbours: bool) -> dict[str, Callable[[], Callable[[], FloatArray]]]:
    """For every program: what sets it up and gives what evaluates it."""
    problem, d = case.problem, case.displacement
    targets = problem.grid.points[inner_nodes(problem)]

    def ours(summation: str) -> Callable[[], Callable[[], FloatArray]]:
        def solve() -> Callable[[], FloatArray]:
            # The first apply solves the system, so it belongs to the set-up: bind, solve, then sum.
            bound = RBF(summation=summation).bind(problem)
            fit = bound.fit(d)
            evaluator = bound.at(inner_nodes(problem))
            out = np.empty((problem.grid.n_nodes, 3))
            return lambda: (evaluator.evaluate(fit, out, None), out)[1]

        return solve

    def scipys(**options: int) -> Callable[[], Callable[[], FloatArray]]:
        def solve() -> Callable[[], FloatArray]:
            spline = RBFInterpolator(problem.source_points, d, kernel="thin_plate_spline", degree=1, **options)
            return lambda: spline(targets)

        return solve

    solvers = {"ours, exact sums": ours("exact"), "ours, fast sums": ours("fast"), "scipy, global": scipys()}
    return solvers | ({f"scipy, neighbors={_NEIGHBOURS}": scipys(neighbors=_NEIGHBOURS)} if neighbours else {})


def large_systems(quick: bool) -> MarkdownTable:
    """Thin plate spline on the hemisphere's boundary nodes by preconditioned GMRES, and fast sums at all others."""
    table = MarkdownTable(
        "RBF (thin plate spline): large systems",
        notes=["residual: largest of the three components, relative to the right-hand side"],
    )
    for size in (16, 24) if quick else (24, 48, 92):
        case = motion("hemisphere", size)
        bound = RBF(solver="krylov").bind(case.problem)
        evaluator = bound.at(inner_nodes(case.problem))
        solving, fit = timed(functools.partial(bound.fit, case.displacement))
        # The preconditioner is kept; on the largest grid it is a small part anyway.
        again = timed(functools.partial(bound.fit, case.displacement))[0] if solving < 60.0 else None
        out = np.empty((case.problem.grid.n_nodes, 3))
        evaluating, _ = timed(functools.partial(evaluator.evaluate, fit, out, None))
        settings = bound.account.settings
        table.rows.append(
            {
                "case": case.label,
                "nodes": len(inner_nodes(case.problem)),
                "centres": len(case.displacement),
                "set-up and solution s": solving,
                "next solution s": again,
                "iterations": settings["iterations"].value,
                "residual": max(settings["residual"].value),
                "evaluation s": evaluating,
            }
        )
    return table


def compact_bases(quick: bool) -> MarkdownTable:
    """The same systems with compact bases, whose conditioning depends on the radius."""
    table = MarkdownTable(
        "RBF (compact bases): large systems",
        notes=[
            "radius: in lengths of the grid, whose body has a radius of 0.5 and whose diagonal is 4.5",
            "round-off: 2.2e-16 |A| |c| / |b|, what the residual of a solution c cannot fall below in double precision",
        ],
    )
    for size in (12,) if quick else (24, 48):
        case = motion("hemisphere", size)
        for basis, radius in (("wendland-c0", 4.5), ("wendland-c2", 2.0), ("wendland-c2", 4.5), ("ctps-c1", 4.5)):
            bound = RBF(basis=basis, radius=radius, solver="krylov").bind(case.problem)
            seconds, fit = timed(functools.partial(bound.fit, case.displacement))
            some = fit.centres[:: 1 + len(fit.centres) // 500]
            largest = radial_sums(BASES[basis], some, fit.centres, np.abs(fit.coefficients))
            settings = bound.account.settings
            table.rows.append(
                {
                    "case": case.label,
                    "centres": len(case.displacement),
                    "basis": basis,
                    "radius": radius,
                    "set-up and solution s": seconds,
                    "iterations": settings["iterations"].value,
                    "residual": max(settings["residual"].value),
                    "round-off": float((_EPSILON * _rms(largest) / _rms(case.displacement)).max()),
                }
            )
    return table


def _rms(values: FloatArray) -> FloatArray:
    """Root of the mean square of each column."""
    return np.asarray(np.sqrt((values**2).mean(axis=0)))
