"""Inverse distance weighting: the exact loop against the machine, fast sums against exact ones, growth with size."""

from __future__ import annotations

import dataclasses
import time
from dataclasses import dataclass

import numpy as np
from cases import Motion, inner_nodes, motion, shortest_edges
from machine import PAIR_OPERATIONS, multiply_adds, roots_and_divisions
from tables import MarkdownTable, Row, best, exponent, timed

from meshdeform_core.grid import FloatArray, IntArray
from meshdeform_core.methods import IDW, Options, make_method
from meshdeform_core.numerics.exact.direct import N_VALUES, weighted_sums
from meshdeform_core.parallel import set_sharing, thread_count

TOLERANCES = (1e-2, 1e-4, 1e-6, 1e-8)
SIZES = {"splitter-plate": (8, 16, 32), "hemisphere": (24, 48, 92)}
QUICK = {"splitter-plate": (8, 16), "hemisphere": (12, 16)}
_FULL_PAIRS = 5e9
# Larger grids with the first two tolerances only: the finer ones take minutes each.
_ALL_TOLERANCES = 3e6
_SAMPLES = 4000


def exact_loop(quick: bool) -> MarkdownTable:
    """Pairs per second of the exact loop on one core against the arithmetic limit, and of numpy."""
    rng = np.random.default_rng(1)
    targets, sources = rng.random((2000 if quick else 8000, 3)), rng.random((20000, 3)) + 2.0
    strength, values = rng.random(len(sources)), rng.random((N_VALUES, len(sources)))
    set_sharing(threads=1)
    try:
        pairs = len(targets) * len(sources)
        ours = pairs / best(lambda: weighted_sums(targets, sources, strength, (3.0, 5.0, 0.01), values))
    finally:
        set_sharing(threads=None)
    few = targets[:400]
    numpy = len(few) * len(sources) / best(lambda: numpy_sums(few, sources, strength, 0.01, values))
    roots, fused = roots_and_divisions(), multiply_adds() / PAIR_OPERATIONS
    together = 1.0 / (1.0 / roots + 1.0 / fused)
    return MarkdownTable(
        "Exact IDW sums: pairs per second",
        [
            {
                "loop": "ours, 1 core, weight and 7 values",
                "1e9 pairs/s": ours / 1e9,
                "share of the limit": ours / roots,
            },
            {"loop": "limit: square root and division alone, 1 core", "1e9 pairs/s": roots / 1e9},
            {"loop": f"limit: the other {PAIR_OPERATIONS} operations alone, 1 core", "1e9 pairs/s": fused / 1e9},
            {"loop": "both after one another, 1 core", "1e9 pairs/s": together / 1e9},
            {"loop": "plain numpy, chunks of targets, all cores", "1e9 pairs/s": numpy / 1e9},
        ],
    )


def numpy_sums(
    targets: FloatArray, sources: FloatArray, strength: FloatArray, kappa: float, values: FloatArray
) -> FloatArray:
    """The same sums as one would write them with numpy, 50 targets at a time: (n, 8)."""
    columns = np.vstack([np.ones(len(sources)), values]).T * strength[:, None]
    sums = np.empty((len(targets), 1 + len(values)))
    for first in range(0, len(targets), 50):
        r2 = ((targets[first : first + 50, None] - sources) ** 2).sum(axis=2)
        weight = r2**-1.5 + kappa * r2**-2.5
        sums[first : first + 50] = weight @ columns
    return sums


@dataclass(frozen=True)
class Exact:
    """Exact IDW of one motion: time of the whole apply, and displacements (n, 3) at some nodes ``flat``."""

    seconds: float
    extrapolated: bool
    flat: IntArray
    displacement: FloatArray


def fast_against_exact(quick: bool) -> MarkdownTable:
    """Whole applies at growing sizes, fast and exact, with the error of fast sums at random nodes."""
    table = MarkdownTable("IDW alone: fast sums against exact ones, whole apply")
    # Loops are compiled, or loaded, at their first use.
    _fast_row(*_compared("splitter-plate", 8), TOLERANCES[0])
    for sample, sizes in (QUICK if quick else SIZES).items():
        of_sample: list[Row] = []
        for size in sizes:
            case, exact = _compared(sample, size)
            tolerances = TOLERANCES if case.setup.grid.n_nodes < _ALL_TOLERANCES else TOLERANCES[:2]
            of_sample += [_fast_row(case, exact, tolerance) for tolerance in tolerances]
        table.rows += of_sample
        table.notes += [_growth(sample, of_sample, tolerance) for tolerance in TOLERANCES]
    table.notes.append(
        f"exact times marked ~ are extrapolated from {_SAMPLES:,} random nodes; errors are against exact sums at "
        f"{_SAMPLES:,} random nodes, in units of the shortest cell edge at each"
    )
    return table


