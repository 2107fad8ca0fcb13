"""Radial basis functions against scipy's RBFInterpolator, and fast evaluation against exact."""

from __future__ import annotations

import functools
import importlib.util
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from cases import Motion, inner_nodes, motion, shortest_edges
from scipy.interpolate import RBFInterpolator
from sources import hemisphere_sources
from tables import MarkdownTable, Row, exponent, timed

from meshdeform_core.grid import FloatArray
from meshdeform_core.methods import RBF, Account
from meshdeform_core.methods.scattered.prepared_rbf import Centres, Coefficients, RadialSystem
from meshdeform_core.numerics.exact.basis import BASES
from meshdeform_core.numerics.exact.radial import radial_sums

_NEIGHBOURS = 50
# Largest hemispheres: for which the grid is made, and on which the other program is run.
_LARGEST_GRID, _LARGEST_PEER = 92, 24
_PEER = importlib.util.find_spec("ferreus_rbf") is not None
_PEER_NOTE = (
    "ferreus-rbf: its own accuracy setting of 1e-6, the same nodes and values"
    if _PEER
    else "ferreus-rbf was not measured: it is not installed here (`pip install ferreus-rbf`)"
)
_EPSILON = np.finfo(np.float64).eps


def against_scipy(quick: bool) -> MarkdownTable:
    """Thin plate spline of all boundary nodes, evaluated at all others; set-up included."""
    table = MarkdownTable(
        "RBF (thin plate spline): set-up and evaluation",
        notes=[
            "difference: largest distance from our exact sums, in units of the shortest cell edge",
            _PEER_NOTE,
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
    """For every program, a function that sets it up and returns the function that evaluates it."""
    problem, d = case.problem, case.displacement
    targets = problem.grid.points[inner_nodes(problem)]

    def ours(summation: str) -> Callable[[], Callable[[], FloatArray]]:
        def solve() -> Callable[[], FloatArray]:
            # The first apply solves the system, so it belongs to the set-up: bind, solve, then sum.
            bound = RBF(summation=summation).bind(problem, inner_nodes(problem))
            fit = bound.fit(d)
            out = np.empty((problem.grid.n_nodes, 3))
            return lambda: (bound.evaluate(fit, out), out)[1]

        return solve

    def scipys(**options: int) -> Callable[[], Callable[[], FloatArray]]:
        def solve() -> Callable[[], FloatArray]:
            spline = RBFInterpolator(problem.source_points, d, kernel="thin_plate_spline", degree=1, **options)
            return lambda: spline(targets)

        return solve

    def ferreus() -> Callable[[], FloatArray]:
        spline = _peer_spline(problem.source_points, d)
        return lambda: np.asarray(spline.evaluate(targets))

    solvers = {"ours, exact sums": ours("exact"), "ours, fast sums": ours("fast"), "scipy, global": scipys()}
    if _PEER:
        solvers["ferreus-rbf"] = ferreus
    return solvers | ({f"scipy, neighbors={_NEIGHBOURS}": scipys(neighbors=_NEIGHBOURS)} if neighbours else {})


def large_systems(quick: bool) -> MarkdownTable:
    """Thin plate spline on the hemisphere's boundary nodes: systems by GMRES, sums at all other nodes."""
    table = MarkdownTable(
        "RBF (thin plate spline): large systems, CPU seconds of all threads",
        notes=[
            "next solution: of another displacement, whose components are not combinations of the first one's",
            "residual: of the first solution, largest of the components, relative to the right-hand side, with the "
            "errors of the products",
            _PEER_NOTE,
        ],
    )
    # Loops are compiled, or loaded, at their first use.
    _solve(*hemisphere_sources(16))
    sizes = (16, 24) if quick else (24, 48, 92, 184)
    for size in sizes:
        points, told = hemisphere_sources(size)
        row, _, _ = _solve(points, told, size <= _LARGEST_GRID)
        nodes, seconds = _evaluation(size) if size <= _LARGEST_GRID else ("", "")
        table.rows.append(
            {"case": f"hemisphere {size}", "program": "ours", **row, "nodes": nodes, "evaluation": seconds}
        )
    ours = [(row["centres"], row["set-up and solution"]) for row in table.rows]
    table.rows += [_peer(size) for size in sizes if _PEER and size <= _LARGEST_PEER]
    table.notes.append(f"ours: set-up and solution grow as n^{exponent(*zip(*ours, strict=True)):.2f}")
    return table


def _solve(points: FloatArray, told: FloatArray, again: bool = True) -> tuple[Row, RadialSystem, Coefficients]:
    """Set up and solve a system, then perhaps solve it for another displacement."""
    start = time.process_time()
    centres, account = Centres.of(points, None), Account()
    system = RadialSystem(RBF(solver="krylov"), centres)
    fit = Coefficients(centres.points, *system.solve(told, account, None))
    first = time.process_time()
    if again:
        system.solve(told * np.cos(30 * centres.points) + np.sin(20 * centres.points[:, ::-1]), Account(), None)
    found = {name: setting.value for name, setting in account.settings.items()}
    row = {
        "centres": len(points),
        "set-up and solution": first - start,
        "next solution": time.process_time() - first if again else "",
        "iterations": found["iterations"],
        "residual": max(found["residual"]),
    }
    return row, system, fit


def _evaluation(size: int) -> tuple[int, float]:
    """Number of inner nodes of the sample's grid, and CPU seconds of summing there for the first time."""
    case = motion("hemisphere", size)
    targets = inner_nodes(case.problem)
    bound = RBF(solver="krylov").bind(case.problem, targets)
    fit, out = bound.fit(case.displacement), np.empty((case.problem.grid.n_nodes, 3))
    start = time.process_time()
    bound.evaluate(fit, out)
    return len(targets), time.process_time() - start


def _peer(size: int) -> Row:
    """The same by ferreus-rbf."""
    points, told = hemisphere_sources(size)
    start = time.process_time()
    spline = _peer_spline(points, told)
    fitted = time.process_time()
    case = motion("hemisphere", size)
    targets = inner_nodes(case.problem)
    spline.evaluate(case.setup.grid.points[targets])
    return {
        "case": f"hemisphere {size}",
        "program": "ferreus-rbf",
        "centres": len(points),
        "set-up and solution": fitted - start,
        "nodes": len(targets),
        "evaluation": time.process_time() - fitted,
    }


def _peer_spline(points: FloatArray, told: FloatArray) -> Any:
    """The interpolant of ferreus-rbf, a fast multipole package in Rust, to its own accuracy of 1e-6."""
    import ferreus_rbf
    from ferreus_rbf import interpolant_config as config

    accuracy = config.FittingAccuracy(1e-6, config.FittingAccuracyType.Relative)
    kernel = config.RBFKernelType.ThinPlateSpline
    settings = config.InterpolantSettings(kernel, drift=config.Drift.Linear, fitting_accuracy=accuracy)
    return ferreus_rbf.RBFInterpolator(points, told, settings)


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
            bound = RBF(basis=basis, radius=radius, solver="krylov").bind(case.problem, inner_nodes(case.problem))
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
