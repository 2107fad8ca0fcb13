"""Derivatives in applications of the method, and beside a dense implementation in JAX."""

from __future__ import annotations

import importlib.util
import time
from collections.abc import Callable

import numpy as np
from cases import Motion, inner_nodes, motion
from tables import MarkdownTable, Row, exponent

from meshdeform_core.grid import FloatArray
from meshdeform_core.methods import Options, make_method

CASES = {"splitter-plate": (16, 32), "hemisphere": (24, 48, 92)}
QUICK = {"splitter-plate": (8,), "hemisphere": (16,)}
METHODS = ("tfi", "idw", "idw-tfi", "rbf-tfi")
# Nodes up to which systems of radial basis functions are solved here.
_RADIAL = 100_000
_JAX = importlib.util.find_spec("jax") is not None
_JAX_SIZES = (8, 12, 16)
_ENOUGH = 2.0


def in_applications(quick: bool) -> MarkdownTable:
    """``linearise``, ``jvp`` and ``vjp`` against an application at the same displacement."""
    table = MarkdownTable(
        "Derivatives in applications of the method",
        notes=[
            "CPU time; an application, `apply`, is of a prepared method that has met this displacement before",
            "directions: random at every moving node, random at every node of the grid",
            "transpose: difference of the two products over the norms of both vectors",
        ],
    )
    for sample, sizes in (QUICK if quick else CASES).items():
        rows = [row for size in sizes for row in _rows(motion(sample, size))]
        table.rows += rows
        table.notes += _exponents(sample, rows)
    return table


def _rows(case: Motion) -> list[Row]:
    names = METHODS if case.setup.grid.n_nodes <= _RADIAL else METHODS[:-1]
    return [_row(case, name) for name in names]


def _row(case: Motion, name: str) -> Row:
    method, at = make_method(Options(name)).prepare(case.problem), case.displacement
    method.apply(at)
    one = _cpu(lambda: method.apply(at))
    begin = time.process_time()
    derivative = method.linearised(at)
    linearise = time.process_time() - begin
    random = np.random.default_rng(0)
    change = random.standard_normal(at.shape) * at.any(axis=1, keepdims=True)
    moved = derivative.push(change)
    weight = random.standard_normal(moved.shape)
    gap = abs((weight * moved).sum() - (derivative.pull(weight.copy()) * change).sum())
    summation = method.account.settings.get("summation")
    return {
        "case": case.label,
        "nodes": case.setup.grid.n_nodes,
        "method": name,
        "sums": summation.value if summation else "",
        "apply s": one,
        "linearise": linearise / one,
        "jvp": _cpu(lambda: derivative.push(change)) / one,
        "vjp": _cpu(lambda: derivative.pull(weight.copy())) / one,
        "transpose": gap / float(np.linalg.norm(weight) * np.linalg.norm(moved)),
    }


def _exponents(sample: str, rows: list[Row]) -> list[str]:
    """How the times grow with the number of nodes."""
    found = []
    for name in METHODS:
        mine = [row for row in rows if row["method"] == name]
        if len(mine) > 1:
            nodes = [row["nodes"] for row in mine]
            grown = [exponent(nodes, [row["apply s"] * row[what] for row in mine]) for what in ("jvp", "vjp")]
            found.append(
                f"{sample}, `{name}`: time of jvp grows as nodes^{grown[0]:.2f}, of vjp as nodes^{grown[1]:.2f}"
            )
    return found


def beside_jax(quick: bool) -> MarkdownTable:
    """The same method with exact sums, in JAX by its automatic differentiation."""
    note = "CPU time of all threads; `rotation = quaternion`, all sums exact; JAX compiled before"
    table = MarkdownTable("Derivatives beside a dense implementation in JAX", notes=[note])
    if not _JAX:
        table.notes.append("JAX was not measured: it is not installed here (`pip install meshdeform[jax]`)")
        return table
    for size in _JAX_SIZES[:1] if quick else _JAX_SIZES:
        table.rows += _against_jax(motion("hemisphere", size))
    return table


def _against_jax(case: Motion) -> list[Row]:
    import dense_jax
    import jax

    flat, at = inner_nodes(case.problem), case.displacement
    method = make_method(Options("idw", idw=dense_jax.OPTIONS)).prepare(case.problem)
    derivative = method.linearised(at)
    theirs = dense_jax.dense(case.problem, case.setup.grid.points[flat])
    random = np.random.default_rng(0)
    change = random.standard_normal(at.shape) * at.any(axis=1, keepdims=True)
    weight = np.zeros_like(case.setup.grid.points)
    weight[flat] = random.standard_normal((len(flat), 3))
    forward = jax.jit(lambda d: jax.jvp(theirs, (at,), (d,))[1])
    back = jax.jit(lambda w: jax.vjp(theirs, at)[1](w)[0])
    moving = at.any(axis=1)
    works: dict[str, tuple[Callable[[], FloatArray], Callable[[], FloatArray]]] = {
        "apply": (lambda: method.apply(at)[flat], lambda: np.asarray(theirs(at))),
        "jvp": (lambda: derivative.push(change)[flat], lambda: np.asarray(forward(change))),
        "vjp": (lambda: derivative.pull(weight.copy())[moving], lambda: np.asarray(back(weight[flat]))[moving]),
    }
    rows = []
    for name, (own, other) in works.items():
        one, two = own(), other()
        row = {"case": case.label, "nodes": case.setup.grid.n_nodes, "what": name}
        row |= {"meshdeform s": _cpu(own), "JAX s": _cpu(other)}
        rows.append({**row, "difference": float(np.abs(one - two).max() / np.abs(two).max())})
    return rows


def _cpu(work: Callable[[], object], repeats: int = 3) -> float:
    """Smallest CPU seconds of some runs; a long one is not repeated."""
    found: list[float] = []
    while len(found) < repeats and sum(found) < _ENOUGH:
        begin = time.process_time()
        work()
        found.append(time.process_time() - begin)
    return min(found)