def _compared(sample: str, size: int) -> tuple[Motion, Exact]:
    case = motion(sample, size)
    return case, _exact(case)


def _exact(case: Motion) -> Exact:
    problem, targets = case.problem, inner_nodes(case.problem)
    some = np.sort(np.random.default_rng(0).permutation(targets)[:_SAMPLES])
    idw = IDW(summation="exact").bind(problem, some)
    out = np.empty((problem.grid.n_nodes, 3))
    fit_seconds, fit = timed(lambda: idw.fit(case.displacement))
    idw.evaluate(fit, out)
    # Runs take some tenths of a second: a single one could be off by a quarter.
    seconds = best(lambda: idw.evaluate(fit, out))
    sampled = out[some]
    if len(targets) * len(case.displacement) > _FULL_PAIRS:
        return Exact(fit_seconds + seconds * len(targets) / len(some), True, some, sampled)
    prepared = make_method(Options("idw", idw=IDW(summation="exact"))).prepare(problem)
    return Exact(timed(lambda: prepared.apply(case.displacement))[0], False, some, sampled)


def _fast_row(case: Motion, exact: Exact, tolerance: float) -> Row:
    method = make_method(Options("idw", idw=IDW(summation="fast", summation_tolerance=tolerance)))
    prepare, prepared = timed(lambda: method.prepare(case.problem))
    apply, out = timed(lambda: prepared.apply(case.displacement))
    if apply < 5.0:
        apply = min(apply, timed(lambda: prepared.apply(case.displacement))[0])
    error = np.linalg.norm(out[exact.flat] - exact.displacement, axis=1)
    error /= shortest_edges(case.setup.grid, exact.flat)
    return {
        "case": case.label,
        "nodes": case.setup.grid.n_nodes,
        "sources": len(case.displacement),
        "tolerance": tolerance,
        "set-up s": prepare,
        "apply s": apply,
        "exact s": f"{'~' * exact.extrapolated}{exact.seconds:.3g}",
        "ratio": exact.seconds / apply,
        "largest error, cells": float(error.max()),
        "rms error, cells": float(np.sqrt((error**2).mean())),
    }


def _growth(sample: str, rows: list[Row], tolerance: float) -> str:
    chosen = [row for row in rows if row["tolerance"] == tolerance]
    sizes = [row["nodes"] for row in chosen]
    apply = exponent(sizes, [row["apply s"] for row in chosen])
    exact = exponent(sizes, [float(row["exact s"].lstrip("~")) for row in chosen])
    return f"{sample}, tolerance {tolerance:g}: fast apply grows as N^{apply:.2f}, exact as N^{exact:.2f}"


def processor_time(quick: bool) -> MarkdownTable:
    """CPU seconds of the splitter plate by IDW: topology, set-up and deformation."""
    size = 8 if quick else 32
    motion.cache_clear()
    start = time.process_time()
    case = motion("splitter-plate", size)
    read = time.process_time()
    prepared = make_method(Options("idw")).prepare(case.problem)
    ready = time.process_time()
    prepared.apply(case.displacement)
    done = time.process_time()
    row = {
        "case": case.label, "nodes": case.setup.grid.n_nodes, "sources": len(case.displacement),
        "make grid and topology": read - start, "set-up": ready - read, "deformation": done - ready,
        "set-up + deformation": done - ready + ready - read,
    }  # fmt: skip
    return MarkdownTable("Splitter plate by IDW: CPU seconds, all threads together", [row])


def threads(quick: bool) -> MarkdownTable:
    """The same work with one thread and with all."""
    case = motion("splitter-plate", 16)
    some = inner_nodes(case.problem)[:: 50 if quick else 5]
    exact = IDW(summation="exact").bind(case.problem, some)
    fit, out = exact.fit(case.displacement), np.empty((case.setup.grid.n_nodes, 3))
    works = {"IDW, exact sums": lambda: exact.evaluate(fit, out)}
    for name, options in {
        "IDW, fast sums, apply": Options("idw", idw=dataclasses.replace(IDW(), summation="fast")),
        "IDW-TFI, apply": Options("idw-tfi"),
        "TFI, apply": Options("tfi"),
    }.items():
        prepared = make_method(options).prepare(case.problem)
        works[name] = lambda prepared=prepared: prepared.apply(case.displacement)
    rows = []
    for name, work in works.items():
        work()
        set_sharing(threads=1)
        try:
            one = best(work, 2)
        finally:
            set_sharing(threads=None)
        rows.append({"work": name, "1 thread s": one, "all threads s": best(work, 2)})
        rows[-1]["ratio"] = rows[-1]["1 thread s"] / rows[-1]["all threads s"]
    return MarkdownTable(f"One thread against {thread_count()} ({case.label})", rows)
